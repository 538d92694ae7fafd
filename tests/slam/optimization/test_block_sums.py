"""Sums over camera blocks have the bits of plain loops."""

import numpy as np
from numba import njit

from dslab.slam.optimization._block_sums import add_outer_products, subtract_products


@njit
def subtracted(S, row, column, Y, W, j):
    subtract_products(S, row, column, Y, W, j)


@njit
def added(U, f, Ju, Jv, weight):
    add_outer_products(U, f, Ju, Jv, weight)


def test_a_product_is_subtracted_from_its_block_alone_as_by_plain_loops():
    rng = np.random.default_rng(1)
    S, Y, W = rng.normal(size=(18, 18)), rng.normal(size=(3, 6)), rng.normal(size=(4, 3, 6))
    expected = S.copy()
    for r in range(6):
        for c in range(6):
            expected[6 + r, 12 + c] -= Y[0, r] * W[2, 0, c] + Y[1, r] * W[2, 1, c] + Y[2, r] * W[2, 2, c]
    subtracted(S, 6, 12, Y, W, 2)
    np.testing.assert_array_equal(S, expected)


def test_outer_products_are_added_to_their_block_alone_as_by_plain_loops():
    rng = np.random.default_rng(2)
    U, Ju, Jv, weight = rng.normal(size=(3, 6, 6)), rng.normal(size=6), rng.normal(size=6), 0.3
    expected = U.copy()
    for r in range(6):
        for c in range(6):
            expected[1, r, c] += weight * Ju[r] * Ju[c] + weight * Jv[r] * Jv[c]
    added(U, 1, Ju, Jv, weight)
    np.testing.assert_array_equal(U, expected)
