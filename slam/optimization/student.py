"""Errors of keypoints: of Student's t, whose tails are heavier than a normal's.

All errors are normalised by their covariance: chi2 is the square. A normal's density falls faster than what
is seen, so that few far ones would decide (docs/notebook/base-decides.md has what was measured).
"""

import numpy as np
from numba import njit

TAILS = 4.0
"""Degrees of freedom."""
INFORMATION = (TAILS + 2.0) / (TAILS + 4.0) * TAILS / (TAILS - 2.0)
"""Fisher's of an error in the image, over that of a normal one of the same variance."""
CHI2_99 = (TAILS - 2.0) * (0.01 ** (-2.0 / TAILS) - 1.0)
"""In the image one of a hundred is beyond: P(more) = (1 + it / (ν - 2))^(-ν / 2), by integration."""


@njit(cache=True, nogil=True, error_model="numpy")
def density_at(chi2, det):
    """Density, 1/px², of an error in the image with a covariance of determinant ``det``."""
    tail = 1.0 + chi2 / (TAILS - 2.0)
    return TAILS / (TAILS - 2.0) / (tail * tail * tail * 2.0 * np.pi * np.sqrt(det))


@njit(cache=True, nogil=True, error_model="numpy")
def weight_at(chi2):
    """Weight of an error in least squares, by expectation maximisation over its own scale."""
    return (TAILS + 2.0) / (TAILS - 2.0 + chi2)


@njit(cache=True, nogil=True, error_model="numpy")
def loss_at(chi2):
    """Minus twice the logarithm of the density, from 0; its derivative is the weight."""
    return (TAILS + 2.0) * np.log1p(chi2 / (TAILS - 2.0))
