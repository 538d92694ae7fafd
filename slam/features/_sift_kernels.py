"""Orientations and descriptors of SIFT keypoints of one octave.

The arithmetic is in float32 where the loops are vectorised.

Source: Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004; the sections are named.
"""

import numpy as np
from numba import njit

from dslab.slam.features._dog_kernels import LAYERS

_BINS = 36
_PEAK = 0.8  # of the highest peak (Sec. 5)
_ORIENTATION_SIGMA = 1.5
_EVERY_PIXEL_BELOW = 10  # px, radius of the neighbourhood; in larger ones every second pixel is taken
_CELLS = 4
_DIRECTIONS = 8
_CELL_SIGMA = 3.0  # width of a descriptor's cell in sigmas
_PER_CELL = 4  # samples per cell and axis: 16x16 in all (Sec. 6.1)
_SIDE = (_CELLS + 1) * _PER_CELL  # samples that reach into a cell, per axis
_CLIP = 0.2
_U1 = np.uint64(1)
_TINY, _ZERO, _QUARTER, _HALF, _ONE = (np.float32(v) for v in (1e-30, 0.0, 0.25, 0.5, 1.0))
# Least squares for arctan(q) / 2 pi.
_A0, _A1, _A2, _A3, _A4 = (np.float32(a) for a in (0.159136, -0.052616, 0.028877, -0.013870, 0.003478))


def _sample_weights() -> np.ndarray:
    """(_SIDE**2,) float32: the samples' weights fall off by half the descriptor's width."""
    at = (np.arange(_SIDE) + 0.5) / _PER_CELL - 0.5 * (_CELLS + 1)
    fall = np.exp(-0.5 * (at / (0.5 * _CELLS)) ** 2)
    return np.outer(fall, fall).astype(np.float32).ravel()


