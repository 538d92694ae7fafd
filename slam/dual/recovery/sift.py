"""Recovery thread 2: SIFT matches and PnP, backward. Source: paper, Algorithm 1, lines 15-25.

It predicts no motion: a frame gets its pose from SIFT features alone, however far the camera has moved
since the last one placed, as long as the two see the same thing. The map grows with ORB features on these
poses.
"""

from dataclasses import dataclass

import numpy as np

from slam.core.frame import Frame
from slam.core.timing import StageTimer
from slam.dual.recovery.interface import RecoveryConfig, RecoveryCost, RecoveryResult, RecoveryTask
from slam.dual.recovery.propagation import propagate
from slam.dual.recovery.sift_mapping import SiftMapper
from slam.features import sift as sift_features
from slam.features.sift import SiftFrame
from slam.map._map_kernels import count_observed, resolve_points
from slam.matching import guided as matching
from slam.optimization.pose import CHI2_2DOF, optimize_pose
from slam.tracking.pnp import ransac_pnp
from slam.tracking.tracker import Tracker, TrackingOutcome


@dataclass(frozen=True)
class SiftRecoveryConfig(RecoveryConfig):
    """Settings of the SIFT thread.

    Attributes:
        n_features: SIFT features per frame at the most.
        contrast: of SIFT: half of its usual value, since weak texture is what this thread is there for.
        ratio: best over second best descriptor distance of a SIFT match.
        ransac_iterations, ransac_error_px: of the pose.
        min_sift_inliers, min_points: SIFT features and map points that a pose must agree with.
        min_sift_inliers_alone: SIFT features that it must agree with where the map points are fewer.
        young_points: points with three observations, below which a keyframe is part of a beginning.
        min_parallax_deg: least angle between the rays from which a SIFT feature gets its place.
        depth_radius_px: how far from a map point's keypoint a SIFT feature may lie to take its depth, until
            it is triangulated.
        adjusted_keyframes: how many of those made last have their SIFT features in bundle adjustment.
        paired_keyframes: in how many of them new points are sought, even if none are shared.
    """

    n_features: int = 1000
    contrast: float = 0.005
    ratio: float = 0.8
    ransac_iterations: int = 300
    ransac_error_px: float = 3.0
    min_sift_inliers: int = 20
    min_points: int = 15
    min_sift_inliers_alone: int = 60
    young_points: int = 50
    min_parallax_deg: float = 1.15
    depth_radius_px: float = 6.0
    adjusted_keyframes: int = 10
    paired_keyframes: int = 4


class SiftRecovery:
    """Frames placed by SIFT features, mapped by ORB features."""

    name = "sift"
    needs_images = True
    # Measured: CPU on one core, 640x480, 1,000 features.
    cost = RecoveryCost(frame_ms=150.0, keyframe_ms=20.0, alignment_ms=4.0)

    def __init__(self, config: RecoveryConfig | None = None) -> None:
        self.config = SiftRecoveryConfig.extending(config)

    def run(self, task: RecoveryTask) -> RecoveryResult:
        """Place the buffered frames newest first, each by its SIFT matches with the last one placed."""
        tracker = SiftTracker(task, self.config)
        mapper = SiftMapper(
            task.new_map,
            self.config.mapping,
            tracker.last_sift,
            lambda: tracker.last_sift,
            self.config.adjusted_keyframes,
            self.config.paired_keyframes,
        )
        return propagate(task, self.config, tracker, mapper)


