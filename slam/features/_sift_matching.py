"""Nearest neighbours among SIFT descriptors, by brute force.

Squared distances are |a|² + |b|² - 2ab. Their products are summed in float32, which is exact: they are
whole numbers below 2^24. So neither the order of the sums nor fused multiplication changes a bit.
"""

import numpy as np
from numba import njit

_ROWS = 4  # handled at once, so that every descriptor of b is read once for all of them
_FAR = np.int32(2**31 - 1)


@njit(cache=True, nogil=True)
def nearest(a, b):
    """Nearest rows to each other of a (n, 128) and b (m, 128) uint8, m > 0.

    The descriptors' norms must be below 2,048; those of SIFT are 512.

    Returns:
        nearest (n,) int64 rows of b, best2 and second2 (n,) int32 squared distances to it and to the next,
        nearest_back (m,) int64 rows of a. Of equal distances the first row counts.
    """
    n, m = len(a), len(b)
    rows, own2 = np.zeros((n + _ROWS - 1, 128), np.float32), np.zeros(n, np.int32)
    for i in range(n):
        for k in range(128):
            v = np.int32(a[i, k])
            rows[i, k] = v
            own2[i] += v * v
    columns, their2 = np.empty(128 * m, np.float32), np.zeros(m, np.int32)
    for j in range(m):
        for k in range(128):
            v = np.int32(b[j, k])
            columns[k * m + j] = v
            their2[j] += v * v
    found, best2, second2 = np.empty(n, np.int64), np.empty(n, np.int32), np.empty(n, np.int32)
    back, back2 = np.zeros(m, np.int64), np.full(m, _FAR)
    products, distance2 = np.empty(_ROWS * m, np.float32), np.empty(m, np.int32)
    for i in range(0, n, _ROWS):
        _multiply(rows, columns, i, m, products)
        for row in range(min(_ROWS, n - i)):
            r = i + row
            found[r], best2[r], second2[r] = _rank(
                own2[r], their2, products, row * m, r, distance2, back, back2
            )
    return found, best2, second2, back


@njit(cache=True, nogil=True, fastmath={"contract"})
def _multiply(rows, columns, first, m, products):
    """Scalar products (_ROWS * m,) of rows ``first`` to ``first + 3`` with all columns."""
    um = np.uint64(m)
    for j in range(np.uint64(_ROWS) * um):
        products[j] = 0
    p, q, r, s = rows[first], rows[first + 1], rows[first + 2], rows[first + 3]
    d1, d2, d3 = um, um + um, um + um + um
    for k in range(0, 128, 4):
        p0, p1, p2, p3 = p[k], p[k + 1], p[k + 2], p[k + 3]
        q0, q1, q2, q3 = q[k], q[k + 1], q[k + 2], q[k + 3]
        r0, r1, r2, r3 = r[k], r[k + 1], r[k + 2], r[k + 3]
        s0, s1, s2, s3 = s[k], s[k + 1], s[k + 2], s[k + 3]
        o0 = np.uint64(k) * um
        o1, o2, o3 = o0 + d1, o0 + d2, o0 + d3
        for j in range(um):
            b0, b1, b2, b3 = columns[o0 + j], columns[o1 + j], columns[o2 + j], columns[o3 + j]
            products[j] = products[j] + p0 * b0 + p1 * b1 + p2 * b2 + p3 * b3
            products[d1 + j] = products[d1 + j] + q0 * b0 + q1 * b1 + q2 * b2 + q3 * b3
            products[d2 + j] = products[d2 + j] + r0 * b0 + r1 * b1 + r2 * b2 + r3 * b3
            products[d3 + j] = products[d3 + j] + s0 * b0 + s1 * b1 + s2 * b2 + s3 * b3


@njit(cache=True, nogil=True)
def _rank(own2, their2, products, start, row, distance2, back, back2):
    """Nearest row of b, its squared distance and the second smallest; updates the nearest rows of a."""
    m, at = np.uint64(their2.size), np.uint64(start)
    best2 = second2 = _FAR
    for j in range(m):
        d = own2 + their2[j] - np.int32(2) * np.int32(products[at + j])
        distance2[j] = d
        best2 = min(best2, d)
    for j in range(m):
        closer = distance2[j] < back2[j]
        back[j] = row if closer else back[j]
        back2[j] = distance2[j] if closer else back2[j]
    found = 0
    while distance2[found] != best2:
        found += 1
    distance2[found] = _FAR
    for j in range(m):
        second2 = min(second2, distance2[j])
    return found, best2, second2
