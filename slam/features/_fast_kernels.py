"""FAST-9 corners of one pyramid level: contrast of every pixel, then local maxima.

The hot loops index with unsigned integers: numba then drops its test for negative indices, which would
prevent vectorisation and cost a factor of six.
"""

import numpy as np
from numba import njit

_U1, _U2, _U3, _U4, _U5, _U6 = (np.uint64(k) for k in range(1, 7))


@njit(cache=True, nogil=True)
def _score_row(r0, r1, r2, r3, r4, r5, r6, out):
    # Contrast of the best arc of 9 of the 16 pixels around each centre: the largest k such that all 9 are
    # brighter, or all darker, by k. Two arcs that share 8 pixels are handled at once.
    for x in range(np.uint64(out.size)):
        centre = r3[x + _U3]
        p0, p1, p2, p3 = r6[x + _U3], r6[x + _U4], r5[x + _U5], r4[x + _U6]
        p4, p5, p6, p7 = r3[x + _U6], r2[x + _U6], r1[x + _U5], r0[x + _U4]
        p8, p9, p10, p11 = r0[x + _U3], r0[x + _U2], r1[x + _U1], r2[x]
        p12, p13, p14, p15 = r3[x], r4[x], r5[x + _U1], r6[x + _U2]

        a1, a3, a5, a7 = min(p1, p2), min(p3, p4), min(p5, p6), min(p7, p8)
        a9, a11, a13, a15 = min(p9, p10), min(p11, p12), min(p13, p14), min(p15, p0)
        b1, b3, b5, b7 = min(a1, a3), min(a3, a5), min(a5, a7), min(a7, a9)
        b9, b11, b13, b15 = min(a9, a11), min(a11, a13), min(a13, a15), min(a15, a1)
        low = min(b1, b5, max(p0, p9))
        low = max(low, min(b3, b7, max(p2, p11)))
        low = max(low, min(b5, b9, max(p4, p13)))
        low = max(low, min(b7, b11, max(p6, p15)))
        low = max(low, min(b9, b13, max(p8, p1)))
        low = max(low, min(b11, b15, max(p10, p3)))
        low = max(low, min(b13, b1, max(p12, p5)))
        low = max(low, min(b15, b3, max(p14, p7)))

        a1, a3, a5, a7 = max(p1, p2), max(p3, p4), max(p5, p6), max(p7, p8)
        a9, a11, a13, a15 = max(p9, p10), max(p11, p12), max(p13, p14), max(p15, p0)
        b1, b3, b5, b7 = max(a1, a3), max(a3, a5), max(a5, a7), max(a7, a9)
        b9, b11, b13, b15 = max(a9, a11), max(a11, a13), max(a13, a15), max(a15, a1)
        high = max(b1, b5, min(p0, p9))
        high = min(high, max(b3, b7, min(p2, p11)))
        high = min(high, max(b5, b9, min(p4, p13)))
        high = min(high, max(b7, b11, min(p6, p15)))
        high = min(high, max(b9, b13, min(p8, p1)))
        high = min(high, max(b11, b15, min(p10, p3)))
        high = min(high, max(b13, b1, min(p12, p5)))
        high = min(high, max(b15, b3, min(p14, p7)))

        out[x] = max(max(low, centre) - centre, centre - min(high, centre))


@njit(cache=True, nogil=True)
def corner_contrast(image: np.ndarray, margin: int, out: np.ndarray) -> None:
    """Compute the segment-test contrast of every pixel at least ``margin`` from the edge.

    A pixel is a FAST-9 corner at threshold t if its contrast is greater than t.

    Args:
        image: (H, W) uint8, contiguous.
        margin: pixels, >= 3.
        out: (H * W,) uint8, row-major; pixels nearer to the edge are not written.

    Source: Rosten and Drummond, Machine learning for high-speed corner detection, ECCV 2006.
    """
    height, width = image.shape
    flat = image.reshape(height * width)
    n = width - 2 * margin
    if n <= 0:
        return
    m = n + 6
    for y in range(margin, height - margin):
        i = y * width + margin - 3
        _score_row(
            flat[i - 3 * width : i - 3 * width + m],
            flat[i - 2 * width : i - 2 * width + m],
            flat[i - width : i - width + m],
            flat[i : i + m],
            flat[i + width : i + width + m],
            flat[i + 2 * width : i + 2 * width + m],
            flat[i + 3 * width : i + 3 * width + m],
            out[i + 3 : i + 3 + n],
        )


@njit(cache=True, nogil=True)
def _suppress_row(above, row, below, threshold, out):
    for x in range(np.uint64(row.size) - _U2):
        centre = row[x + _U1]
        most = max(above[x], above[x + _U1], above[x + _U2], row[x], row[x + _U2])
        most = max(most, below[x], below[x + _U1], below[x + _U2])
        out[x] = centre if centre > max(most, threshold) else np.uint8(0)


@njit(cache=True, nogil=True)
def _strongest(kept, out):
    for x in range(np.uint64(kept.size)):
        out[x] = max(out[x], kept[x])


