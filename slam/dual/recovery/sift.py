"""Recovery thread 2: SIFT matches and PnP, backward. Source: paper, Algorithm 1, lines 15-25.

It has no motion model: a frame gets its pose from SIFT matches alone, however far the camera has moved since
the last placed frame, as long as the views overlap. The map grows with ORB features on these poses.
"""

from dataclasses import dataclass

import numpy as np

from slam.core.frame import Frame
from slam.core.timing import StageTimer
from slam.dual.recovery.interface import RecoveryConfig, RecoveryCost, RecoveryResult, RecoveryTask
from slam.dual.recovery.propagation import propagate
from slam.dual.recovery.sift_mapping import SiftMapper
from slam.features.sift import (
    SiftFrame,
    detect,
    match,
    rays,
    take_depth_from_points,
    triangulate_pairs,
)
from slam.features.sift_detector import SiftDetector
from slam.map._map_kernels import count_observed, resolve_points
from slam.matching import guided
from slam.optimization.pose import CHI2_2DOF, optimize_pose
from slam.tracking.pnp import ransac_pnp
from slam.tracking.tracker import Tracker, TrackingOutcome


@dataclass(frozen=True)
class SiftRecoveryConfig(RecoveryConfig):
    """Settings of the SIFT thread.

    Attributes:
        n_features: most SIFT keypoints per frame, strongest first.
        contrast: least contrast of a keypoint, in the sense of OpenCV, whose usual value is .04.
        octaves: most octaves in which keypoints are sought.
        most_pixels: a larger image is reduced to this number of pixels for it.
        ratio: best over second best descriptor distance of a SIFT match.
        ransac_iterations, ransac_error_px: of the pose RANSAC.
        min_sift_inliers, min_points: fewest SIFT features and map points that are inliers of a pose.
        min_sift_inliers_alone: fewest SIFT inliers if the map points are fewer than ``min_points``.
        keyframe_too: a frame that does not match the last placed one is matched with the last keyframe.
        young_points: points with three observations, below which the map around a keyframe counts as young.
        min_parallax_deg: least angle between the rays that triangulate a SIFT feature.
        depth_radius_px: largest distance to a map point's keypoint at which a SIFT feature takes its depth,
            until it is triangulated.
        adjusted_keyframes: number of newest keyframes with SIFT features in bundle adjustment.
        paired_keyframes: number of them matched for new points even without covisibility.
    """

    n_features: int = 600
    contrast: float = 0.005
    octaves: int = 4
    most_pixels: int = 76_800
    ratio: float = 0.8
    ransac_iterations: int = 300
    ransac_error_px: float = 3.0
    min_sift_inliers: int = 20
    min_points: int = 15
    min_sift_inliers_alone: int = 60
    keyframe_too: bool = True
    young_points: int = 50
    min_parallax_deg: float = 1.15
    depth_radius_px: float = 6.0
    adjusted_keyframes: int = 10
    paired_keyframes: int = 4


class SiftRecovery:
    """Recovery that places frames by SIFT features and maps ORB features."""

    name = "sift"
    needs_images = True
    # Measured: CPU on one core, 640x480, 1,000 ORB features.
    cost = RecoveryCost(frame_ms=12.0, keyframe_ms=50.0, alignment_ms=4.0)

    def __init__(self, config: RecoveryConfig | None = None) -> None:
        self.config = SiftRecoveryConfig.extending(config)

    def run(self, task: RecoveryTask) -> RecoveryResult:
        """Place the buffered frames newest first, each by SIFT matches with the last one."""
        tracker = SiftTracker(task, self.config)
        mapper = SiftMapper(
            task.new_map,
            self.config.mapping_in(task),
            tracker.last_sift,
            lambda: tracker.last_sift,
            self.config.adjusted_keyframes,
            self.config.paired_keyframes,
        )
        return propagate(task, self.config, tracker, mapper)


