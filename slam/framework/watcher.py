"""Losses of a system that declares none: motion beyond what its own steps allow."""

import numpy as np

_LEAST_STEPS = 30
_UNLIKELY = 1e-4
"""Chance with which a frame of a system that is not lost may be suspected."""


class Watcher:
    """Watches the poses of one map, frame by frame.

    A step is expected to be like the one before. It is suspected if it is longer, or turns more, than every
    step so far and what it differs by is beyond all such differences. Of n + 1 differences drawn alike, whose
    tail falls with the square at least, the newest exceeds c times all others with a chance of
    1 / ((n + 1) c²) at most: it is the largest with 1 / (n + 1), and c times larger than the next with
    1 / c². So c is the root of 1 / ((n + 1) ``_UNLIKELY``), but 1 at least.

    Source: derived here.
    """

    def __init__(self) -> None:
        self._last: list[np.ndarray] = []
        self._longest, self._largest = np.zeros(2), np.zeros(2)
        self._steps = 0

    def suspicion(self, T_map_cam: np.ndarray) -> str:
        """Take a (4, 4) pose; why it is suspected, or nothing."""
        poses = self._last = [*self._last[-2:], T_map_cam]
        if len(poses) < 3:
            return ""
        before, last, now = poses
        former, step = np.linalg.inv(before) @ last, np.linalg.inv(last) @ now
        length, differs = _sizes(step), _sizes(np.linalg.inv(former) @ step)
        most = max(1.0, 1.0 / np.sqrt((self._steps + 1) * _UNLIKELY)) * self._largest
        if self._steps >= _LEAST_STEPS and bool(((differs > most) & (length > self._longest)).any()):
            return "beyond_its_own_steps"
        self._longest, self._largest = np.maximum(self._longest, length), np.maximum(self._largest, differs)
        self._steps += 1
        return ""


def _sizes(T: np.ndarray) -> np.ndarray:
    """Length and angle, rad, of a (4, 4) motion."""
    angle = np.arccos(np.clip((np.trace(T[:3, :3]) - 1.0) / 2.0, -1.0, 1.0))
    return np.array([np.linalg.norm(T[:3, 3]), angle])
