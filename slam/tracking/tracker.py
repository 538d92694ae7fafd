"""Tracking: estimate the pose of every frame from its matches with the map."""

from copy import copy
from dataclasses import dataclass

import numpy as np

from dslab.slam.core.frame import Frame, FrameFeatures, twist_between
from dslab.slam.core.settings import setting, settings
from dslab.slam.core.timing import StageTimer
from dslab.slam.map._map_kernels import count_observed, resolve_points
from dslab.slam.map.map import Map
from dslab.slam.matching import guided
from dslab.slam.optimization.pose import direction_deviation
from dslab.slam.places.evidence import EvidenceBar, support
from dslab.slam.tracking.doubt import Doubt, DoubtConfig
from dslab.slam.tracking.local_map import (
    covered_share,
    local_map,
    match_keyframe,
    match_local,
    median_depth,
    optimize_frame,
    place_about,
    points_of,
    search_local_map,
)


@settings
class CrossingConfig:
    """What the first frame behind a gap must show of the map; a recovery puts all later poses on it."""

    bar: EvidenceBar = setting(
        EvidenceBar(min_share=0.25, max_contradicted=0.3, min_extent=0.16), "what it must show"
    )
    around: int = setting(10, "keyframes whose points are expected")
    radius_px: float = setting(10.0, "half side of the window for an expected point, level 0")
    min_expected: float = setting(20.0, "with fewer expected points the view says nothing")


@settings
class TrackingConfig:
    """Thresholds of the tracker."""

    search_radius_px: float = setting(15.0, "half side of the window for a predicted point; doubled once")
    gap_radius_px: float = setting(20.0, "half side of the window behind passed-over frames; doubled twice")
    min_motion_matches: int = setting(
        20, "matches below which the reference keyframe replaces the motion model"
    )
    min_motion_inliers: int = setting(
        10, "inliers below which the reference keyframe replaces the motion model"
    )
    reference_ratio: float = setting(0.8, "best over second best of reference matches", le=1)
    local_map_ratio: float = setting(0.8, "best over second best of local map matches", le=1)
    min_reference_matches: int = setting(
        15, "matches below which tracking by the reference keyframe fails too"
    )
    min_inliers: int = setting(30, "map matches that survive pose optimisation, below which tracking is lost")
    cautious_inliers: int = setting(50, "min_inliers behind passed-over frames, whose pose nothing supports")
    min_share: float = setting(0.0, "share of inliers below which a frame is rejected", le=1)
    local_map_keyframes: int = setting(80, "most keyframes of the local map")
    max_noise: float = setting(2.0, "how many times orb.noise_px all corners of a frame may be off", ge=1)
    keyframe_share: float = setting(0.9, "inliers below this share of the reference's make a keyframe", le=1)
    keyframe_cover: float = setting(0.6, "share of the view with found points below which one is made", le=1)
    urgent_share: float = setting(0.5, "keyframe_share right behind a keyframe", le=1)
    urgent_inliers: int = setting(150, "inliers below which every frame becomes a keyframe")
    keyframe_interval_s: float = setting(0.1, "least time between keyframes")
    crossing: CrossingConfig = setting(CrossingConfig(), "what a frame behind a gap must show")
    doubt: DoubtConfig = setting(DoubtConfig(), "bounds of a motion that is believed")


@dataclass(frozen=True)
class TrackingOutcome:
    """Outcome of tracking a frame: success, counts and reason of failure."""

    success: bool
    inliers: int
    matches: int
    reason: str = ""