class SiftTracker(Tracker):
    """Places frames by SIFT features, then matches the map's ORB features.

    A SIFT feature takes its depth from a nearby map point at first; once there is parallax with the frame
    that saw it first, it is triangulated. Positions are kept relative to the last frame that saw them and so
    follow the map when bundle adjustment moves it.
    """

    def __init__(self, task: RecoveryTask, config: SiftRecoveryConfig) -> None:
        super().__init__(task.new_map, config.tracking_in(task), StageTimer())
        self._sift_config = config
        self._task = task
        self._detector = SiftDetector(config.n_features, config.contrast, config.octaves, config.most_pixels)
        self._placed: list[Frame] = []
        self._tracks = 0
        self.last_sift = self._keyframe_sift = self._detect(task.first)
        self.start(task.first, task.first.reference_keyframe)
        self._register(self.last_sift)

    def track(self, frame: Frame) -> TrackingOutcome:
        """Place the frame by SIFT matches with the last placed frame or the last keyframe.

        Args:
            frame: features only; pose, matches and reference keyframe are filled in.
        """
        sift = self._detect(frame)
        outcome = self._place(sift, self.last_sift)
        again = self._sift_config.keyframe_too and self._keyframe_sift is not self.last_sift
        if not outcome.success and again:
            outcome = self._place(sift, self._keyframe_sift)
        return outcome

    def pass_over(self, frame: Frame) -> None:
        """Skip an unusable frame: the next one is matched with the same frame."""
        self._passed_over += 1

    def wants_keyframe(self, frame: Frame, inliers: int) -> bool:
        """Decide as forward tracking does, but earlier where the map is young or ends."""
        if not self._may_be_keyframe(frame):
            return False
        if inliers < self._sift_config.min_points:
            return True
        if count_observed(self.map.arrays, frame.reference_keyframe, 3) < self._sift_config.young_points:
            known = count_observed(self.map.arrays, frame.reference_keyframe, 2)
            return inliers < self.config.keyframe_share * known
        return super().wants_keyframe(frame, inliers)

    def keyframe_made(self, frame: Frame, keyframe: int) -> None:
        """Take over that ``frame``, the last placed one, has become ``keyframe``."""
        super().keyframe_made(frame, keyframe)
        self._keyframe_sift = self.last_sift

    # -- steps -------------------------------------------------------------------------------------------

    def _detect(self, frame: Frame) -> SiftFrame:
        image = self._task.image_of(frame.features.index)
        return detect(image, frame, self._task.camera, self._detector)

    def _place(self, sift: SiftFrame, reference: SiftFrame) -> TrackingOutcome:
        config, frame, m = self._sift_config, sift.frame, self.map
        pairs = match(reference, sift, config.ratio)
        placed = pairs[reference.known[pairs[:, 0]]]
        if len(placed) < config.min_sift_inliers:
            return TrackingOutcome(False, 0, len(placed), "too_few_sift_matches")
        xyz = reference.positions(placed[:, 0], self._pose_of(reference.frame))
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
        too_few = sift_inliers + points < self._least_inliers(frame, 0)
        if too_few or sift_inliers < (config.min_sift_inliers_alone if alone else config.min_sift_inliers):
            return TrackingOutcome(False, points, matches, "too_few_inliers")
        fault = self._fault_of_crossing(frame, reference.frame)
        if fault:
            return TrackingOutcome(False, points, matches, fault)
        if alone:
            frame.point[:] = -1
        self._set_reference(frame, reference.frame)
        self._accept(frame, reference.frame)
        wrong = np.zeros(len(sift.xy), np.bool_)
        wrong[placed[~agree, 1]] = True
        self._pass_tracks_on(sift, reference, pairs[~wrong[pairs[:, 1]]])
        self._register(sift)
        return TrackingOutcome(True, points, matches)

    def _match_map(
        self, sift: SiftFrame, seen: np.ndarray, xyz: np.ndarray, rows: np.ndarray
    ) -> tuple[np.ndarray, int, int]:
        """Match the local map around the pose and refine it by both kinds of features.

        Args:
            sift: the frame, with a pose.
            seen: map points that the reference frame sees, -1 for none.
            xyz, rows: (k, 3) positions of the features ``rows``.

        Returns:
            Inlier mask of the features (k,) bool, number of map point inliers, number of map points matched.
        """
        m, frame, f = self.map, sift.frame, sift.frame.features
        _, candidates = guided.collect_local_map(
            m.arrays, m.n_keyframes, m.n_points, seen, self.config.local_map_keyframes
        )
        frame.point[:] = -1
        agree, matches = np.zeros(len(rows), np.bool_), 0
        for widen, last in ((2.0, False), (1.0, True)):
            guided.match_local_points(
                m.arrays, m.view, frame.T_cam_map, candidates,
                f.xy, f.octave, f.descriptors, f.cell_start, frame.point, widen,
                self.config.local_map_ratio, last,
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
        """Set the reference: the keyframe with most common points, or the predecessor's."""
        m = self.map
        keyframes, _ = guided.collect_local_map(m.arrays, m.n_keyframes, m.n_points, frame.point, 1)
        frame.reference_keyframe = (
            int(keyframes[0]) if len(keyframes) else m.live(reference.reference_keyframe)
        )

    def _pass_tracks_on(self, sift: SiftFrame, reference: SiftFrame, pairs: np.ndarray) -> None:
        """Pass first view and position of each feature to its match, triangulated where possible."""
        theirs, own = pairs.T
        view, T = self.map.view, sift.frame.T_cam_map
        sift.follow(own, reference, theirs)
        sift.set_positions(own, reference.positions(theirs, self._pose_of(reference.frame)), T)
        poses = np.empty((len(self._placed), 4, 4))
        for number in np.unique(sift.seen_from[own]):
            poses[number] = self._pose_of(self._placed[number])
        xyz, disagrees = triangulate_pairs(
            poses[sift.seen_from[own]],
            rays(sift.seen_at[own], view),
            np.ascontiguousarray(T),
            rays(sift.xy[own], view),
            CHI2_2DOF / (sift.inv_sigma2[own] * view.fx * view.fy),
            float(np.cos(np.deg2rad(self._sift_config.min_parallax_deg))),
        )
        seen = np.isfinite(xyz[:, 0])
        sift.set_positions(own[seen], xyz[seen], T)
        sift.forget(own[disagrees])

    def _register(self, sift: SiftFrame) -> None:
        """Register a placed frame; its new features take their depth from nearby map points."""
        frame, m = sift.frame, self.map
        new = np.flatnonzero(sift.seen_from < 0)
        sift.seen_from[new] = len(self._placed)
        sift.track[new] = self._tracks + np.arange(len(new))
        self._tracks += len(new)
        self._placed.append(frame)
        rows = np.flatnonzero(frame.point >= 0)
        take_depth_from_points(
            sift,
            m.arrays.pt_xyz[frame.point[rows]],
            frame.features.xy[rows],
            frame.T_cam_map,
            m.view,
            self._sift_config.depth_radius_px,
        )
        self.last_sift = sift

    def _pose_of(self, frame: Frame) -> np.ndarray:
        """(4, 4) T_cam_map of a placed frame in the current map."""
        return frame.T_cam_reference @ self.map.T_cam_map(frame.reference_keyframe)
