"""Where a view shows a point."""

from numba import njit


@njit(cache=True, nogil=True)
def project(T_cam_map, view, xyz):
    """Pixel and depth of a map point: (u, v, z); z <= 0 behind the camera."""
    x, y, z = xyz[0], xyz[1], xyz[2]
    xc = T_cam_map[0, 0] * x + T_cam_map[0, 1] * y + T_cam_map[0, 2] * z + T_cam_map[0, 3]
    yc = T_cam_map[1, 0] * x + T_cam_map[1, 1] * y + T_cam_map[1, 2] * z + T_cam_map[1, 3]
    zc = T_cam_map[2, 0] * x + T_cam_map[2, 1] * y + T_cam_map[2, 2] * z + T_cam_map[2, 3]
    if zc <= 1e-9:
        return 0.0, 0.0, -1.0
    return view.fx * xc / zc + view.cx, view.fy * yc / zc + view.cy, zc


@njit(cache=True, nogil=True)
def in_view(view, u, v):
    """Return True if a pixel lies within the undistorted image."""
    return view.x_min <= u < view.x_max and view.y_min <= v < view.y_max
