"""The keypoint near a pixel that looks most like a point."""

from numba import njit

from dslab.slam.features._hamming import hamming256

GUIDED_BITS, FREE_BITS = 100, 50
"""Largest distance of descriptors that match where one is expected, and anywhere: ORB-SLAM's text gives none,
those of its release."""


@njit(cache=True, nogil=True)
def nearest(view, xy, octave, descriptors, cell_start, first, u, v, radius, finest, coarsest, query):
    """Find the keypoint with the nearest descriptor, of those in a circle and on some levels.

    Args:
        view: ViewGeometry.
        xy, octave, descriptors: keypoints; the frame's rows start at ``first``.
        cell_start: the frame's grid, relative to ``first``.
        first: see there.
        u, v, radius: circle, px.
        finest, coarsest: levels, a fraction each, inclusive.
        query: (4,) uint64 descriptor.

    Returns:
        (row within the frame or -1, distance in bits or 257).
    """
    found, best = -1, 257
    left = max(int((u - radius - view.x_min) / view.cell), 0)
    right = min(int((u + radius - view.x_min) / view.cell), view.cols - 1)
    top = max(int((v - radius - view.y_min) / view.cell), 0)
    bottom = min(int((v + radius - view.y_min) / view.cell), view.rows - 1)
    if u + radius < view.x_min or v + radius < view.y_min or left > right:
        return found, best
    for r in range(top, bottom + 1):
        for i in range(cell_start[r * view.cols + left], cell_start[r * view.cols + right + 1]):
            e = first + i
            du, dv = xy[e, 0] - u, xy[e, 1] - v
            if du * du + dv * dv > radius * radius or not finest <= octave[e] <= coarsest:
                continue
            bits = hamming256(query, descriptors[e])
            if bits < best:
                found, best = i, bits
    return found, best
