"""The turn that matches have in common.

The orientations of right matches of two images turn alike, up to perspective and their own noise: in pairs
of frames of four recorded sequences, 2 and 10 apart, half of those that fit an epipolar geometry are within 1
to 3 degrees of their mean, 98 to 100 % within 18. Chance matches turn by any angle. The check is that of
Mur-Artal and Tardós, "Fast relocalisation and loop closing in keyframe-based SLAM", ICRA 2014, by a window on
the circle in place of a histogram.
"""

import numpy as np
from numba import njit

WINDOW_DEG = 40.0
"""Turns that agree lie in a window of this width."""


@njit(cache=True, nogil=True)
def common_turn(turn_deg):
    """(n,) bool, True for the turns (n,) float64 in degrees that lie in the window with most of them."""
    n = len(turn_deg)
    turn = turn_deg % 360.0
    order = np.argsort(turn, kind="mergesort")
    first, most, end = 0, 0, 0
    for begin in range(n):
        end = max(end, begin)
        while end < begin + n:
            ahead = turn[order[end % n]] + 360.0 * (end // n)
            if ahead - turn[order[begin]] > WINDOW_DEG:
                break
            end += 1
        if end - begin > most:
            first, most = begin, end - begin
    common = np.zeros(n, np.bool_)
    for k in range(first, first + most):
        common[order[k % n]] = True
    return common


@njit(cache=True, nogil=True)
def keep_common_turn(matched, turn_deg):
    """Unset matches (n,) int32, -1 for none, whose turn (n,) is not the common one; how many are left."""
    rows = np.flatnonzero(matched >= 0)
    common = common_turn(turn_deg[rows])
    matched[rows[~common]] = -1
    return common.sum()
