"""A SLAM system of one's own: it believes that the camera drives and turns steadily, and never looks.

dslab run clean-room --system base,examples/own_slam.py:ConstantVelocity --out out/own
"""

import numpy as np


class ConstantVelocity:
    """Half a metre per second and three degrees per second, whatever the images show."""

    def __init__(self, camera, seed):
        self.T_map_cam, self.last_s = np.eye(4), None

    def process(self, image, stamp_s):
        """Return T_map_cam (4, 4), camera to map, or None where the pose is not known."""
        step_s = 0.0 if self.last_s is None else stamp_s - self.last_s
        turn, self.last_s = np.deg2rad(3) * step_s, stamp_s
        T_last_cam = np.eye(4)
        T_last_cam[:3, 3] = 0, 0, 0.5 * step_s
        T_last_cam[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(turn), np.sin(turn), -np.sin(turn), np.cos(turn)
        self.T_map_cam = self.T_map_cam @ T_last_cam
        return self.T_map_cam
