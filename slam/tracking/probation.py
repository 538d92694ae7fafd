"""Probation of a relocalization: the frames that follow confirm it or not, before it counts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from dslab.slam.belief.log import note
from dslab.slam.belief.model import Unseen
from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import camera_centre
from dslab.slam.core.settings import setting, settings
from dslab.slam.map._map_kernels import median_depth
from dslab.slam.map.map import Map
from dslab.slam.optimization.pose import direction_deviation
from dslab.slam.places.evidence import VIEW_IS_UNKNOWN, EvidenceBar, support
from dslab.slam.tracking.doubt import Doubt
from dslab.slam.tracking.local_map import local_map
from dslab.slam.tracking.reach import Reach
from dslab.slam.tracking.tracker import Tracker, TrackingOutcome


@settings
class ProbationConfig:
    """What confirms a relocalization."""

    frames: int = setting(3, "number of frames after the relocalized one that must be tracked")
    span_s: float = setting(0.1, "least time of these frames")
    patience_s: float = setting(0.5, "time beyond the asked one after which a relocalization is withdrawn")
    around: int = setting(10, "keyframes whose points are expected, those that share most")
    radius_px: float = setting(10.0, "half side of the window for an expected point, level 0")
    bar: EvidenceBar = setting(
        EvidenceBar(min_share=0.75, max_contradicted=0.2, min_extent=0.16), "what a frame must show"
    )
    far_s: float = setting(2.0, "time since the loss beyond which more is asked, as more places are possible")
    far_share: float = setting(0.5, "time asked of frames then, as a share of that since the loss")
    far_max_s: float = setting(6.0, "bound of that time")
    far_bar: EvidenceBar = setting(
        EvidenceBar(min_share=0.85, max_contradicted=0.06, min_extent=0.16, max_share=1.7),
        "what a frame must show then",
    )
    min_expected: float = setting(40.0, "fewest expected points with which a frame says something")
    max_deviation_deg: float = setting(0.55, "largest deviation of the direction with which a frame counts")
    min_sound: float = setting(0.75, "share of the frames that must speak for the place", le=1)
    memory_s: float = setting(8.0, "time for which frames on an earlier probation count too")


class Verdict(StrEnum):
    """State of a probation."""

    PENDING = "pending"
    CONFIRMED = "confirmed"
    WITHDRAWN = "withdrawn"


@dataclass(frozen=True)
class Withdrawn:
    """What is kept of a probation that was withdrawn.

    Attributes:
        map_id: the map.
        centre: (3,) last position of the camera there, frame map.
        stamp_s: time of that position.
        faults: time and fault of each frame that said something, empty for none; views that are unknown say
            nothing of another place.
        inherited: the same of those that it went on from.
    """

    map_id: int
    centre: np.ndarray
    stamp_s: float
    faults: tuple[tuple[float, str], ...]
    inherited: tuple[tuple[float, str], ...]


class Probation:
    """A relocalized frame and the frames tracked since; the map is left unchanged.

    Args:
        map_id: the map.
        frame: the relocalized frame.
        keyframe: the recognised keyframe.
        tracker: of the same map, not yet started.
        config: settings; None if the pose counts at once.
        lost_at_s: time of the loss.
        earlier: probations that were withdrawn since the loss, in order.
        reach: how far the camera can have come in a time; None if unknown.
        doubt: for which the map was lost, if it was; what made the poses wander then may still be in view, so
            that the frames must be as many as it takes to doubt them.

    Attributes:
        frames: the relocalized frame and those tracked since; once it is confirmed, from the first of them on
            that met the bar.
        faults: time and fault of each that says something, empty for none.
        verdict: whether it has ended, and how.
        reason: reason of a withdrawal; empty otherwise.
    """

    def __init__(
        self,
        map_id: int,
        frame: Frame,
        keyframe: int,
        tracker: Tracker,
        config: ProbationConfig | None,
        lost_at_s: float,
        earlier: Sequence[Withdrawn] = (),
        doubt: Doubt | None = None,
        reach: Reach | None = None,
    ) -> None:
        self.map_id = map_id
        self.keyframe = keyframe
        self.tracker = tracker
        self.frames = [frame]
        self.verdict = Verdict.PENDING
        self.reason = ""
        self.faults: list[tuple[float, str]] = []
        tracker.resume(frame)
        if config is None:
            self.verdict = Verdict.CONFIRMED
            return
        self._config, self._reach, self._lost_at_s = config, reach, lost_at_s
        if doubt is not None:
            tracker.doubt = doubt.successor()
            self._config = replace(config, frames=max(config.frames, doubt.config.min_frames + 1))
        self._inherited, self._earlier = _divided(earlier, map_id, frame, reach)
        lost_for_s = frame.features.stamp_s - lost_at_s
        self._far = lost_for_s > config.far_s
        asked_s = min(config.far_share * lost_for_s, config.far_max_s) if self._far else 0.0
        self._span_s = max(config.span_s, asked_s)
        tracker.observing = False
        self._sound_from: int | None = None
        self._judge(frame)

    @property
    def first(self) -> Frame:
        """The relocalized frame."""
        return self.frames[0]

    def offer(self, frame: Frame) -> TrackingOutcome:
        """Track the next frame and decide, if possible."""
        outcome = self.tracker.track(frame)
        reason = self.tracker.doubt.reason or outcome.reason
        if reason:
            self.withdraw(reason)
            return TrackingOutcome(False, outcome.inliers, outcome.matches, reason)
        self.frames.append(frame)
        self._judge(frame)
        self._decide()
        confirmed = self.verdict is Verdict.CONFIRMED
        return TrackingOutcome(
            confirmed, outcome.inliers, outcome.matches, "" if confirmed else "on_probation"
        )

    def withdraw(self, reason: str) -> None:
        """End it without confirmation."""
        self.verdict, self.reason = Verdict.WITHDRAWN, reason

    def withdrawn(self) -> Withdrawn:
        """What is kept of it for those that come after."""
        last = self.frames[-1]
        return Withdrawn(
            self.map_id,
            camera_centre(last.T_cam_map),
            last.features.stamp_s,
            tuple((at_s, fault) for at_s, fault in self.faults if fault != VIEW_IS_UNKNOWN),
            self._inherited,
        )

    def _decide(self) -> None:
        now_s = self.frames[-1].features.stamp_s
        since_s = self.first.features.stamp_s
        if self._far and self.faults:  # what says nothing confirms nothing, for as long as it goes on
            since_s = self.faults[0][0]
        span_s = now_s - since_s
        if len(self.frames) <= self._config.frames or span_s < self._span_s - 1e-6:
            return
        own = [fault for _, fault in self.faults]
        remembered = [fault for at_s, fault in self._earlier if at_s >= now_s - self._config.memory_s]
        before = [fault for _, fault in self._inherited] + remembered
        if own and not own[-1] and self._are_sound(own) and self._are_sound(before + own):
            self.verdict = Verdict.CONFIRMED
            self.frames = self.frames[self._sound_from :]
            self.tracker.observing = True
        elif span_s >= self._span_s + self._config.patience_s - 1e-6 and not (own and self._are_sound(own)):
            self.withdraw(next((fault for fault in reversed(own) if fault), "too_little_evidence"))

    def _are_sound(self, faults: Sequence[str]) -> bool:
        return sum(not fault for fault in faults) >= self._config.min_sound * len(faults)

    def _judge(self, frame: Frame) -> None:
        m: Map = self.tracker.map
        _, points = local_map(m, frame.point, self._config.around)
        radius_px, bar = self._config.radius_px, self._config.far_bar if self._far else self._config.bar
        seen = support(m, points, frame.T_cam_map, frame.features, radius_px, near=True)
        fault = bar.fault(seen)
        supposed = self.map_id, self.first.features.index, m.frame_index(self.keyframe)
        note(
            "relocalization", supposed, m, self.keyframe, frame.T_cam_map, frame.features, points, fault,
            self._unseen,
        )  # fmt: skip
        is_telling = seen.expected >= self._config.min_expected or not (fault or self._far)
        if is_telling and self._deviation_deg(frame) <= self._config.max_deviation_deg:
            self.faults.append((frame.features.stamp_s, fault))
            if not fault and self._sound_from is None:
                self._sound_from = len(self.frames) - 1

    def _unseen(self) -> Unseen:
        first, m = self.first, self.tracker.map
        if self._reach is None:
            return Unseen(first.features.stamp_s - self._lost_at_s)
        depth = median_depth(m.arrays, self.keyframe)
        return self._reach.unseen(camera_centre(first.T_cam_map), first.features.stamp_s, depth)

    def _deviation_deg(self, frame: Frame) -> float:
        m, matched = self.tracker.map, frame.point >= 0
        points, octaves = m.arrays.pt_xyz[frame.point[matched]], frame.features.octave[matched]
        deviation = direction_deviation(
            frame.T_cam_map, points, m.view.inv_sigma2[octaves], m.view.fx, m.view.fy
        )
        return float(np.rad2deg(deviation))


def _divided(
    earlier: Sequence[Withdrawn], map_id: int, frame: Frame, reach: Reach | None
) -> tuple[tuple[tuple[float, str], ...], tuple[tuple[float, str], ...]]:
    """Faults of the probations that a frame's pose goes on from, and of the others.

    A place that looks like where the camera is goes with it: what was withdrawn is found again a frame later,
    some way on.
    """
    inherited: tuple[tuple[float, str], ...] = ()
    others: tuple[tuple[float, str], ...] = ()
    centre, stamp_s = camera_centre(frame.T_cam_map), frame.features.stamp_s
    for old in earlier:
        if (
            reach is not None
            and old.map_id == map_id
            and reach.follows(centre, stamp_s, old.centre, old.stamp_s)
        ):
            inherited += tuple(fault for fault in (*old.inherited, *old.faults) if fault not in inherited)
        else:
            others += old.faults
    return inherited, tuple(fault for fault in others if fault not in inherited)
