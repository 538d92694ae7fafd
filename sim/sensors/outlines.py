"""Exposure at outlines, where near surfaces move across far ones.

A pixel near an outline sees the near surface during a part of the exposure and the far one during the rest,
so that no single depth gives its path. At every moment its ray is followed through the sharp frame, from near
to far, to the first surface that it meets (ray marching in a depth image). A ray that ends behind a near
surface sees a point that the sharp frame hides: the surface that the ray passed last, beside the outline,
replaces it.

The kernels share their arguments: ``k`` (4,) float32 fx, fy, cx, cy; ``T_open`` and ``T_close`` (3, 4)
float32, camera at the shutter's opening, or closing, to the sharp frame's camera; ``linear`` (H, W) float32
light of the sharp frame, 0 to 1; ``inverse_depth`` (H, W) float32 of it; ``encode`` the uint8 table from
light to level; ``near`` and ``far`` (h, w) float32 as ``outline_tiles`` gives them.
"""

import numpy as np
from numba import njit

# Side of the tiles, in pixels, for which the need to follow rays is decided.
TILE_PX = 8
# A step in depth is an outline if its sides move apart by more than this in half the exposure.
OUTLINE_PX = np.float32(2)
# Pixels of smear per ray and the largest number of rays; a ray advances by pixels, up to a number.
PX_PER_RAY = np.float32(1.25)
MAX_RAYS = 32
MAX_STEPS = 256
# Inverse depth where there is no surface.
FARTHEST = np.float32(1e-4)
# Longer paths leave any frame.
_LONGEST_PX = np.float32(2000)
# A nearer surface within reach extends the reach, which may then hold a still nearer one.
_WIDENINGS = 3


def inverse_depths(depth_m: np.ndarray) -> np.ndarray:
    """(H, W) float32 1 / depth, 1e-4 where there is none."""
    out = np.full_like(depth_m, FARTHEST)
    return np.divide(np.float32(1), depth_m, out=out, where=depth_m > FARTHEST)


@njit(cache=True, nogil=True, error_model="numpy")
def outline_tiles(inverse_depth, k, T_open, T_close):
    """The tiles over which an outline passes during the exposure.

    Returns:
        Two (h, w) float32 arrays, of tiles of ``TILE_PX``: the nearest and the farthest inverse depth that
        may be seen in a tile. Both are -1 where no outline passes.
    """
    near, far, step = _ranges(inverse_depth)
    rows, columns = near.shape
    passed_near, passed_far = np.full_like(near, -1), np.full_like(far, -1)
    for i in range(rows):
        for j in range(columns):
            if _drift_px(i, j, far[i, j], step[i, j], k, T_open, T_close) <= OUTLINE_PX:
                continue
            for inverse in (near[i, j], far[i, j]):
                _sweep(i, j, inverse, k, T_open, near, far, passed_near, passed_far)
                _sweep(i, j, inverse, k, T_close, near, far, passed_near, passed_far)
    for i in range(rows):
        for j in range(columns):
            if passed_near[i, j] >= 0:
                passed_near[i, j], passed_far[i, j] = _in_reach(
                    i, j, passed_near[i, j], passed_far[i, j], k, T_open, T_close, near, far
                )
    return passed_near, passed_far


