"""How far a predicted pose may be off: by what the motion model was off lately."""

import numpy as np

from dslab.slam.core._frame_kernels import motion_between

_PRIOR_FRAMES = 1.0
"""Innovations that the prior is worth."""
_MEMORY = 0.95
"""Weight of an innovation against the one after it: twenty frames are remembered."""
_ROTATION, _TRANSLATION = 0.03, 0.03
"""Standard deviations of the prior: a change of velocity in a frame of rad, and of depths. A hand turns by
about 10 rad/s²: .03 rad at 18 frames/s."""


class MotionBelief:
    """The motion model's errors, from frame to frame.

    A frame's velocity is the last one's plus a normal change, whose variance along each axis its own
    innovations tell. Translations are in median depths of the view.
    """

    def __init__(self) -> None:
        prior = np.repeat([_TRANSLATION, _ROTATION], 3) ** 2
        self._sum, self._weight, self._prior = np.zeros(6), 0.0, prior

    @property
    def variance(self) -> np.ndarray:
        """(6,) of the change of velocity within a frame: translation in depths, rotation in rad."""
        return (self._sum + _PRIOR_FRAMES * self._prior) / (self._weight + _PRIOR_FRAMES)

    def note(self, predicted: np.ndarray, found: np.ndarray, depth: float) -> None:
        """Learn from a pose (4, 4) that was found where another was predicted; ``depth`` of the view."""
        innovation = motion_between(*(np.ascontiguousarray(T, np.float64) for T in (predicted, found)))
        innovation[:3] /= depth
        self._sum = _MEMORY * self._sum + innovation**2
        self._weight = _MEMORY * self._weight + 1.0

    def predicted(self, covariance: np.ndarray, steps: int, depth: float) -> np.ndarray:
        """(6, 6) covariance of a pose predicted over some frames, as a twist from the left.

        Args:
            covariance: (6, 6) of the pose that it is predicted from.
            steps: number of frames since; changes of velocity add up to n (n + 1) (2n + 1) / 6 of one.
            depth: of the view.
        """
        spread = self.variance * steps * (steps + 1) * (2 * steps + 1) / 6.0
        spread[:3] *= depth**2
        return np.where(np.isfinite(covariance), covariance, 0.0) + np.diag(spread)