class SiftTracker(Tracker):
    """Places frames by SIFT features; matches the map's ORB features on these poses.

    A SIFT feature has its place from the depth of a map point seen beside it at first, and as soon as there
    is parallax from the frame in which it was first seen. Places are kept in the camera of the last frame
    that saw them, which follows the map as bundle adjustment moves it.
    """

    def __init__(self, task: RecoveryTask, config: SiftRecoveryConfig) -> None:
        super().__init__(task.new_map, config.tracking, StageTimer())
        self._sift_config = config
        self._task = task
        self._placed: list[Frame] = []
        self._tracks = 0
        self.last_sift = self._keyframe_sift = self._detect(task.first)
        self.start(task.first, task.first.reference_keyframe)
        self._enter(self.last_sift)

    def track(self, frame: Frame) -> TrackingOutcome:
        """Place the frame by its SIFT matches with the last frame placed, else with the last keyframe.

        Args:
            frame: features only; pose, matches and reference keyframe are filled in.
        """
        sift = self._detect(frame)
        outcome = self._place(sift, self.last_sift)
        if not outcome.success and self._keyframe_sift is not self.last_sift:
            outcome = self._place(sift, self._keyframe_sift)
        return outcome

    def pass_over(self, frame: Frame) -> None:
        """Skip an unusable frame: the next one is matched with what this one should have been."""
        self._passed_over += 1

    def wants_keyframe(self, frame: Frame, inliers: int) -> bool:
        """As forward tracking has it, but as soon as it may be where the map has hardly begun or ends."""
        waited_s = abs(frame.features.stamp_s - self._last_keyframe_stamp_s)
        if waited_s < self.config.keyframe_interval_s - 1e-6:
            return False
        if inliers < self._sift_config.min_points:
            return True
        if count_observed(self.map.arrays, frame.reference_keyframe, 3) < self._sift_config.young_points:
            known = count_observed(self.map.arrays, frame.reference_keyframe, 2)
            return inliers < self.config.keyframe_share * known
        return super().wants_keyframe(frame, inliers)

    def keyframe_made(self, frame: Frame, keyframe: int) -> None:
        """Take note that ``frame``, the last one placed, has become ``keyframe``."""
        super().keyframe_made(frame, keyframe)
        self._keyframe_sift = self.last_sift

    # -- steps -------------------------------------------------------------------------------------------

    def _detect(self, frame: Frame) -> SiftFrame:
        c = self._sift_config
        image = self._task.image_of(frame.features.index)
        return sift_features.detect(image, frame, self._task.camera, c.n_features, c.contrast)

    def _place(self, sift: SiftFrame, reference: SiftFrame) -> TrackingOutcome:
        config, frame, m = self._sift_config, sift.frame, self.map
        pairs = sift_features.match(reference, sift, config.ratio)
        placed = pairs[reference.known[pairs[:, 0]]]
        if len(placed) < config.min_sift_inliers:
            return TrackingOutcome(False, 0, len(placed), "too_few_sift_matches")
        xyz = reference.places(placed[:, 0], self._pose_of(reference.frame))
        found = ransac_pnp(
            xyz, sift.xy[placed[:, 1]], m.view, self._task.rng,
            config.ransac_iterations, config.ransac_error_px, config.min_sift_inliers,
        )  # fmt: skip
        if found is None:
            return TrackingOutcome(False, 0, len(placed), "no_pose_from_sift_matches")
        frame.T_cam_map, _ = found
        resolve_points(m.arrays, reference.frame.point)
        agree, points, matches = self._match_map(sift, reference.frame.point, xyz, placed[:, 1])
        sift_inliers = int(agree.sum())
        alone = points < config.min_points
        # Beyond a gap the pose has nothing but these matches, and all that comes after rests on it.
        too_few = self._passed_over and sift_inliers + points < self.config.cautious_inliers
        if too_few or sift_inliers < (config.min_sift_inliers_alone if alone else config.min_sift_inliers):
            return TrackingOutcome(False, points, matches, "too_few_inliers")
        if alone:
            frame.point[:] = -1
        self._set_reference(frame, reference.frame)
        self._accept(frame, reference.frame)
        wrong = np.zeros(len(sift.xy), np.bool_)
        wrong[placed[~agree, 1]] = True
        self._hand_on(sift, reference, pairs[~wrong[pairs[:, 1]]])
        self._enter(sift)
        return TrackingOutcome(True, points, matches)

    def _match_map(
        self, sift: SiftFrame, seen: np.ndarray, xyz: np.ndarray, rows: np.ndarray
    ) -> tuple[np.ndarray, int, int]:
        """Match the local map about the pose and refine it by both kinds of features.

        Args:
            sift: the frame, posed.
            seen: map points that the reference frame sees, -1 for none.
            xyz, rows: (k, 3) places of the features ``rows``.

        Returns:
            Which of the features agree (k,) bool, map points that agree, map points matched.
        """
        m, frame, f = self.map, sift.frame, sift.frame.features
        _, candidates = matching.collect_local_map(
            m.arrays, m.n_keyframes, m.n_points, seen, self.config.local_map_keyframes
        )
        frame.point[:] = -1
        agree, matches = np.zeros(len(rows), np.bool_), 0
        for widen, last in ((2.0, False), (1.0, True)):
            matching.match_local_points(
                m.arrays, m.view, frame.T_cam_map, candidates,
                f.xy, f.octave, f.descriptors, f.cell_start, frame.point, widen, 0.8, last,
            )  # fmt: skip
            matched = np.flatnonzero(frame.point >= 0)
            matches = len(matched)
            frame.T_cam_map, inlier = optimize_pose(
                frame.T_cam_map,
                np.concatenate([m.arrays.pt_xyz[frame.point[matched]], xyz]),
                np.concatenate([f.xy[matched], sift.xy[rows]]),
                np.concatenate([m.view.inv_sigma2[f.octave[matched]], sift.inv_sigma2[rows]]),
                m.view.fx, m.view.fy, m.view.cx, m.view.cy,
            )  # fmt: skip
            frame.point[matched[~inlier[:matches]]] = -1
            agree = inlier[matches:]
        return agree, int((frame.point >= 0).sum()), matches

    def _set_reference(self, frame: Frame, reference: Frame) -> None:
        """Refer the frame to the keyframe that shares most of its points, or to its predecessor's."""
        m = self.map
        keyframes, _ = matching.collect_local_map(m.arrays, m.n_keyframes, m.n_points, frame.point, 1)
        frame.reference_keyframe = (
            int(keyframes[0]) if len(keyframes) else m.live(reference.reference_keyframe)
        )

    def _hand_on(self, sift: SiftFrame, reference: SiftFrame, pairs: np.ndarray) -> None:
        """What is known of a feature passes to its match: where it was first seen, and its place."""
        theirs, own = pairs.T
        view, T = self.map.view, sift.frame.T_cam_map
        sift.follow(own, reference, theirs)
        sift.set_places(own, reference.places(theirs, self._pose_of(reference.frame)), T)
        poses = np.empty((len(self._placed), 4, 4))
        for number in np.unique(sift.seen_from[own]):
            poses[number] = self._pose_of(self._placed[number])
        xyz, disagrees = sift_features.triangulate_pairs(
            poses[sift.seen_from[own]],
            sift_features.rays(sift.seen_at[own], view),
            np.ascontiguousarray(T),
            sift_features.rays(sift.xy[own], view),
            CHI2_2DOF / (sift.inv_sigma2[own] * view.fx * view.fy),
            float(np.cos(np.deg2rad(self._sift_config.min_parallax_deg))),
        )
        seen = np.isfinite(xyz[:, 0])
        sift.set_places(own[seen], xyz[seen], T)
        sift.forget(own[disagrees])

    def _enter(self, sift: SiftFrame) -> None:
        """The frame is placed: features new in it take their depth from the map points beside them."""
        frame, m = sift.frame, self.map
        new = np.flatnonzero(sift.seen_from < 0)
        sift.seen_from[new] = len(self._placed)
        sift.track[new] = self._tracks + np.arange(len(new))
        self._tracks += len(new)
        self._placed.append(frame)
        rows = np.flatnonzero(frame.point >= 0)
        sift_features.take_depth_from_points(
            sift,
            m.arrays.pt_xyz[frame.point[rows]],
            frame.features.xy[rows],
            frame.T_cam_map,
            m.view,
            self._sift_config.depth_radius_px,
        )
        self.last_sift = sift

    def _pose_of(self, frame: Frame) -> np.ndarray:
        """(4, 4) T_cam_map of a placed frame, as the map stands now."""
        return frame.T_cam_reference @ self.map.T_cam_map(frame.reference_keyframe)