_SAMPLE_WEIGHTS = _sample_weights()
# Of the samples from the middle of the cell before to the middle of the cell behind.
_ACROSS = 1.0 - np.abs((np.arange(2 * _PER_CELL) + 0.5) / _PER_CELL - 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _turns(dy, dx):
    """Direction in turns, 0 to 1, to 1e-5: a polynomial of the smaller over the larger part."""
    ax, ay = abs(dx), abs(dy)
    low = ax if ax < ay else ay
    high = ay if ax < ay else ax
    q = low / (high + _TINY)
    q2 = q * q
    turn = q * (_A0 + q2 * (_A1 + q2 * (_A2 + q2 * (_A3 + q2 * _A4))))
    turn = _QUARTER - turn if ay > ax else turn
    turn = _HALF - turn if dx < _ZERO else turn
    return _ONE - turn if dy < _ZERO else turn


@njit(cache=True, nogil=True, error_model="numpy")
def _polar(n, dx, dy, weights, turn0, sizes, turns):
    """Weighted sizes of gradients, and their directions from ``turn0`` backward, in turns."""
    for i in range(np.uint64(n)):
        sizes[i] = weights[i] * np.sqrt(dx[i] * dx[i] + dy[i] * dy[i])
        turn = turn0 - _turns(dy[i], dx[i])
        turns[i] = turn + _ONE if turn < _ZERO else turn


# -- orientations --------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True, error_model="numpy")
def orient(gaussians, keypoints, sigma0, turns, owners):
    """Orientations of keypoints (Sec. 5).

    Args:
        gaussians: (LAYERS + 3, H, W) float32.
        keypoints: (n, 5) as from :func:`refine_extrema`.
        sigma0: standard deviation of layer 0, px of the octave.
        turns: (m,) float64, receives orientations, in turns; those beyond m are lost.
        owners: (m,) int32, receives the rows of their keypoints, ascending.

    Returns:
        Their number, one or more per keypoint.
    """
    height, width = gaussians.shape[1:]
    total = np.int64(0)
    histogram = np.empty(_BINS + 1)
    most_radius = int(3.0 * _ORIENTATION_SIGMA * sigma0 * 2.0 ** ((LAYERS + 0.5) / LAYERS) + 0.5)
    most = (2 * most_radius + 1) ** 2
    dx, dy, weights = np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.float32)
    sizes, away = np.empty(most, np.float32), np.empty(most, np.float32)
    fall = np.empty(most_radius + 1)
    for i in range(len(keypoints)):
        g = gaussians[int(keypoints[i, 4])]
        sigma = _ORIENTATION_SIGMA * sigma0 * 2.0 ** (keypoints[i, 2] / LAYERS)
        cx, cy = int(keypoints[i, 0] + 0.5), int(keypoints[i, 1] + 0.5)
        radius = min(int(3.0 * sigma + 0.5), most_radius)
        for r in range(radius + 1):
            fall[r] = np.exp(-0.5 * r * r / (sigma * sigma))
        step = 1 if radius < _EVERY_PIXEL_BELOW else 2
        n = np.int64(0)
        for v in range(-radius, radius + 1, step):
            y = cy + v
            if y < 1 or y > height - 2:
                continue
            half = int(np.sqrt(radius * radius - v * v)) // step * step
            for x in range(cx - half, cx + half + 1, step):
                if 1 <= x <= width - 2:
                    dx[n], dy[n] = g[y, x + 1] - g[y, x - 1], g[y + 1, x] - g[y - 1, x]
                    weights[n] = fall[abs(v)] * fall[abs(x - cx)]
                    n += 1
        _polar(n, dx, dy, weights, _ONE, sizes, away)
        histogram[:] = 0
        for j in range(n):
            histogram[int((_ONE - away[j]) * np.float32(_BINS) + _HALF)] += sizes[j]
        histogram[0] += histogram[_BINS]
        total = _take_peaks(histogram, i, turns, owners, total)
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _take_peaks(histogram, owner, turns, owners, total):
    """Orientations at the peaks of the smoothed histogram, beside the highest all that come near it."""
    smooth, highest = np.empty(_BINS), 0.0
    for b in range(_BINS):
        near = histogram[(b + _BINS - 1) % _BINS] + histogram[(b + 1) % _BINS]
        far = histogram[(b + _BINS - 2) % _BINS] + histogram[(b + 2) % _BINS]
        smooth[b] = 6.0 * histogram[b] + 4.0 * near + far
        highest = max(highest, smooth[b])
    for b in range(_BINS):
        v, left, right = smooth[b], smooth[b - 1], smooth[(b + 1) % _BINS]
        if v > left and v > right and v >= _PEAK * highest and total < len(turns):
            turns[total] = ((b + 0.5 * (left - right) / (left - 2.0 * v + right)) / _BINS) % 1.0
            owners[total] = owner
            total += 1
    return total


# -- descriptors ---------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True, error_model="numpy")
def describe(gaussians, keypoints, turns, owners, sigma0, out):
    """Descriptors of oriented keypoints (Sec. 6).

    Args:
        gaussians: (LAYERS + 3, H, W) float32.
        keypoints: (n, 5) as from :func:`refine_extrema`.
        turns, owners: (m,) orientations in turns and rows of their keypoints.
        sigma0: standard deviation of layer 0, px of the octave.
        out: (m, 128) uint8, receives the descriptors.
    """
    height, width = gaussians.shape[1:]
    dx, dy = np.empty(_SIDE * _SIDE, np.float32), np.empty(_SIDE * _SIDE, np.float32)
    sizes, away = np.empty(_SIDE * _SIDE, np.float32), np.empty(_SIDE * _SIDE, np.float32)
    sums = np.empty((_CELLS + 2) * _DIRECTIONS * _SIDE, np.float32)
    weights = _SAMPLE_WEIGHTS.copy()
    for i in range(len(turns)):
        x, y, scale, _, layer = keypoints[owners[i]]
        step = _CELL_SIGMA / _PER_CELL * sigma0 * 2.0 ** (scale / LAYERS)
        cos, sin = step * np.cos(2.0 * np.pi * turns[i]), step * np.sin(2.0 * np.pi * turns[i])
        first = -0.5 * (_SIDE - 1)
        x, y = x + (cos - sin) * first, y + (sin + cos) * first
        flat = gaussians[int(layer)].reshape(height * width)
        _sample(flat, width, height, np.float32(x), np.float32(y), np.float32(cos), np.float32(sin), dx, dy)
        _polar(len(dx), dx, dy, weights, np.float32(turns[i]), sizes, away)
        _pool(sizes, away, sums)
        _finish(sums, out[i])


