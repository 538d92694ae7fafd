"""Keypoints of one octave: extrema of the differences of Gaussians in space and scale.

Source: Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004; the sections are named.
"""

import numpy as np
from numba import njit

LAYERS = 3
"""Scales per octave (Sec. 3.3)."""

BORDER_PX = 5
"""Extrema nearer to the edge have no neighbourhood."""

_STEPS = 5  # Newton steps of the refinement
_MAX_EDGE = 10.0  # ratio of principal curvatures (Sec. 4.1)
_U1, _U2 = np.uint64(1), np.uint64(2)


@njit(cache=True, nogil=True)
def _extrema_row(a0, a1, a2, b0, b1, b2, c0, c1, c2, least, out):
    # Of equal neighbours the last one counts.
    for x in range(np.uint64(out.size)):
        v = b1[x + _U1]
        p0, p1, p2, p3 = b0[x], b0[x + _U1], b0[x + _U2], b1[x]
        p4, p5, p6, p7 = b1[x + _U2], b2[x], b2[x + _U1], b2[x + _U2]
        p8, p9, p10, p11 = a0[x], a0[x + _U1], a0[x + _U2], a1[x]
        p12, p13, p14, p15, p16 = a1[x + _U1], a1[x + _U2], a2[x], a2[x + _U1], a2[x + _U2]
        q8, q9, q10, q11 = c0[x], c0[x + _U1], c0[x + _U2], c1[x]
        q12, q13, q14, q15, q16 = c1[x + _U1], c1[x + _U2], c2[x], c2[x + _U1], c2[x + _U2]
        up = (
            (v > least) & (v > p0) & (v > p1) & (v > p2) & (v > p3) & (v >= p4) & (v >= p5) & (v >= p6)
            & (v >= p7) & (v > p8) & (v > p9) & (v > p10) & (v > p11) & (v > p12) & (v > p13) & (v > p14)
            & (v > p15) & (v > p16) & (v >= q8) & (v >= q9) & (v >= q10) & (v >= q11) & (v >= q12)
            & (v >= q13) & (v >= q14) & (v >= q15) & (v >= q16)
        )  # fmt: skip
        down = (
            (v < -least) & (v < p0) & (v < p1) & (v < p2) & (v < p3) & (v <= p4) & (v <= p5) & (v <= p6)
            & (v <= p7) & (v < p8) & (v < p9) & (v < p10) & (v < p11) & (v < p12) & (v < p13) & (v < p14)
            & (v < p15) & (v < p16) & (v <= q8) & (v <= q9) & (v <= q10) & (v <= q11) & (v <= q12)
            & (v <= q13) & (v <= q14) & (v <= q15) & (v <= q16)
        )  # fmt: skip
        out[x] = up | down


@njit(cache=True, nogil=True)
def find_extrema(dog, least, found):
    """Extrema of the differences of Gaussians among their 26 neighbours (Sec. 3.1).

    Args:
        dog: (LAYERS + 2, H, W) float32.
        least: float32 bound that their size exceeds.
        found: (n, 3) int32, receives layer, row, column in this order; those beyond n are lost.

    Returns:
        Their number.
    """
    layers, height, width = dog.shape
    inner = width - 2 * BORDER_PX
    if inner <= 0:
        return 0
    mask = np.zeros((inner + 7) // 8 * 8, np.uint8)
    words = mask.view(np.uint64)
    lo, hi = BORDER_PX - 1, BORDER_PX + 1 + inner
    count = 0
    for s in range(1, layers - 1):
        for y in range(BORDER_PX, height - BORDER_PX):
            _extrema_row(
                dog[s - 1, y - 1, lo:hi], dog[s - 1, y, lo:hi], dog[s - 1, y + 1, lo:hi],
                dog[s, y - 1, lo:hi], dog[s, y, lo:hi], dog[s, y + 1, lo:hi],
                dog[s + 1, y - 1, lo:hi], dog[s + 1, y, lo:hi], dog[s + 1, y + 1, lo:hi],
                least, mask[:inner],
            )  # fmt: skip
            for w in range(words.size):
                if words[w] == 0:
                    continue
                for x in range(8 * w, 8 * w + 8):
                    if mask[x] and count < len(found):
                        found[count, 0], found[count, 1], found[count, 2] = s, y, x + BORDER_PX
                        count += 1
    return count


@njit(cache=True, nogil=True)
def refine_extrema(dog, found, count, least, refined):
    """Fit a quadric to each extremum; drop weak ones and edges (Sec. 4).

    Args:
        dog: (LAYERS + 2, H, W) float32.
        found: (n, 3) int32 layer, row, column.
        count: number of them.
        least: least size at the fitted extremum.
        refined: (n, 5) float64, receives x, y, scale in layers, size and layer of the survivors, in order.

    Returns:
        Number of survivors.
    """
    layers, height, width = dog.shape
    kept = 0
    for i in range(count):
        s, y, x = found[i, 0], found[i, 1], found[i, 2]
        for _ in range(_STEPS):
            d = dog[s]
            two = 2.0 * d[y, x]
            gx = 0.5 * (d[y, x + 1] - d[y, x - 1])
            gy = 0.5 * (d[y + 1, x] - d[y - 1, x])
            gs = 0.5 * (dog[s + 1, y, x] - dog[s - 1, y, x])
            xx = d[y, x + 1] + d[y, x - 1] - two
            yy = d[y + 1, x] + d[y - 1, x] - two
            ss = dog[s + 1, y, x] + dog[s - 1, y, x] - two
            xy = 0.25 * (d[y + 1, x + 1] - d[y + 1, x - 1] - d[y - 1, x + 1] + d[y - 1, x - 1])
            up, down = dog[s + 1], dog[s - 1]
            xs = 0.25 * (up[y, x + 1] - up[y, x - 1] - down[y, x + 1] + down[y, x - 1])
            ys = 0.25 * (up[y + 1, x] - up[y - 1, x] - down[y + 1, x] + down[y - 1, x])
            # Cramer's rule on the symmetric system.
            a, b, c = yy * ss - ys * ys, xs * ys - xy * ss, xy * ys - xs * yy
            det = xx * a + xy * b + xs * c
            if det == 0.0:
                break
            e, f, g = xx * ss - xs * xs, xs * xy - xx * ys, xx * yy - xy * xy
            ox = -(a * gx + b * gy + c * gs) / det
            oy = -(b * gx + e * gy + f * gs) / det
            os = -(c * gx + f * gy + g * gs) / det
            if abs(ox) < 0.5 and abs(oy) < 0.5 and abs(os) < 0.5:
                size = abs(d[y, x] + 0.5 * (gx * ox + gy * oy + gs * os))
                trace, curvature = xx + yy, xx * yy - xy * xy
                edge = curvature <= 0.0 or trace * trace * _MAX_EDGE >= (_MAX_EDGE + 1.0) ** 2 * curvature
                if size >= least and not edge:
                    refined[kept, 0], refined[kept, 1], refined[kept, 2] = x + ox, y + oy, s + os
                    refined[kept, 3], refined[kept, 4] = size, s
                    kept += 1
                break
            if abs(ox) > width or abs(oy) > height or abs(os) > layers:
                break
            x, y, s = x + round(ox), y + round(oy), s + round(os)
            if not (1 <= s < layers - 1):
                break
            if not (BORDER_PX <= x < width - BORDER_PX and BORDER_PX <= y < height - BORDER_PX):
                break
    return kept
