"""Probation of a relocalization: the frames that follow tell whether it is there, before it counts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from dslab.slam.belief.belief import DISBELIEVED, Belief
from dslab.slam.belief.config import BeliefConfig
from dslab.slam.belief.log import note
from dslab.slam.belief.model import Unseen, come
from dslab.slam.belief.sight import sight_of
from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import camera_centre
from dslab.slam.map._map_kernels import median_depth
from dslab.slam.map.map import Map
from dslab.slam.tracking.doubt import Doubt
from dslab.slam.tracking.local_map import local_map
from dslab.slam.tracking.reach import Reach
from dslab.slam.tracking.tracker import Tracker, TrackingOutcome


class Verdict(StrEnum):
    """State of a probation."""

    PENDING = "pending"
    CONFIRMED = "confirmed"
    WITHDRAWN = "withdrawn"


@dataclass(frozen=True, eq=False)
class Withdrawn:
    """What is kept of a probation that was withdrawn.

    Attributes:
        map_id: the map.
        centre: (3,) last position of the camera there, frame map.
        stamp_s: time of that position.
        belief: what its views have said.
    """

    map_id: int
    centre: np.ndarray
    stamp_s: float
    belief: Belief


class Probation:
    """A relocalized frame and the frames tracked since; the map is left unchanged.

    Args:
        map_id: the map.
        frame: the relocalized frame.
        keyframe: the recognised keyframe.
        tracker: of the same map, not yet started.
        config: settings; None if the pose counts at once.
        lost_at_s: time of the loss.
        earlier: probations that were withdrawn since the loss, in order. The camera that can have come from
            one of them goes on with what was said there; where it cannot, one of the two places is another.
        reach: how far the camera can have come in a time; None if unknown.
        doubt: for which the map was lost, if it was; what made the poses wander then may still be in view, so
            that the frames must be as many as it takes to doubt them.

    Attributes:
        frames: the relocalized frame and those tracked since; once it is confirmed, without those before the
            first view that spoke for the place, if others came before it.
        belief: what they say; None if the pose counts at once.
        verdict: whether it has ended, and how.
        reason: reason of a withdrawal; empty otherwise.
    """

    def __init__(
        self,
        map_id: int,
        frame: Frame,
        keyframe: int,
        tracker: Tracker,
        config: BeliefConfig | None,
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
        self.belief: Belief | None = None
        tracker.resume(frame)
        if config is None:
            self.verdict = Verdict.CONFIRMED
            return
        self._config, self._reach, self._lost_at_s = config, reach, lost_at_s
        self._least_frames = 2
        if doubt is not None:
            tracker.doubt = doubt.successor()
            self._least_frames = doubt.config.min_frames + 2
        tracker.observing = False
        self._sound_from, self._spoken = 0, False
        self._unlikely_since_s = frame.features.stamp_s
        same = [one for one in earlier if self._goes_on_from(one)]
        self._rivals = [one.belief.log_odds for one in earlier if one not in same]
        self.belief = Belief("relocalization", self._unseen(), same[-1].belief if same else None)
        self._note(frame)

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
        self._ask(frame)
        self._decide()
        confirmed = self.verdict is Verdict.CONFIRMED
        return TrackingOutcome(
            confirmed, outcome.inliers, outcome.matches, "" if confirmed else "on_probation"
        )

    def withdraw(self, reason: str) -> None:
        """End it without confirmation."""
        self.verdict, self.reason = Verdict.WITHDRAWN, reason

    @property
    def believed(self) -> float | None:
        """Chance that it is right; None if no belief was asked."""
        return None if self.belief is None else self.belief.chance(self._rivals)

    def withdrawn(self) -> Withdrawn:
        """What is kept of it for those that come after."""
        last = self.frames[-1]
        assert self.belief is not None
        return Withdrawn(self.map_id, camera_centre(last.T_cam_map), last.features.stamp_s, self.belief)

    def _decide(self) -> None:
        assert self.belief is not None
        now_s, log_odds = self.frames[-1].features.stamp_s, self.belief.over(self._rivals)
        if len(self.frames) >= self._least_frames and self.belief.is_beyond(self._config.alpha, self._rivals):
            self.verdict = Verdict.CONFIRMED
            self.frames = self.frames[min(self._sound_from, len(self.frames) - 1) :]
            self._sound_from = 0
            self.tracker.observing = True
        elif log_odds > 0:
            self._unlikely_since_s = now_s
        elif now_s - self._unlikely_since_s >= self._config.patience_s - 1e-6:
            self.withdraw(DISBELIEVED)

    def _points(self, frame: Frame) -> np.ndarray:
        return local_map(self.tracker.map, frame.point, self._config.around)[1]

    def _ask(self, frame: Frame) -> None:
        """Ask a view that did not suppose the place itself."""
        assert self.belief is not None
        m: Map = self.tracker.map
        depth = median_depth(m.arrays, self.keyframe)
        sight = sight_of(m, self._points(frame), frame.T_cam_map, frame.features, depth)
        self._spoken |= self.belief.add(sight) > 0
        if not self._spoken:
            self._sound_from = len(self.frames)
        self._note(frame)

    def _note(self, frame: Frame) -> None:
        m: Map = self.tracker.map
        supposed = self.map_id, self.first.features.index, m.frame_index(self.keyframe)
        assert self.belief is not None
        note(
            "relocalization", supposed, m, self.keyframe, frame.T_cam_map, frame.features,
            self._points(frame), self.belief.over(self._rivals), self._unseen,
        )  # fmt: skip

    def _unseen(self, reach: Reach | None = None) -> Unseen:
        first, m, reach = self.first, self.tracker.map, reach or self._reach
        if reach is None:
            return Unseen(first.features.stamp_s - self._lost_at_s)
        depth = median_depth(m.arrays, self.keyframe)
        return reach.unseen(camera_centre(first.T_cam_map), first.features.stamp_s, depth)

    def _goes_on_from(self, one: Withdrawn) -> bool:
        """Return True if the camera can have come here from where it was when another was withdrawn."""
        if self._reach is None or one.map_id != self.map_id:
            return one.map_id == self.map_id
        return come(self._unseen(replace(self._reach, centre=one.centre, stamp_s=one.stamp_s))) >= 0
