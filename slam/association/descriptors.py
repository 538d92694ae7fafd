"""What the distance of two ORB descriptors says of whether they show one point.

Distances were looked at where exact depth tells right pairs (docs/notebook/base-decides.md); those of
wrong ones are of independent keypoints, but for a share that looks alike: repeated texture.
"""

from functools import cache

import numpy as np
from scipy.stats import norm

LOOK_ALIKES = 0.05
"""Share of the keypoints near a point's place that show something else and look like it."""
_RIGHT, _WRONG = (42.0, 20.0), (112.0, 24.0)
"""Mean and standard deviation in bits of right pairs and of pairs of independent keypoints."""


@cache
def odds_by_distance() -> np.ndarray:
    """(257,) P(distance | one point) over P(distance | another point)."""
    bits = np.arange(257)
    right, wrong = (norm.pdf(bits, mean, deviation) for mean, deviation in (_RIGHT, _WRONG))
    right, wrong = right / right.sum(), wrong / wrong.sum()
    # A normal density falls faster than what is seen: a share of ten thousand lies anywhere.
    right, wrong = (0.9999 * each + 1e-4 / 257 for each in (right, wrong))
    odds = right / ((1.0 - LOOK_ALIKES) * wrong + LOOK_ALIKES * right)
    return np.minimum.accumulate(odds)  # no distance says more than a smaller one
