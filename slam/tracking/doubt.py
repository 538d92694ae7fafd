"""Self-doubt: a camera whose estimated motion cannot be believed, noticed from inside."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

_MIN_POINTS = 10


@dataclass(frozen=True)
class DoubtConfig:
    """Bounds of a motion that is believed.

    Attributes:
        window_s: time in which the motion is judged.
        memory_s: time before, from which the usual motion is known.
        min_frames: fewest frames in each of the two.
        unsteady: hidden change of position from frame to frame, over the usual step, beyond which a frame is
            unsteady.
        least: the same as an angle, rad; a smaller one is never unsteady.
        min_share: share of unsteady frames in the window from which the map is doubted; 0 never doubts.
    """

    window_s: float = 1.0
    memory_s: float = 4.0
    min_frames: int = 8
    unsteady: float = 0.5
    least: float = 0.02
    min_share: float = 0.4


class Motion(NamedTuple):
    """Motion of the camera between two frames, as angles under which it moves the points, rad.

    Attributes:
        frame: index of the later frame.
        stamp_s: its time.
        step: by the change of position alone, since the last frame.
        hidden: likewise against the predicted pose, less what the points move in the image: the change of
            position that a turn makes invisible.
    """

    frame: int
    stamp_s: float
    step: float
    hidden: float


def hidden_motion(points: np.ndarray, T_cam_map: np.ndarray, T_other_map: np.ndarray) -> tuple[float, float]:
    """Median angles by which a change of pose moves points, rad: by its translation alone, and how much of
    this its turn takes back.

    Args:
        points: (N, 3), frame map.
        T_cam_map: (4, 4) pose after the change.
        T_other_map: (4, 4) pose before.
    """
    now = points @ T_cam_map[:3, :3].T + T_cam_map[:3, 3]
    before = points @ T_other_map[:3, :3].T + T_other_map[:3, 3]
    R = T_cam_map[:3, :3] @ T_other_map[:3, :3].T
    turned = before @ R.T
    alone = float(np.median(_angles(now, turned)))
    return alone, max(0.0, alone - float(np.median(_angles(now, before))))


def _angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N,) angles between vectors, to second order, rad."""
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    b = b / np.linalg.norm(b, axis=1, keepdims=True)
    return np.linalg.norm(a - b, axis=1)


class Doubt:
    """Watches the motion of one tracker.

    Where little holds a pose, such as a wall that fills the view, a turn and a change of position look alike.
    The estimate then wanders between them from frame to frame, by as much as the camera really moves, while
    the image shows next to nothing of it. No camera moves so, and the map grows along these poses.

    Attributes:
        reason: why the map is doubted; empty while it is not.
        first_frame: first frame of the doubt, -1 while there is none.
    """

    def __init__(self, config: DoubtConfig) -> None:
        self.config = config
        self.reason = ""
        self.first_frame = -1
        self._motions: deque[Motion] = deque()

    def note(
        self,
        frame: int,
        stamp_s: float,
        points: np.ndarray,
        T_cam_map: np.ndarray,
        T_last_map: np.ndarray,
        T_predicted_map: np.ndarray,
    ) -> None:
        """Take note of a tracked frame.

        Args:
            frame: its index.
            stamp_s: its time.
            points: (N, 3) its points, frame map.
            T_cam_map: (4, 4) its pose.
            T_last_map: (4, 4) pose of the frame before.
            T_predicted_map: (4, 4) its pose as expected before.
        """
        if self.config.min_share <= 0 or len(points) < _MIN_POINTS:
            return
        step, _ = hidden_motion(points, T_cam_map, T_last_map)
        _, hidden = hidden_motion(points, T_cam_map, T_predicted_map)
        self._motions.append(Motion(frame, stamp_s, step, hidden))
        self._forget(stamp_s)
        self._judge(stamp_s)

    def _forget(self, stamp_s: float) -> None:
        oldest_s = stamp_s - self.config.window_s - self.config.memory_s
        while self._motions[0].stamp_s < oldest_s:
            self._motions.popleft()

    def _judge(self, stamp_s: float) -> None:
        begin_s = stamp_s - self.config.window_s
        before = [m.step for m in self._motions if m.stamp_s <= begin_s]
        recent = [m for m in self._motions if m.stamp_s > begin_s]
        if min(len(before), len(recent)) < self.config.min_frames:
            return
        bound = max(self.config.unsteady * float(np.median(before)), self.config.least)
        unsteady = [m for m in recent if m.hidden > bound]
        if len(unsteady) >= self.config.min_share * len(recent):
            self.reason = "motion_beyond_prediction"
            self.first_frame = unsteady[0].frame
