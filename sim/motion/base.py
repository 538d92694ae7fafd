"""Interface of camera motions: pose, velocity and angular rate at any time."""

from typing import Protocol

import numpy as np


class Motion(Protocol):
    """A smooth camera motion; times are sequence times, seconds, scalar or (N,)."""

    def T_world_cam(self, stamp_s: float | np.ndarray) -> np.ndarray:
        """(..., 4, 4) camera (x right, y down, z forward) to world."""
        ...

    def velocity_mps(self, stamp_s: float | np.ndarray) -> np.ndarray:
        """(..., 3) velocity of the camera's centre, world frame."""
        ...

    def rate_radps(self, stamp_s: float | np.ndarray) -> np.ndarray:
        """(..., 3) angular rate of the camera, camera frame."""
        ...