@njit(cache=True, nogil=True)
def _drop_weak(kept, thresholds):
    for x in range(np.uint64(kept.size)):
        kept[x] = kept[x] if kept[x] > thresholds[x] else np.uint8(0)


@njit(cache=True, nogil=True)
def _collect_row(kept, border, y, xs, ys, contrasts, count):
    words = kept.view(np.uint64)  # most rows are nearly empty: test eight pixels at once
    for w in range(words.size):
        if words[w] == 0:
            continue
        for x in range(8 * w, 8 * w + 8):
            if kept[x] > 0:
                xs[count], ys[count], contrasts[count] = x + border, y, kept[x]
                count += 1
    return count


@njit(cache=True, nogil=True)
def select_corners(
    contrast: np.ndarray,
    height: int,
    width: int,
    border: int,
    threshold: np.uint8,
    min_threshold: np.uint8,
    occupied: np.ndarray,
    xs: np.ndarray,
    ys: np.ndarray,
    contrasts: np.ndarray,
) -> int:
    """Select local maxima of the contrast in free cells; weak ones only in cells without a strong one.

    Args:
        contrast: (>= height * width,) uint8 from :func:`corner_contrast`, valid from ``border - 1`` inwards.
        height: rows of the level.
        width: columns of the level.
        border: least distance of a corner to the edge, px.
        threshold: contrast that a strong corner exceeds.
        min_threshold: contrast that a weak corner exceeds.
        occupied: (rows, columns) bool of the equal cells into which the area within the border is divided;
            none is selected in one that is occupied, and those with a corner become so.
        xs: (C,) int32, receives the columns; C >= a quarter of the level's pixels.
        ys: (C,) int32, receives the rows.
        contrasts: (C,) uint8, receives the contrasts.

    Returns:
        Number of corners written, in bands of cells and row by row in each.
    """
    n = width - 2 * border
    rows = height - 2 * border
    if n <= 0 or rows <= 0:
        return 0
    n_bands, n_cells = occupied.shape
    padded = (n + 7) // 8 * 8
    kept = np.zeros((rows // n_bands + 1, padded), np.uint8)
    strongest = np.empty(padded, np.uint8)
    thresholds = np.zeros(padded, np.uint8)
    count = np.int64(0)
    for band in range(n_bands):
        first, end = border + rows * band // n_bands, border + rows * (band + 1) // n_bands
        strongest[:] = 0
        for y in range(first, end):
            i = y * width + border - 1
            _suppress_row(
                contrast[i - width : i - width + n + 2],
                contrast[i : i + n + 2],
                contrast[i + width : i + width + n + 2],
                min_threshold,
                kept[y - first, :n],
            )
            _strongest(kept[y - first], strongest)
        for cell in range(n_cells):  # column x lies in cell x * n_cells // n
            left, right = (cell * n + n_cells - 1) // n_cells, ((cell + 1) * n + n_cells - 1) // n_cells
            most = np.uint8(0)
            for x in range(left, right):
                most = max(most, strongest[x])
            thresholds[left:right] = threshold if most > threshold else min_threshold
            if occupied[band, cell]:
                thresholds[left:right] = 255  # which no contrast exceeds
            elif most > min_threshold:
                occupied[band, cell] = True
        for y in range(first, end):
            _drop_weak(kept[y - first], thresholds)
            count = _collect_row(kept[y - first], border, y, xs, ys, contrasts, count)
    return int(count)


@njit(cache=True, nogil=True)
def refine_corners(contrast: np.ndarray, width: int, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """Find corners between the pixels: the summit of a quadratic fitted to the contrasts of 3x3 pixels.

    Args:
        contrast: (>= height * width,) uint8 from :func:`corner_contrast`, valid around each corner.
        width: columns of the level.
        xs: (N,) int32 columns of local maxima.
        ys: (N,) int32 rows.

    Returns:
        (N, 2) float32 from the pixel to the summit, x and y, each in [-1, 1]; 0 where there is no summit.

    Source: Leutenegger et al., BRISK, ICCV 2011, section 3.1.
    """
    offsets = np.zeros((xs.size, 2), np.float32)
    for k in range(xs.size):
        i = ys[k] * width + xs[k]
        a, b, c = float(contrast[i - width - 1]), float(contrast[i - width]), float(contrast[i - width + 1])
        d, e, f = float(contrast[i - 1]), float(contrast[i]), float(contrast[i + 1])
        g, h, j = float(contrast[i + width - 1]), float(contrast[i + width]), float(contrast[i + width + 1])
        # Least squares over the nine pixels.
        left, right, top, bottom = a + d + g, c + f + j, a + b + c, g + h + j
        s_x, s_y = (right - left) / 6, (bottom - top) / 6
        s_xx, s_yy = (left - 2 * (b + e + h) + right) / 3, (top - 2 * (d + e + f) + bottom) / 3
        s_xy = (a + j - c - g) / 4
        det = s_xx * s_yy - s_xy * s_xy
        if s_xx < 0 and det > 0:
            offsets[k, 0] = min(max((s_xy * s_y - s_yy * s_x) / det, -1.0), 1.0)
            offsets[k, 1] = min(max((s_xy * s_x - s_xx * s_y) / det, -1.0), 1.0)
    return offsets