@njit(cache=True, nogil=True, error_model="numpy")
def _sample(flat, width, height, x, y, cos, sin, dx, dy):
    """Gradients at the pixels nearest to the samples, whose first is (x, y).

    Samples outside of the image take the pixel at its edge.
    """
    right, bottom, across = np.float32(width - 2), np.float32(height - 2), np.uint64(width)
    for v in range(_SIDE):
        fx, fy = x - sin * np.float32(v) + _HALF, y + cos * np.float32(v) + _HALF
        for u in range(_SIDE):
            gx, gy = fx + np.float32(u) * cos, fy + np.float32(u) * sin
            gx, gy = min(max(gx, _ONE), right), min(max(gy, _ONE), bottom)
            at, i = np.uint64(np.int32(gy) * np.int32(width) + np.int32(gx)), np.uint64(v * _SIDE + u)
            dx[i] = flat[at + _U1] - flat[at - _U1]
            dy[i] = flat[at + across] - flat[at - across]


@njit(cache=True, nogil=True, error_model="numpy")
def _pool(sizes, away, sums):
    """Sums (rows of cells, directions, columns of samples), shared between rows and directions."""
    sums[:] = 0
    all_directions = np.float32(_DIRECTIONS)
    for v in range(_SIDE):
        r = v // _PER_CELL
        lower = np.float32((v % _PER_CELL + 0.5) / _PER_CELL)
        upper = _ONE - lower
        i = np.uint64(v * _SIDE)
        for o in range(_DIRECTIONS):
            direction = np.float32(o)
            a = np.uint64((r * _DIRECTIONS + o) * _SIDE)
            b = np.uint64(((r + 1) * _DIRECTIONS + o) * _SIDE)
            for u in range(np.uint64(_SIDE)):
                apart = abs(away[i + u] * all_directions - direction)
                around = all_directions - apart
                share = _ONE - (apart if apart < around else around)
                share = sizes[i + u] * (share if share > _ZERO else _ZERO)
                sums[a + u] += upper * share
                sums[b + u] += lower * share


@njit(cache=True, nogil=True, error_model="numpy")
def _finish(sums, out):
    """Share the columns of samples between cells; normalize, clip and round (Sec. 6.1)."""
    raw = np.zeros(_CELLS * _CELLS * _DIRECTIONS)
    for r in range(_CELLS):
        for o in range(_DIRECTIONS):
            row = ((r + 1) * _DIRECTIONS + o) * _SIDE
            for c in range(_CELLS):
                total = 0.0
                for u in range(2 * _PER_CELL):
                    total += _ACROSS[u] * sums[row + c * _PER_CELL + u]
                raw[(r * _CELLS + c) * _DIRECTIONS + o] = total
    norm2 = 0.0
    for j in range(len(raw)):
        norm2 += raw[j] * raw[j]
    most, clipped2 = _CLIP * np.sqrt(norm2), 0.0
    for j in range(len(raw)):
        raw[j] = min(raw[j], most)
        clipped2 += raw[j] * raw[j]
    scale = 512.0 / max(np.sqrt(clipped2), 1e-12)
    for j in range(len(raw)):
        out[j] = np.uint8(min(raw[j] * scale + 0.5, 255.0))
