"""The rule by which direct tracking is declared lost.

A direct method aligns any image somehow. It is lost in a frame that does not look like the map: whose
residuals are far above the usual ones, or mostly beyond the cutoff; whose patterns do not correlate with it,
so that a change of brightness alone explains it; that shows hardly any of the newest
keyframe's points; whose motion is far beyond that of the last frames; or that has turned where it shifted
before, or the other way round: on surfaces of alike depths both move the image alike, and where it is blurred
nothing else tells them apart.
"""

from collections import deque

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.slam.ldso.config import LossConfig
from dslab.slam.ldso.tracking import Tracked

_USUAL = 30  # frames
_SPEEDS = 10


class LossRule:
    """Decides frame by frame whether tracking is lost.

    Args:
        config: settings.
    """

    def __init__(self, config: LossConfig) -> None:
        self.config = config
        self._errors: deque[float] = deque(maxlen=_USUAL)
        self._steps: deque[tuple[float, float]] = deque(maxlen=_SPEEDS)
        self._flow: tuple[np.ndarray, np.ndarray] | None = None  # of the last frame

    def reason(self, tracked: Tracked | None, step: np.ndarray, depth: float) -> str:
        """Why a frame is not tracked; empty if it is.

        Args:
            tracked: its alignment.
            step: (4, 4) motion since the last frame.
            depth: usual depth of the map's points.
        """
        if tracked is None or tracked.visible < self.config.least_visible:
            return "too_little_in_view"
        if self._differs(tracked):
            return "images_differ"
        if self._jumps(step, depth):
            return "motion_jumps"
        return "turn_for_shift" if self._trades(step, depth) else ""

    def _differs(self, tracked: Tracked) -> bool:
        """True if the image does not look like the map."""
        config = self.config
        usual = max(config.least_error, float(np.median(self._errors)) if self._errors else 0.0)
        return (
            tracked.error > min(config.most_error, config.error_factor * usual)
            or tracked.saturated > config.most_saturated
            or tracked.likeness < config.least_likeness
        )

    def _jumps(self, step: np.ndarray, depth: float) -> bool:
        """True if a motion is far beyond the largest of the last frames."""
        if not self._steps:
            return False
        config, (far, turn) = self.config, _size(step, depth)
        usual_far, usual_turn = np.max(self._steps, axis=0)
        return bool(
            far > max(config.least_jump_depths, config.most_jump * usual_far)
            or turn > max(np.deg2rad(config.least_jump_deg), config.most_jump * usual_turn)
        )

    def _trades(self, step: np.ndarray, depth: float) -> bool:
        """True if shift and turn have changed against each other, so that the image moves on as before."""
        if self._flow is None:
            return False
        shift, turn = (now - last for now, last in zip(_flow(step, depth), self._flow, strict=True))
        sizes = np.linalg.norm(shift), np.linalg.norm(turn)
        left = np.linalg.norm(shift + turn) / max(*sizes, 1e-12)
        return bool(min(sizes) > np.deg2rad(self.config.most_trade_deg) and left < self.config.most_left)

    def tracked(self, tracked: Tracked, step: np.ndarray, depth: float) -> None:
        """Learn from a frame that was tracked."""
        self._errors.append(tracked.error)
        self._steps.append(_size(step, depth))
        self._flow = _flow(step, depth)


def _size(step: np.ndarray, depth: float) -> tuple[float, float]:
    """Length of a motion in depths, and its angle in rad."""
    turn = Rotation.from_matrix(step[:3, :3]).magnitude()
    return float(np.linalg.norm(step[:3, 3]) / depth), float(turn)


def _flow(step: np.ndarray, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """(2,) how the image's centre moves by the translation at a depth, and (2,) by the rotation, in rad."""
    turn = Rotation.from_matrix(step[:3, :3]).as_rotvec()
    return step[:2, 3] / depth, np.array([turn[1], -turn[0]])
