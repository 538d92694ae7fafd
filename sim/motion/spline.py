"""Pose splines, quintic in position and in yaw, pitch and roll."""

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

# Columns: the camera's right, down and forward, in a body frame of x forward, y left, z up.
_BODY_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


class PoseSpline:
    """A motion through knots, four times continuously differentiable, never looking straight up or down.

    Args:
        knots_s: (M,) increasing times, M >= 6.
        position_m: (M, 3) camera centres, world frame, z up.
        yaw_pitch_roll: (M, 3) radians: yaw about z (0 looks along +x), pitch upward, roll to the right;
            unwrapped, |pitch| < pi/2.
        slowdown: factor by which time is stretched; 2 takes twice as long.
    """

    def __init__(
        self, knots_s: np.ndarray, position_m: np.ndarray, yaw_pitch_roll: np.ndarray, slowdown: float = 1.0
    ) -> None:
        self._pose = make_interp_spline(knots_s, np.column_stack([position_m, yaw_pitch_roll]), k=5)
        self._rate = self._pose.derivative()
        self._slowdown = slowdown

    def T_world_cam(self, stamp_s: float | np.ndarray) -> np.ndarray:
        """See ``Motion``."""
        pose = self._pose(np.asarray(stamp_s, float) / self._slowdown)
        T = np.zeros((*pose.shape[:-1], 4, 4))
        yaw, pitch, roll = np.moveaxis(pose[..., 3:], -1, 0)
        turns = np.stack([yaw, -pitch, roll], axis=-1)
        T[..., :3, :3] = Rotation.from_euler("ZYX", turns).as_matrix() @ _BODY_CAM
        T[..., :3, 3] = pose[..., :3]
        T[..., 3, 3] = 1.0
        return T

    def velocity_mps(self, stamp_s: float | np.ndarray) -> np.ndarray:
        """See ``Motion``."""
        return self._rate(np.asarray(stamp_s, float) / self._slowdown)[..., :3] / self._slowdown

    def rate_radps(self, stamp_s: float | np.ndarray) -> np.ndarray:
        """See ``Motion``. Source: the kinematics of intrinsic z-y-x Euler angles."""
        own_s = np.asarray(stamp_s, float) / self._slowdown
        _, pitch, roll = np.moveaxis(self._pose(own_s)[..., 3:], -1, 0)
        yaw_rate, pitch_rate, roll_rate = np.moveaxis(self._rate(own_s)[..., 3:], -1, 0) / self._slowdown
        tilt, tilt_rate = -pitch, -pitch_rate
        body = np.stack(
            [
                roll_rate - yaw_rate * np.sin(tilt),
                tilt_rate * np.cos(roll) + yaw_rate * np.cos(tilt) * np.sin(roll),
                -tilt_rate * np.sin(roll) + yaw_rate * np.cos(tilt) * np.cos(roll),
            ],
            axis=-1,
        )
        return body @ _BODY_CAM
