"""Cholesky factorisation of a symmetric matrix with a skyline, in place, for kernels.

Local bundle adjustment and pose optimisation solve thousands of small systems: this needs no allocation and
no LAPACK threads, and gives the same bits on every run.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def whole_rows(n):
    """(n,) int64 skyline of a dense matrix: every row starts at column 0."""
    return np.zeros(n, np.int64)


# Only the dot product may be reordered, which lets it use vector registers.
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _dot(a, b, first, last):
    total = 0.0
    for k in range(first, last):
        total += a[k] * b[k]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def factor(A, first):
    """Replace the lower triangle of ``A`` (n, n) by its Cholesky factor.

    Args:
        A: symmetric matrix, of which only the lower triangle is read.
        first: (n,) int64, column of each row's first nonzero; the factor keeps this skyline.

    Returns:
        False if ``A`` is not positive definite to rounding, or not finite; ``A`` is then invalid.
    """
    for i in range(A.shape[0]):
        row = A[i]
        for j in range(first[i], i):
            begin = max(first[i], first[j])
            row[j] = (row[j] - _dot(row, A[j], begin, j)) / A[j, j]
        before = row[i]
        pivot = before - _dot(row, row, first[i], i)
        if not pivot > 1e-15 * before:
            return False
        row[i] = np.sqrt(pivot)
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def solve(L, first, b):
    """Solve ``L Lᵀ x = b`` in place of ``b`` (n,), with ``L`` from :func:`factor`."""
    n = L.shape[0]
    for i in range(n):
        b[i] = (b[i] - _dot(L[i], b, first[i], i)) / L[i, i]
    for i in range(n - 1, -1, -1):
        b[i] /= L[i, i]
        for j in range(first[i], i):
            b[j] -= L[i, j] * b[i]
