"""Corners among the selected pixels of a keyframe, described so that they are recognised.

Where a cell of the selection holds a corner, it takes the place of the pixel that was selected there. Both
are points of the odometry alike; but a corner is found at the same place of the surface again.

Source: Gao, Wang, Demmel, Cremers, "LDSO: Direct Sparse Odometry with Loop Closure", 2018, Sec. III-B; Shi,
Tomasi, "Good Features to Track", 1994.
"""

import cv2
import numpy as np

from dslab.slam.core._frame_kernels import sort_into_cells
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import FrameFeatures
from dslab.slam.core.geometry import ViewGeometry, view_geometry
from dslab.slam.direct.selection import Selection
from dslab.slam.features._orb_kernels import BORDER_PX, descriptors, orientations
from dslab.slam.ldso._corner_kernels import gradient_products, lesser_eigenvalues, peaks
from dslab.slam.ldso.config import CornerConfig

_BLUR = cv2.getGaussianKernel(7, 2)  # that of ORB
# All corners are of the image's own resolution. It is level 2 of the map's pyramid, so that a point counts as
# visible from 1.44 times the distance to 1 / 1.2 of it.
_LEVELS, _OWN_LEVEL, _FACTOR = 4, 2, 1.2


def corner_view(camera: PinholeCamera, config: CornerConfig) -> ViewGeometry:
    """View geometry of a map of corners."""
    view = view_geometry(camera, _LEVELS, _FACTOR)
    return view._replace(inv_sigma2=np.full(_LEVELS, 1.0 / config.noise_px**2))


def with_corners(found: Selection, level: np.ndarray, config: CornerConfig) -> tuple[Selection, np.ndarray]:
    """A selection that has a corner instead of a pixel, one at most in every cell that holds both.

    Args:
        found: selected pixels.
        level: (H, W, 3) intensity and gradient.
        config: settings.

    Returns:
        The selection, and (N,) bool: this one is a corner.
    """
    height, width = level.shape[:2]
    side = max(1.0, np.sqrt(height * width / max(1, len(found.xy))))
    corners = _strongest(corners_of(level, config), side, width)
    cell = _cells(found.xy, side, width)
    _, first = np.unique(cell, return_index=True)
    _, pixel, corner = np.intersect1d(
        cell[first], _cells(corners, side, width), assume_unique=True, return_indices=True
    )
    xy, scale, is_corner = found.xy.copy(), found.scale.copy(), np.zeros(len(found.xy), bool)
    xy[first[pixel]], scale[first[pixel]], is_corner[first[pixel]] = corners[corner], 0, True
    order = np.lexsort((~is_corner, xy[:, 0], xy[:, 1]))  # a corner before a pixel at the same place
    _, kept = np.unique(xy[order] @ [1, width], return_index=True)
    kept = np.sort(order[kept])
    return Selection(xy[kept], scale[kept]), is_corner[kept]


def corners_of(level: np.ndarray, config: CornerConfig) -> np.ndarray:
    """(N, 2) int32 pixels where intensity changes in every direction, more than about them; best first."""
    products, weaker = np.empty(level.shape, np.float32), np.empty(level.shape[:2], np.float32)
    gradient_products(level, products)
    cv2.blur(products, (config.window_px, config.window_px), dst=products)
    lesser_eigenvalues(products, weaker)
    xy = peaks(
        weaker, level, config.least_gradient**2, BORDER_PX, config.apart_px // 2, config.window_px // 2
    )
    x, y = xy.T
    order = np.argsort(-weaker[y, x], kind="stable")
    return xy[order]


def described(
    level: np.ndarray, xy: np.ndarray, frame: int, stamp_s: float, camera: PinholeCamera, view: ViewGeometry
) -> FrameFeatures:
    """Features of corners.

    Args:
        level: (H, W, 3) of the ideal camera.
        xy: (N, 2) int32 corners.
        frame, stamp_s: the frame.
        camera, view: of it.
    """
    order, cell_start = sort_into_cells(xy.astype(float), view)
    xy = xy[order]
    image = np.clip(np.nan_to_num(level[..., 0]), 0, 255).astype(np.uint8)
    blurred = cv2.sepFilter2D(image, -1, _BLUR, _BLUR, borderType=cv2.BORDER_REFLECT_101)
    x, y = np.ascontiguousarray(xy[:, 0]), np.ascontiguousarray(xy[:, 1])
    angles = orientations(image, x, y)
    ideal = xy.astype(float)
    taken = camera.distort_points(ideal) if len(xy) else ideal
    return FrameFeatures(
        frame, stamp_s, taken.astype(np.float32), ideal,
        np.full(len(xy), _OWN_LEVEL, np.int32), angles, descriptors(blurred, x, y, angles), cell_start,
        camera,
    )  # fmt: skip


def _cells(xy: np.ndarray, side: float, width: int) -> np.ndarray:
    """(N,) cell of each pixel, of square cells row by row."""
    columns = int(width / side) + 1
    return (xy[:, 1] / side).astype(int) * columns + (xy[:, 0] / side).astype(int)


def _strongest(corners: np.ndarray, side: float, width: int) -> np.ndarray:
    """The first corner of every cell, by cell."""
    _, first = np.unique(_cells(corners, side, width), return_index=True)
    return corners[first]
