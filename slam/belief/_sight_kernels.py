"""What a view should show at a supposed place, and what it shows of it."""

import numpy as np
from numba import njit

from dslab.slam.association._kernels import CELLS, camera_at, expected_view, likeliest, spread_of_pixel
from dslab.slam.features._orb_kernels import BORDER_PX


@njit(cache=True, nogil=True, error_model="numpy")
def look(
    m, view, T_cam_map, noise2, loose2, candidates, xy, octave, descriptors, cell_start, first, density, odds
):
    """Look for points of a map in a view that is supposed to be at a pose.

    Args:
        m: MapArrays.
        view: ViewGeometry.
        T_cam_map: (4, 4) the pose, in lengths of the map.
        noise2: variance of the keypoints over what the view says.
        loose2: variance of where points are expected by the pose's own error, px² on level 0.
        candidates: (Q,) int32 points.
        xy, octave, descriptors, cell_start: keypoints; the view's rows start at ``first``.
        first: see there.
        density: (levels,) keypoints per px² of every octave.
        odds: (257,) by distance of descriptors.

    Returns:
        Of the n points that the view should show: rows (n,) int32; cell of the image (n,) int64; (n,) how
        much likelier the keypoints there are if one of them shows the point than if none does; change of
        view since the keyframe that saw it from nearest: angle (n,), rad, and distance (n,), its logarithm
        to base 2.
    """
    size, n = len(candidates), 0
    rows, cell = np.empty(size, np.int32), np.empty(size, np.int64)
    shown, angle, zoom = np.empty(size), np.empty(size), np.empty(size)
    side = (view.x_max - view.x_min) / CELLS
    centre, exact, J = camera_at(T_cam_map), np.zeros((6, 6)), np.zeros((2, 6))
    for p in candidates:
        if p < 0 or m.pt_bad[p]:
            continue
        u, v, level = expected_view(
            view, T_cam_map, centre, m.pt_xyz[p], m.pt_normal[p], m.pt_max_distance[p]
        )
        if np.isnan(level):
            continue
        expected = min(max(int(level + 0.5), 0), len(view.scale) - 1)
        border = BORDER_PX * view.scale[expected]  # nearer to it nothing is extracted
        if not view.x_min + border <= u < view.x_max - border:
            continue
        if not view.y_min + border <= v < view.y_max - border:
            continue
        u, v, _, uu, uv, vv = spread_of_pixel(
            view, T_cam_map, m.pt_xyz[p], m.pt_covariance[p], noise2, exact, J
        )
        loose = loose2 / view.inv_sigma2[expected]
        _, _, _, total = likeliest(
            view, xy, octave, descriptors, cell_start, first, u, v, uu + loose, uv, vv + loose, noise2, level,
            density, 1.0, m.pt_descriptor[p], odds,
        )  # fmt: skip
        rows[n], shown[n] = p, total
        cell[n] = int((v - view.y_min) / side) * CELLS + min(int((u - view.x_min) / side), CELLS - 1)
        angle[n], zoom[n] = _change_of_view(m, p, centre)
        n += 1
    return rows[:n].copy(), cell[:n].copy(), shown[:n].copy(), angle[:n].copy(), zoom[:n].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def _change_of_view(m, point, centre):
    """Angle, rad, and logarithm to base 2 of the distance, since the nearest view of a point."""
    best, best_angle, best_zoom = np.inf, 0.0, 0.0
    dx, dy, dz = m.pt_xyz[point] - centre
    here = dx * dx + dy * dy + dz * dz
    e = m.pt_head[point]
    while e >= 0:
        at = camera_at(m.kf_T_cam_map[m.kp_keyframe[e]])
        x, y, z = m.pt_xyz[point] - at
        there = x * x + y * y + z * z
        cosine = (x * dx + y * dy + z * dz) / np.sqrt(here * there)
        angle, zoom = np.arccos(min(max(cosine, -1.0), 1.0)), 0.5 * np.log2(here / there)
        if angle * angle + zoom * zoom < best:
            best, best_angle, best_zoom = angle * angle + zoom * zoom, angle, zoom
        e = m.kp_next[e]
    return best_angle, best_zoom
