"""The rule by which direct tracking is declared lost.

A direct method aligns any image somehow. It is lost in a frame that does not look like the map: whose
residuals are far above the usual ones, or mostly beyond the cutoff; whose patterns do not correlate with it,
so that a change of brightness alone explains it; that shows hardly any of the newest
keyframe's points; or whose motion is far beyond that of the last frames.
"""

from collections import deque

import numpy as np
from scipy.spatial.transform import Rotation

from slam.ldso.config import LossConfig
from slam.ldso.tracking import Tracked

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
        return "motion_jumps" if self._jumps(step, depth) else ""

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

    def tracked(self, tracked: Tracked, step: np.ndarray, depth: float) -> None:
        """Learn from a frame that was tracked."""
        self._errors.append(tracked.error)
        self._steps.append(_size(step, depth))


def _size(step: np.ndarray, depth: float) -> tuple[float, float]:
    """Length of a motion in depths, and its angle in rad."""
    turn = Rotation.from_matrix(step[:3, :3]).magnitude()
    return float(np.linalg.norm(step[:3, 3]) / depth), float(turn)
