"""Self-doubt: a camera whose estimated motion cannot be believed, noticed from inside."""

from collections import deque
from itertools import takewhile
from typing import NamedTuple, Self

import numpy as np

from dslab.slam.core._frame_kernels import median_depth
from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import camera_centre
from dslab.slam.core.settings import setting, settings
from dslab.slam.tracking._doubt_kernels import median_angles

_MIN_POINTS = 10


@settings
class DoubtConfig:
    """Bounds of a motion that is believed."""

    window_s: float = setting(1.0, "time in which the motion is judged")
    memory_s: float = setting(4.0, "time before, from which the usual motion is known")
    min_frames: int = setting(8, "fewest frames in each of the two times")
    unsteady: float = setting(
        0.5, "hidden motion of a frame over the usual step, beyond which it is unsteady"
    )
    least: float = setting(0.02, "hidden motion up to which no frame is unsteady", unit="rad")
    min_share: float = setting(0.5, "share of unsteady frames that is doubted; 0: never", le=1)
    nearer: float = setting(2.0, "fall of depth on new points, with slower, that is doubted; 0: never")
    slower: float = setting(8.0, "fall of speed on new points, with nearer, that is doubted; 0: never")
    shrunk: float = setting(2.0, "fall of both that is doubted since a frame with an uncertain direction")
    uncertain_deg: float = setting(0.12, "standard deviation of the camera's direction of such a frame")
    uncertain_memory_s: float = setting(15.0, "time for which such a frame is remembered")


class Motion(NamedTuple):
    """Motion of the camera between two frames; angles are those under which it moves the points, rad.

    Attributes:
        frame: index of the later frame.
        stamp_s: its time.
        step: by the change of position alone, since the last frame.
        hidden: likewise against the predicted pose, less what the points move in the image: the change of
            position that a turn makes invisible.
        depth: median depth of the points, map units.
        speed: map units per second.
        born_s: median time at which the points were made.
        deviation: standard deviation of the camera's direction, as the points determine it, rad.
    """

    frame: int
    stamp_s: float
    step: float
    hidden: float
    depth: float
    speed: float
    born_s: float
    deviation: float

    def falls_to(self, now: "Motion") -> tuple[float, float]:
        """By which factors depth and speed fall to those of a later motion."""
        return self.depth / now.depth, self.speed / now.speed


_FRAME, _STAMP_S, _HIDDEN, _SPEED = (Motion._fields.index(n) for n in ("frame", "stamp_s", "hidden", "speed"))


class UncertainDirection(NamedTuple):
    """A frame whose points hardly hold the camera's direction.

    Attributes:
        frame: its index.
        stamp_s: its time.
        before: the usual motion before it.
    """

    frame: int
    stamp_s: float
    before: Motion


def hidden_motion(points: np.ndarray, T_cam_map: np.ndarray, T_other_map: np.ndarray) -> tuple[float, float]:
    """Median angles by which a change of pose moves points, rad: by its translation alone, and how much of
    this its turn takes back.

    Args:
        points: (N, 3), frame map.
        T_cam_map: (4, 4) pose after the change.
        T_other_map: (4, 4) pose before.
    """
    alone, seen = median_angles(
        np.ascontiguousarray(points, np.float64),
        np.ascontiguousarray(T_cam_map, np.float64),
        np.ascontiguousarray(T_other_map, np.float64),
    )
    return float(alone), max(0.0, float(alone - seen))