@njit(cache=True, nogil=True, error_model="numpy")
def _ranges(inverse_depth):
    """Largest and smallest inverse depth of every tile, and the largest step between two neighbours."""
    height, width = inverse_depth.shape
    shape = ((height + TILE_PX - 1) // TILE_PX, (width + TILE_PX - 1) // TILE_PX)
    near, far, step = (
        np.zeros(shape, np.float32),
        np.full(shape, np.inf, np.float32),
        np.zeros(shape, np.float32),
    )
    for row in range(height):
        i, below = row // TILE_PX, min(row + 1, height - 1)
        for column in range(width):
            j = column // TILE_PX
            here, under = inverse_depth[row, column], inverse_depth[below, column]
            beside = inverse_depth[row, min(column + 1, width - 1)]
            near[i, j] = max(near[i, j], here, under, beside)
            far[i, j] = min(far[i, j], here, under, beside)
            step[i, j] = max(step[i, j], abs(under - here), abs(beside - here))
    return near, far, step


@njit(cache=True, nogil=True, error_model="numpy")
def _shift(u, v, inverse, k, T):
    """Shift, in the sharp frame, of a pixel's point at an inverse depth from another pose.

    The inverse depth is the sharp frame's; the position is linear in it.
    """
    x, y = (u - k[2]) / k[0], (v - k[3]) / k[1]
    far_z = max(T[2, 0] * x + T[2, 1] * y + T[2, 2], np.float32(0.05))
    far_x, far_y = (
        (T[0, 0] * x + T[0, 1] * y + T[0, 2]) / far_z,
        (T[1, 0] * x + T[1, 1] * y + T[1, 2]) / far_z,
    )
    to_x = far_x + inverse * (T[0, 3] - far_x * T[2, 3])
    to_y = far_y + inverse * (T[1, 3] - far_y * T[2, 3])
    shift_x, shift_y = k[0] * to_x + k[2] - u, k[1] * to_y + k[3] - v
    return min(max(shift_x, -_LONGEST_PX), _LONGEST_PX), min(max(shift_y, -_LONGEST_PX), _LONGEST_PX)


@njit(cache=True, nogil=True, error_model="numpy")
def _centre_of(tile):
    return np.float32(tile * TILE_PX) + np.float32(0.5 * (TILE_PX - 1))


@njit(cache=True, nogil=True, error_model="numpy")
def _drift_px(i, j, inverse, step, k, T_open, T_close):
    """Pixels by which the sides of a step in inverse depth move apart."""
    u, v, drift = _centre_of(j), _centre_of(i), np.float32(0)
    for T in (T_open, T_close):
        far_x, far_y = _shift(u, v, inverse, k, T)
        near_x, near_y = _shift(u, v, inverse + step, k, T)
        drift = max(drift, abs(near_x - far_x), abs(near_y - far_y))
    return drift


@njit(cache=True, nogil=True, error_model="numpy")
def _sweep(i, j, inverse, k, T, near, far, passed_near, passed_far):
    """Add tile (i, j) to the ranges of the tiles that its points reach by pose T."""
    rows, columns = near.shape
    x, y = _shift(_centre_of(j), _centre_of(i), inverse, k, T)
    steps = int(max(abs(x), abs(y)) / np.float32(TILE_PX // 2)) + 1
    for step in range(steps + 1):
        # Points move in the view opposite to the pixels' shift.
        part = np.float32(step) / np.float32(steps * TILE_PX)
        to_i, to_j = i - part * y, j - part * x
        top, left = int(np.floor(to_i)), int(np.floor(to_j))
        for a in range(max(top, 0), min(top + 2, rows)):
            for b in range(max(left, 0), min(left + 2, columns)):
                if passed_near[a, b] < 0:
                    passed_near[a, b], passed_far[a, b] = near[a, b], far[a, b]
                passed_near[a, b] = max(passed_near[a, b], near[i, j])
                passed_far[a, b] = min(passed_far[a, b], far[i, j])


@njit(cache=True, nogil=True, error_model="numpy")
def _in_reach(i, j, nearest, farthest, k, T_open, T_close, near, far):
    """Range of inverse depths that tile (i, j) may see, with those nearer than the outline."""
    rows, columns = near.shape
    u, v = _centre_of(j), _centre_of(i)
    for _ in range(_WIDENINGS):
        before = nearest
        for T in (T_open, T_close):
            for inverse in (nearest, farthest):
                x, y = _shift(u, v, inverse, k, T)
                steps = int(max(abs(x), abs(y)) / np.float32(TILE_PX)) + 1
                for step in range(steps + 1):
                    part = np.float32(step) / np.float32(steps * TILE_PX)
                    top, left = int(np.floor(i + part * y)), int(np.floor(j + part * x))
                    for a in range(max(top, 0), min(top + 2, rows)):
                        for b in range(max(left, 0), min(left + 2, columns)):
                            nearest, farthest = max(nearest, near[a, b]), min(farthest, far[a, b])
        if nearest == before:
            break
    return nearest, farthest


@njit(cache=True, nogil=True, error_model="numpy")
def integrate_outlines(out, linear, inverse_depth, k, T_open, T_close, encode, near, far):
    """Sum the light of the pixels over which outlines pass.

    ``out``, (H, W) uint8, is written in the tiles where an outline passes, except pixels all of whose light
    comes from outside the frame.
    """
    height, width = out.shape
    codes, half = np.float32(len(encode) - 1), np.float32(0.5)
    for row in range(height):
        for column in range(width):
            nearest, farthest = (
                near[row // TILE_PX, column // TILE_PX],
                far[row // TILE_PX, column // TILE_PX],
            )
            if nearest < 0:
                continue
            light = _mean_light(column, row, nearest, farthest, linear, inverse_depth, k, T_open, T_close)
            if light >= 0:
                out[row, column] = encode[np.int32(light * codes + half)]


@njit(cache=True, nogil=True, error_model="numpy")
def _mean_light(column, row, nearest, farthest, linear, inverse_depth, k, T_open, T_close):
    """Light of one pixel over the exposure, -1 if none comes from the frame."""
    u, v = np.float32(column), np.float32(row)
    near_x, near_bend_x, near_y, near_bend_y = _path(u, v, nearest, k, T_open, T_close)
    far_x, far_bend_x, far_y, far_bend_y = _path(u, v, farthest, k, T_open, T_close)
    one, zero = np.float32(1), np.float32(0)
    length = np.float32(2) * np.sqrt(max(near_x * near_x + near_y * near_y, far_x * far_x + far_y * far_y))
    count = min(MAX_RAYS, max(2, np.int32(length / PX_PER_RAY) + 1))
    drift = abs(near_x - far_x) + abs(near_bend_x - far_bend_x)
    drift += abs(near_y - far_y) + abs(near_bend_y - far_bend_y)
    # Steps in inverse depth up to this belong to one surface.
    outline = (nearest - farthest) * min(one, OUTLINE_PX / drift)
    step = np.float32(2) / np.float32(count)
    s = np.float32(0.5) * step - one
    light, seen = zero, zero
    for _ in range(count):
        start_x, start_y = u + s * (near_x + s * near_bend_x), v + s * (near_y + s * near_bend_y)
        end_x, end_y = u + s * (far_x + s * far_bend_x), v + s * (far_y + s * far_bend_y)
        s += step
        part = _first_met(inverse_depth, start_x, start_y, nearest, end_x, end_y, farthest, outline)
        if part < zero:
            continue
        sample = _light_at(linear, start_x + part * (end_x - start_x), start_y + part * (end_y - start_y))
        if sample >= zero:
            light += sample
            seen += one
    return light / seen if seen > zero else -one


@njit(cache=True, nogil=True, error_model="numpy")
def _path(u, v, inverse, k, T_open, T_close):
    """Slope and bend, in x and y, of the parabola through opening, centre and closing."""
    half = np.float32(0.5)
    open_x, open_y = _shift(u, v, inverse, k, T_open)
    close_x, close_y = _shift(u, v, inverse, k, T_close)
    slope_x, slope_y = half * (close_x - open_x), half * (close_y - open_y)
    return slope_x, half * (close_x + open_x), slope_y, half * (close_y + open_y)


@njit(cache=True, nogil=True, error_model="numpy")
def _first_met(inverse_depth, x, y, inverse, end_x, end_y, end_inverse, outline):
    """Follow a ray through the sharp frame to the first surface that it meets.

    Args:
        inverse_depth: (H, W) float32.
        x, y, inverse: pixel and inverse depth at which the ray begins.
        end_x, end_y, end_inverse: the same for its end; in between they are linear in each other.
        outline: a step in inverse depth beyond which the ray is behind a surface.

    Returns:
        The part of the ray up to the surface. If it meets none, the part up to its passing behind one; -1 if
        it may have met one outside the frame.
    """
    half, zero, one = np.float32(0.5), np.float32(0), np.float32(1)
    right, bottom = np.float32(inverse_depth.shape[1] - 1), np.float32(inverse_depth.shape[0] - 1)
    steps = min(np.int32(max(abs(end_x - x), abs(end_y - y))) + 1, MAX_STEPS)
    part, whole = one / np.float32(steps), end_inverse - inverse
    step_x, step_y, step = part * (end_x - x), part * (end_y - y), part * whole
    in_front, behind, begin = half * step, outline - step, inverse
    last, outside = -one, False
    for i in range(steps + 1):
        if x >= zero and y >= zero and x <= right and y <= bottom:
            met = inverse_depth[np.int32(y + half), np.int32(x + half)]
            if met - inverse < in_front:
                last = np.float32(i) * part
            elif met - inverse <= behind:
                return min(max((met - begin) / whole, zero), one)
        else:
            outside = True
        x += step_x
        y += step_y
        inverse += step
    return -one if outside else last


@njit(cache=True, nogil=True, error_model="numpy")
def _light_at(linear, x, y):
    """Light between four pixels, -1 outside the frame."""
    height, width = linear.shape
    if x < 0 or y < 0 or x >= np.float32(width - 1) or y >= np.float32(height - 1):
        return np.float32(-1)
    left, top = np.int32(x), np.int32(y)
    part_x, part_y = x - np.float32(left), y - np.float32(top)
    upper = linear[top, left] + part_x * (linear[top, left + 1] - linear[top, left])
    lower = linear[top + 1, left] + part_x * (linear[top + 1, left + 1] - linear[top + 1, left])
    return upper + part_y * (lower - upper)
