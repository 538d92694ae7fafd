"""What one camera sees of the surfaces in another's view, from exact depth images."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def seen_share(depth_m, other_depth_m, R_other_cam, t_other_cam, focal_px, centre_px, tolerance):
    """Share of the surface in a view that another camera of the same intrinsics sees too.

    The surface at a pixel is seen if it lies in the other image, shows it the same side, and nothing there is
    nearer than it by more than the tolerance.

    Args:
        depth_m: (H, W) float32 metres along the optical axis, 0 for no surface; H and W at least 2.
        other_depth_m: (H, W) float32, of the other camera.
        R_other_cam: (3, 3) float64 rotation from this camera to the other.
        t_other_cam: (3,) float64 metres, this camera's centre in the other's frame.
        focal_px: (2,) float64.
        centre_px: (2,) float64.
        tolerance: difference of depth, relative to the expected one, of what counts as the same surface.

    Returns:
        In [0, 1], of the pixels that show a surface; 0 if none does.
    """
    height, width = depth_m.shape
    # The other camera's centre in this camera's frame.
    eye = -(
        t_other_cam[0] * R_other_cam[0] + t_other_cam[1] * R_other_cam[1] + t_other_cam[2] * R_other_cam[2]
    )
    surface, seen = 0, 0
    for row in range(height):
        for column in range(width):
            z = np.float64(depth_m[row, column])
            if z <= 0:
                continue
            surface += 1
            x = (column - centre_px[0]) / focal_px[0]
            y = (row - centre_px[1]) / focal_px[1]
            depth = z * (R_other_cam[2, 0] * x + R_other_cam[2, 1] * y + R_other_cam[2, 2]) + t_other_cam[2]
            if depth <= 0:
                continue
            right = z * (R_other_cam[0, 0] * x + R_other_cam[0, 1] * y + R_other_cam[0, 2]) + t_other_cam[0]
            down = z * (R_other_cam[1, 0] * x + R_other_cam[1, 1] * y + R_other_cam[1, 2]) + t_other_cam[1]
            u = focal_px[0] * right / depth + centre_px[0]
            v = focal_px[1] * down / depth + centre_px[1]
            if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
                continue
            if _is_unhidden(other_depth_m, u, v, depth, tolerance) and _faces(
                depth_m, row, column, x, y, focal_px, eye
            ):
                seen += 1
    return seen / surface if surface else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _is_unhidden(depth_m, u, v, expected, tolerance):
    """True if one of the four pixels about (u, v), or the plane through them, has the expected depth."""
    height, width = depth_m.shape
    left = min(max(int(np.floor(u)), 0), width - 2)
    top = min(max(int(np.floor(v)), 0), height - 2)
    whole = True
    for row in range(top, top + 2):
        for column in range(left, left + 2):
            z = np.float64(depth_m[row, column])
            whole &= z > 0
            if z > 0 and abs(z - expected) <= tolerance * expected:
                return True
    if not whole:
        return False
    # Inverse depth is linear on a plane, also half a pixel beyond the outermost centres.
    part_u, part_v = u - left, v - top
    upper = (1 - part_u) / depth_m[top, left] + part_u / depth_m[top, left + 1]
    lower = (1 - part_u) / depth_m[top + 1, left] + part_u / depth_m[top + 1, left + 1]
    inverse = (1 - part_v) * upper + part_v * lower
    return inverse > 0 and abs(1 / inverse - expected) <= tolerance * expected


@njit(cache=True, nogil=True, error_model="numpy")
def _faces(depth_m, row, column, x, y, focal_px, eye):
    """True if ``eye``, (3,) in the camera's frame, is on the side of a pixel's surface that the camera sees.

    On the plane m . X = 1 the inverse depth is m . (x, y, 1); the camera is where m . X < 1.
    """
    inverse = 1 / np.float64(depth_m[row, column])
    across = focal_px[0] * _slope(depth_m, row, column, 0, 1, inverse)
    along = focal_px[1] * _slope(depth_m, row, column, 1, 0, inverse)
    ahead = inverse - across * x - along * y
    return across * eye[0] + along * eye[1] + ahead * eye[2] < 1


@njit(cache=True, nogil=True, error_model="numpy")
def _slope(depth_m, row, column, down, right, inverse):
    """Change of the inverse depth per pixel, towards the neighbour more likely on the same surface."""
    height, width = depth_m.shape
    slope, found = 0.0, False
    for sign in (-1, 1):
        next_row, next_column = row + sign * down, column + sign * right
        if not (0 <= next_row < height and 0 <= next_column < width):
            continue
        z = np.float64(depth_m[next_row, next_column])
        if z > 0:
            change = sign * (1 / z - inverse)
            if not found or abs(change) < abs(slope):
                slope, found = change, True
    return slope
