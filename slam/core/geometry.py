"""View geometry for the kernels: camera, feature grid and scale pyramid."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.slam.core.camera import PinholeCamera

CELL_PX = 16.0


class ViewGeometry(NamedTuple):
    """Intrinsics, undistorted image bounds, feature grid and pyramid, as plain numbers and arrays.

    Attributes:
        fx, fy, cx, cy: intrinsics, px.
        x_min, y_min, x_max, y_max: bounds of undistorted keypoints, px.
        cell: side of a grid cell, px.
        cols, rows: cells of the feature grid.
        log_scale: natural logarithm of the pyramid's scale factor.
        scale: (n_levels,) float64, scale of each pyramid level.
        inv_sigma2: (n_levels,) float64, information of a keypoint of each level, 1/px².
    """

    fx: float
    fy: float
    cx: float
    cy: float
    x_min: float
    y_min: float
    x_max: float
    y_max: float
    cell: float
    cols: int
    rows: int
    log_scale: float
    scale: np.ndarray
    inv_sigma2: np.ndarray

    @property
    def intrinsics(self) -> np.ndarray:
        """(4,) fx, fy, cx, cy, px."""
        return np.array([self.fx, self.fy, self.cx, self.cy])


def view_geometry(
    camera: PinholeCamera, n_levels: int, scale_factor: float, noise_px: float = 1.0
) -> ViewGeometry:
    """View geometry of a camera with a feature pyramid, its keypoints ``noise_px`` of a level off."""
    x_min, y_min, x_max, y_max = camera.undistorted_bounds()
    scale = scale_factor ** np.arange(n_levels, dtype=np.float64)
    return ViewGeometry(
        float(camera.fx),
        float(camera.fy),
        float(camera.cx),
        float(camera.cy),
        float(x_min),
        float(y_min),
        float(x_max),
        float(y_max),
        CELL_PX,
        int(np.ceil((x_max - x_min) / CELL_PX)) + 1,
        int(np.ceil((y_max - y_min) / CELL_PX)) + 1,
        float(np.log(scale_factor)),
        scale,
        1.0 / (noise_px * scale) ** 2,
    )


def camera_centre(T_cam_map: np.ndarray) -> np.ndarray:
    """(3,) position of a camera in the map, from its (4, 4) pose."""
    return -T_cam_map[:3, :3].T @ T_cam_map[:3, 3]


def share_of_motion(T: np.ndarray, share: float) -> np.ndarray:
    """Return the share, from 0 to 1, of a small rigid motion (4, 4)."""
    part = np.eye(4)
    part[:3, :3] = Rotation.from_rotvec(share * Rotation.from_matrix(T[:3, :3]).as_rotvec()).as_matrix()
    part[:3, 3] = share * T[:3, 3]
    return part


def adjoint(T: np.ndarray) -> np.ndarray:
    """(..., 6, 6) by which a twist (translation, rotation) is moved to the other side of T (..., 4, 4)."""
    R, t = T[..., :3, :3], T[..., :3, 3]
    skew = np.zeros_like(R)
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = -t[..., 2], t[..., 1], -t[..., 0]
    skew -= np.swapaxes(skew, -1, -2)
    moved = np.zeros((*T.shape[:-2], 6, 6))
    moved[..., :3, :3] = moved[..., 3:, 3:] = R
    moved[..., :3, 3:] = skew @ R
    return moved