class Doubt:
    """Watches the motion of one tracker, forward or backward in time.

    Where little holds a pose, such as a wall that fills the view, a turn and a change of position look alike.
    The estimate then wanders between them from frame to frame, by as much as the camera really moves, while
    the image shows next to nothing of it. No camera moves so, and the map grows along these poses.

    Or it takes all motion for a turn. New points are then triangulated over next to no baseline, ever nearer:
    the map shrinks, and speed and depth with it. A camera that really stops before something near makes no
    new points there, as it has no parallax. Once the view has hung on one side, a smaller fall tells, and it
    may come step by step: from there on the scale is handed on by what was then in view.

    Few unsteady frames are forgiven, but not the last ones before a loss.

    Attributes:
        reason: why the map is doubted; empty while it is not.
        first_frame: first frame of the doubt, -1 while there is none.
    """

    def __init__(self, config: DoubtConfig) -> None:
        self.config = config
        self.reason = ""
        self.first_frame = -1
        self._motions: deque[Motion] = deque()
        self._steady = np.inf
        self._uncertain: UncertainDirection | None = None

    def lose(self) -> None:
        """Tracking is lost: the last frames before that are doubted as far back as they were unsteady."""
        unsteady = list(takewhile(lambda m: m.hidden > self._steady, reversed(self._motions)))
        if unsteady and not self.reason and self.config.min_share > 0:
            self._declare("motion_beyond_prediction", unsteady[-1].frame)

    def successor(self) -> Self:
        """Doubt of a tracker that goes on in the same map; it knows the motion that is still believed."""
        new = type(self)(self.config)
        new._motions.extend(m for m in self._motions if m.frame < self.first_frame)
        return new

    def tie_scale(self) -> None:
        """A loop has given the map its scale back: what the view hung on before tells no more."""
        self._uncertain = None

    def note(
        self,
        frame: Frame,
        last: Frame,
        T_predicted_map: np.ndarray,
        points: np.ndarray,
        born_s: float,
        deviation: float,
    ) -> None:
        """Take note of a tracked frame.

        Args:
            frame: the frame, with its pose.
            last: the frame before.
            T_predicted_map: (4, 4) pose of the frame as expected before.
            points: (N, 3) its points, frame map.
            born_s: median time at which they were made.
            deviation: standard deviation of the camera's direction, as they determine it, rad.
        """
        if len(points) < _MIN_POINTS:
            return
        T, T_last, stamp_s = frame.T_cam_map, last.T_cam_map, frame.features.stamp_s
        step, _ = hidden_motion(points, T, T_last)
        _, hidden = hidden_motion(points, T, T_predicted_map)
        depth = median_depth(points, T)
        path = float(np.linalg.norm(camera_centre(T) - camera_centre(T_last)))
        speed = path / abs(stamp_s - last.features.stamp_s)
        self._motions.append(
            Motion(frame.features.index, stamp_s, step, hidden, depth, speed, born_s, deviation)
        )
        self._note_uncertainty()
        self._forget(stamp_s)
        self._judge(stamp_s)

    def _note_uncertainty(self) -> None:
        newest, config = self._motions[-1], self.config
        if self._uncertain and abs(newest.stamp_s - self._uncertain.stamp_s) > config.uncertain_memory_s:
            self._uncertain = None
        earlier = list(self._motions)[:-1]
        is_uncertain = newest.deviation > np.deg2rad(config.uncertain_deg)
        if is_uncertain and not self._uncertain and len(earlier) >= config.min_frames:
            self._uncertain = UncertainDirection(
                newest.frame, newest.stamp_s, Motion(*np.median(earlier, axis=0))
            )

    def _forget(self, stamp_s: float) -> None:
        span_s = self.config.window_s + self.config.memory_s
        while abs(stamp_s - self._motions[0].stamp_s) > span_s:
            self._motions.popleft()

    def _judge(self, stamp_s: float) -> None:
        motions = np.array(self._motions)
        recent = np.abs(stamp_s - motions[:, _STAMP_S]) < self.config.window_s
        if min(recent.sum(), (~recent).sum()) < self.config.min_frames:
            return
        usual = np.median(motions[~recent], axis=0)
        self._steady = max(self.config.unsteady * Motion(*usual).step, self.config.least)
        self._judge_steadiness(motions[recent])
        if not self.reason:
            self._judge_scale(motions, recent, Motion(*usual))

    def _judge_steadiness(self, recent: np.ndarray) -> None:
        unsteady = np.flatnonzero(recent[:, _HIDDEN] > self._steady)
        if 0 < self.config.min_share * len(recent) <= len(unsteady):
            self._declare("motion_beyond_prediction", recent[unsteady[0], _FRAME])

    def _judge_scale(self, motions: np.ndarray, recent: np.ndarray, usual: Motion) -> None:
        config, now = self.config, Motion(*np.median(motions[recent], axis=0))
        if min(now.depth, now.speed, config.nearer, config.slower) <= 0:
            return
        nearer, slower = usual.falls_to(now)
        is_new = _is_made_since(motions[~recent][-1, _STAMP_S], now)
        if is_new and nearer > config.nearer and slower > config.slower:
            usually = np.flatnonzero(motions[:, _SPEED] >= 0.5 * usual.speed)
            self._declare("scale_of_new_points", motions[min(usually[-1] + 1, len(motions) - 1), _FRAME])
        since = self._uncertain
        if since and _is_made_since(since.stamp_s, now) and min(since.before.falls_to(now)) > config.shrunk:
            self._declare("scale_of_new_points", since.frame)

    def _declare(self, reason: str, first_frame: float) -> None:
        self.reason, self.first_frame = reason, int(first_frame)


def _is_made_since(stamp_s: float, now: Motion) -> bool:
    """Return True if the points in view were made since a time, in either direction of time."""
    return (now.born_s - stamp_s) * (now.stamp_s - stamp_s) > 0
