"""Kernels of the corners among the pixels of direct odometry."""

import numpy as np
from numba import njit

from dslab.slam.matching.projection import in_view, project
from dslab.slam.matching.window import nearest

_BORDER_PX = 20.0  # no features are extracted nearer to the border of an image
_MIN_COSINE = 0.8  # between the direction of view and a point's mean one
_SAME = 70  # largest distance of two descriptors of one point, bits


@njit(cache=True, nogil=True)
def gradient_products(level, products):
    """Products of the image gradient; 0 where it or the intensity is unknown.

    Args:
        level: (H, W, 3) float32 intensity and gradient.
        products: (H, W, 3) float32 to write to: gx gx, gx gy, gy gy.
    """
    for y in range(level.shape[0]):
        for x in range(level.shape[1]):
            gx, gy = level[y, x, 1], level[y, x, 2]
            known = np.isfinite(level[y, x, 0]) and np.isfinite(gx) and np.isfinite(gy)
            gx, gy = (gx, gy) if known else (np.float32(0), np.float32(0))
            products[y, x, 0], products[y, x, 1], products[y, x, 2] = gx * gx, gx * gy, gy * gy


@njit(cache=True, nogil=True)
def lesser_eigenvalues(structure, lesser):
    """Smaller eigenvalue of each structure tensor.

    Args:
        structure: (H, W, 3) float32 tensors: xx, xy, yy.
        lesser: (H, W) float32 to write to.
    """
    half, quarter = np.float32(0.5), np.float32(0.25)
    for y in range(structure.shape[0]):
        for x in range(structure.shape[1]):
            a, b, c = structure[y, x, 0], structure[y, x, 1], structure[y, x, 2]
            lesser[y, x] = half * (a + c) - np.sqrt(quarter * ((a - c) * (a - c)) + b * b)


@njit(cache=True, nogil=True)
def peaks(strength, level, least, border, reach, window):
    """Pixels that are as strong as all about them, row by row.

    Args:
        strength: (H, W) float32.
        level: (H, W, 3) intensity and gradient.
        least: a peak is stronger.
        border: pixels along the border without peaks.
        reach: a peak is compared with this many pixels to each side.
        window: a peak has no unknown pixel within this many to each side.

    Returns:
        (N, 2) int32.
    """
    height, width = strength.shape
    xy = np.empty((height * width, 2), np.int32)  # of equal strength all are peaks
    n = 0
    border = max(border, reach, window)
    for y in range(border, height - border):
        for x in range(border, width - border):
            value = strength[y, x]
            if not value > least:
                continue
            is_peak = True
            for v in range(y - reach, y + reach + 1):
                for u in range(x - reach, x + reach + 1):
                    if strength[v, u] > value:
                        is_peak = False
                        break
                if not is_peak:
                    break
            if is_peak and _is_known(level, y - window, y + window, x - window, x + window):
                xy[n, 0], xy[n, 1] = x, y
                n += 1
    return xy[:n].copy()


@njit(cache=True, nogil=True)
def _is_known(level, top, bottom, left, right):
    """True if all pixels of a window have intensity and gradient."""
    for y in range(top, bottom + 1):
        for x in range(left, right + 1):
            for m in range(3):
                if not np.isfinite(level[y, x, m]):
                    return False
    return True


@njit(cache=True, nogil=True)
def find_points(m, view, T_cam_map, candidates, xy, octave, descriptors, cell_start, radius):
    """Project points into a view and look for them there.

    Args:
        m: MapArrays of the points.
        view: ViewGeometry.
        T_cam_map: (4, 4) pose of the view.
        candidates: (Q,) int32 points.
        xy, octave, descriptors, cell_start: features of the view.
        radius: radius of the search window on level 0, px.

    Returns:
        Of the n points that the view should show: rows (n,) int32, pixels (n, 2), depths (n,), and the
        keypoint that shows it (n,) int32, -1 for none.
    """
    size, n = len(candidates), 0
    rows, keypoint = np.empty(size, np.int32), np.empty(size, np.int32)
    pixels, depths = np.empty((size, 2)), np.empty(size)
    for p in candidates:
        if m.pt_bad[p]:
            continue
        u, v, z = project(T_cam_map, view, m.pt_xyz[p])
        if z <= 0 or not in_view(view, u, v):
            continue
        if not (view.x_min + _BORDER_PX <= u < view.x_max - _BORDER_PX):
            continue
        if not (view.y_min + _BORDER_PX <= v < view.y_max - _BORDER_PX):
            continue
        distance, along = 0.0, 0.0
        for r in range(3):
            c, d = T_cam_map[r, 3], 0.0
            for s in range(3):
                c += T_cam_map[r, s] * m.pt_xyz[p, s]
                d += T_cam_map[r, s] * m.pt_normal[p, s]
            distance += c * c
            along += c * d
        distance, far = np.sqrt(distance), m.pt_max_distance[p]
        if distance > far or distance < far / view.scale[-1] or along < _MIN_COSINE * distance:
            continue
        level = np.ceil(np.log(far / distance) / view.log_scale)
        i, d = nearest(
            view, xy, octave, descriptors, cell_start, 0, u, v, radius * view.scale[int(level)],
            level - 1.0, level + 1.0, m.pt_descriptor[p],
        )  # fmt: skip
        rows[n], keypoint[n] = p, i if i >= 0 and d <= _SAME else -1
        pixels[n, 0], pixels[n, 1], depths[n] = u, v, z
        n += 1
    return rows[:n].copy(), pixels[:n].copy(), depths[:n].copy(), keypoint[:n].copy()