class Tracker:
    """Tracks frames in one map, forward or backward in time.

    Attributes:
        observing: count in the map how often its points are seen; else tracking leaves the map unchanged.
        last: the last tracked frame.
        velocity: T_cam_last of the last step, None where unknown.
        twist: (6,) how the scene moves past the camera, see ``twist_between``; 0 where unknown.
        doubt: of the motion since the start.
    """

    def __init__(self, map_: Map, config: TrackingConfig, timer: StageTimer) -> None:
        self.map = map_
        self.config = config
        self.timer = timer
        self.observing = True
        self.last: Frame | None = None
        self.velocity: np.ndarray | None = None
        self.twist = np.zeros(6)
        self.doubt = Doubt(config.doubt)
        self._in_motion = False  # the velocity is that of a tracked step
        self._last_keyframe: FrameFeatures | None = None
        self._passed_over = 0

    def start(self, frame: Frame, keyframe: int, velocity: np.ndarray | None = None) -> None:
        """Start from a frame with known pose and matches."""
        self.last = frame
        self.velocity = velocity
        self.keyframe_made(frame, keyframe)

    def keyframe_requested(self, frame: Frame) -> None:
        """Start the least interval to the next keyframe at ``frame``, which will become one."""
        self._last_keyframe = frame.features

    def resume(self, frame: Frame) -> None:
        """Continue from a relocalized frame, with zero velocity."""
        self.last, self.velocity, self._in_motion = frame, np.eye(4), False
        self.twist = np.zeros(6)
        self._passed_over = 0
        self._last_keyframe = frame.features

    def corrected(self, factor: np.ndarray) -> None:
        """Follow a map whose lengths have changed by ``factor`` (n_keyframes,) around each keyframe."""
        if self.last is None:
            return
        own = factor[self.last.reference_keyframe]
        self.last.T_cam_reference = self.last.T_cam_reference.copy()
        self.last.T_cam_reference[:3, 3] *= own
        if self.velocity is not None:
            self.velocity = self.velocity.copy()
            self.velocity[:3, 3] *= own
        self._refreshed_last()
        self.doubt.tie_scale()

    def keyframe_made(self, frame: Frame, keyframe: int) -> None:
        """Take over that ``frame`` has become ``keyframe``, with the points that mapping created in it."""
        frame.point[:] = self.map.observed_points(keyframe)
        frame.reference_keyframe = keyframe
        frame.T_cam_reference = np.eye(4)
        frame.T_cam_map = self.map.T_cam_map(keyframe)
        self._last_keyframe = frame.features

    def rebase(self, map_: Map, last: Frame) -> None:
        """Continue in a map that has absorbed this tracker's; ``last`` is already expressed in it."""
        self.map = map_
        self.last = last
        last.T_cam_map = last.T_cam_reference @ map_.T_cam_map(last.reference_keyframe)

    def track(self, frame: Frame) -> TrackingOutcome:
        """Estimate the pose of the next frame and match it with the local map.

        Args:
            frame: features only; pose, matches and reference keyframe are filled in.
        """
        last = self._refreshed_last()
        with self.timer("predict"):
            if self._passed_over:
                found = self._track_across_gap(frame, last)
            else:
                found = self._track_with_motion_model(frame, last)
            if not found:
                found = self._track_reference_keyframe(frame, last)
        if not found:
            return TrackingOutcome(False, 0, int((frame.point >= 0).sum()), "too_few_matches_with_last_frame")
        if not self._passed_over and (frame.point >= 0).any():
            frame.features = frame.features.moving(twist_between(last, frame, median_depth(frame, self.map)))
        with self.timer("local_map"):
            inliers, matches = self._track_local_map(frame)
        if inliers < self._least_inliers(frame, self.config.min_inliers):
            return TrackingOutcome(False, inliers, matches, "too_few_local_map_inliers")
        if inliers < self.config.min_share * matches:
            return TrackingOutcome(False, inliers, matches, "too_many_outliers")
        fault = self._fault_of_crossing(frame, last)
        if fault:
            return TrackingOutcome(False, inliers, matches, fault)
        self._accept(frame, last)
        return TrackingOutcome(True, inliers, matches)

    def _least_inliers(self, frame: Frame, usual: int) -> int:
        """Inliers that a pose must have: ``usual``, or more behind a gap.

        Those of a smeared image say less of its pose each, so that more are asked.
        """
        least = max(usual, self.config.cautious_inliers) if self._passed_over else usual
        return round(least * frame.noise)

    def pass_over(self, frame: Frame) -> None:
        """Skip an unusable frame: the last pose is carried on by the motion model.

        It is a copy that is carried: the last tracked frame keeps the pose that was estimated for it.
        """
        last = self.last = copy(self._refreshed_last())
        self._passed_over += 1
        if self.velocity is not None:
            last.T_cam_map = self.velocity @ last.T_cam_map
            last.T_cam_reference = last.T_cam_map @ np.linalg.inv(self.map.T_cam_map(last.reference_keyframe))

    def take_pose(
        self, frame: Frame, T_cam_map: np.ndarray, keyframe: int, velocity: np.ndarray
    ) -> TrackingOutcome:
        """Go on from a frame whose pose was found otherwise; its features are matched as far as they fit.

        Args:
            frame: features only, which :meth:`track` could not place.
            T_cam_map: (4, 4) its pose, refined by its matches if they would do for tracking.
            keyframe: that it shares its view with.
            velocity: (4, 4) from here on.
        """
        m, config = self.map, self.config
        frame.T_cam_map, frame.reference_keyframe = T_cam_map.copy(), keyframe
        frame.point[:] = -1
        _, candidates = local_map(m, m.observed_points(keyframe), config.local_map_keyframes)
        match_local(frame, m, candidates, 1.0, config.local_map_ratio)
        matches = int((frame.point >= 0).sum())
        inliers = self.optimize(frame) if matches >= config.min_motion_inliers else 0
        if inliers < self._least_inliers(frame, config.min_inliers):
            frame.T_cam_map = T_cam_map
        if not inliers:
            frame.point[:] = -1
        frame.T_cam_reference = frame.T_cam_map @ np.linalg.inv(m.T_cam_map(keyframe))
        self.last, self.velocity, self._in_motion = frame, velocity, False
        return TrackingOutcome(True, inliers, matches)

    def wants_keyframe(self, frame: Frame, inliers: int) -> bool:
        """Return True if the frame sees too few of its reference keyframe's points, or on one side only."""
        if not self._may_be_keyframe(frame):
            return False
        known = count_observed(
            self.map.arrays, frame.reference_keyframe, 3 if self.map.n_keyframes > 2 else 2
        )
        last = self._last_keyframe
        right_behind = last is not None and abs(frame.features.index - last.index) == 1
        if right_behind:
            return inliers < max(self.config.urgent_share * known, self.config.urgent_inliers)
        held = inliers >= self.config.keyframe_share * known
        return not held or covered_share(frame, self.map) < self.config.keyframe_cover

    def optimize(self, frame: Frame) -> int:
        """Refine a frame's pose by its matches and remove outliers; number of inliers."""
        return optimize_frame(frame, self.map, self.config.max_noise)

    # -- steps -------------------------------------------------------------------------------------------

    def _may_be_keyframe(self, frame: Frame) -> bool:
        """True if the least interval since the last keyframe is over."""
        last = self._last_keyframe
        waited_s = np.inf if last is None else abs(frame.features.stamp_s - last.stamp_s)
        return waited_s > self.config.keyframe_interval_s - 1e-6

    def _refreshed_last(self) -> Frame:
        """The last frame, moved along with its reference keyframe and freed of dropped points."""
        last = self.last
        if last is None:
            raise RuntimeError("the tracker has not been started")
        last.T_cam_map = last.T_cam_reference @ self.map.T_cam_map(last.reference_keyframe)
        resolve_points(self.map.arrays, last.point)
        return last

    def _track_with_motion_model(self, frame: Frame, last: Frame) -> bool:
        if self.velocity is None:
            return False
        predicted = np.ascontiguousarray(self.velocity @ last.T_cam_map)
        count = 0
        for widen in (1.0, 2.0):
            count = self._match_last(frame, last, predicted, widen * self.config.search_radius_px)
            if count >= self.config.min_motion_matches:
                break
        if count < self.config.min_motion_matches:
            return False
        frame.T_cam_map = predicted
        return self.optimize(frame) >= self.config.min_motion_inliers

    def _track_across_gap(self, frame: Frame, last: Frame) -> bool:
        """Match the local map around the predicted pose and the last reference keyframe's.

        A pose predicted over many frames may be far off, and the few points of a plane may then fit a wrong
        pose. The keyframe's pose is reliable: bundle adjustment has refined it. Of the two starts, the one
        with more inliers is used.
        """
        if self.velocity is None:
            return False
        m, config = self.map, self.config
        starts = self.velocity @ last.T_cam_map, m.T_cam_map(m.live(last.reference_keyframe))
        _, points = local_map(m, last.point, config.local_map_keyframes)
        least, bounds = config.min_motion_matches, (config.local_map_ratio, config.max_noise)
        for radius_px in config.gap_radius_px * np.array([1.0, 2.0, 4.0]):
            found = [place_about(frame, m, T, points, radius_px / 4.0, least, *bounds) for T in starts]
            best = max(found, key=lambda placed: placed[0])
            if best[0] >= least:
                _, frame.T_cam_map, frame.point = best
                return True
        return False

    def _match_last(self, frame: Frame, last: Frame, predicted: np.ndarray, radius_px: float) -> int:
        f, g = frame.features, last.features
        frame.point, count = guided.match_last_frame(
            self.map.arrays, self.map.view, predicted, last.point, g.octave, g.angle_deg,
            f.xy, f.octave, f.angle_deg, f.descriptors, f.cell_start, radius_px,
        )  # fmt: skip
        return count

    def _track_reference_keyframe(self, frame: Frame, last: Frame) -> bool:
        """Match with the reference keyframe's points without prediction."""
        keyframe = self.map.live(last.reference_keyframe)
        rows, points = match_keyframe(frame, self.map, keyframe, self.config.reference_ratio)
        frame.point[:] = -1
        if len(rows) < self.config.min_reference_matches:
            return False
        frame.point[rows] = points
        frame.T_cam_map = last.T_cam_map.copy()
        return self.optimize(frame) >= self.config.min_motion_inliers

    def _track_local_map(self, frame: Frame) -> tuple[int, int]:
        """Match the frame with its local map; (inliers, matches)."""
        config = self.config
        bounds = config.local_map_keyframes, 1.0, config.local_map_ratio, config.max_noise
        inliers, matches, keyframe = search_local_map(frame, self.map, *bounds, self.observing)
        if keyframe >= 0:
            frame.reference_keyframe = keyframe
        return inliers, matches

    def _fault_of_crossing(self, frame: Frame, last: Frame) -> str:
        """What the view says against its pose after a gap; empty for nothing, or without a gap.

        A distant wall that both views show fits any displacement, and what looks alike fits a wrong one.
        """
        if not self._passed_over:
            return ""
        m, config = self.map, self.config.crossing
        k = m.live(last.reference_keyframe)
        points = points_of(m, [k, *map(int, m.neighbours(k, config.around))])
        seen = support(m, points, frame.T_cam_map, frame.features, config.radius_px)
        return config.bar.fault(seen) if seen.expected >= config.min_expected else ""

    def _accept(self, frame: Frame, last: Frame) -> None:
        if self.observing:
            self.map.arrays.pt_found[frame.point[frame.point >= 0]] += 1
        frame.T_cam_reference = frame.T_cam_map @ np.linalg.inv(self.map.T_cam_map(frame.reference_keyframe))
        if not self._passed_over:
            self._note_motion(frame, last)
            if (frame.point >= 0).any():
                self.twist = twist_between(last, frame, median_depth(frame, self.map))
            self.velocity = frame.T_cam_map @ np.linalg.inv(last.T_cam_map)
            self._in_motion = True
        self._passed_over = 0
        self.last = frame

    def _note_motion(self, frame: Frame, last: Frame) -> None:
        m, matched = self.map, frame.point >= 0
        points = frame.point[matched]
        if self.velocity is None or not self._in_motion or not len(points):
            return
        made = m.features(int(np.median(m.arrays.pt_first_keyframe[points])))
        predicted, xyz = self.velocity @ last.T_cam_map, m.arrays.pt_xyz[points]
        information = m.view.inv_sigma2[frame.features.octave[matched]]
        deviation = direction_deviation(frame.T_cam_map, xyz, information, m.view.fx, m.view.fy)
        self.doubt.note(frame, last, predicted, xyz, made.stamp_s, deviation)
