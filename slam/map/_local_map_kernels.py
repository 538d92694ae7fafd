"""The part of a map that a view is part of.

Source: Mur-Artal, Montiel, Tardós, "ORB-SLAM", 2015, V-D: keyframes that share points with the frame, and
their neighbours.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def local_keyframes(m, n_keyframes, points, least_shared, most):
    """Keyframes that see some points, that which sees most of them first; then their neighbours.

    Args:
        m: MapArrays.
        n_keyframes: count.
        points: (N,) int32 points, -1 for none.
        least_shared: points that neighbours share.
        most: keyframes; of the neighbours those that share most points with one that sees some.

    Returns:
        (k,) int32.
    """
    seen, shared = np.zeros(n_keyframes, np.int64), np.zeros(n_keyframes, np.int64)
    for p in points:
        e = m.pt_head[p] if p >= 0 else -1
        while e >= 0:
            seen[m.kp_keyframe[e]] += 1
            e = m.kp_next[e]
    keyframes = np.empty(min(most, n_keyframes), np.int32)
    n = _take(keyframes, np.int64(0), seen, np.int64(1))
    for k in keyframes[:n]:
        for j in range(n_keyframes):
            if seen[j] == 0:
                shared[j] = max(shared[j], m.covisibility[k, j])
    return keyframes[: _take(keyframes, n, shared, least_shared)].copy()


@njit(cache=True, nogil=True)
def _take(keyframes, n, count, least):
    """Append the rows that count ``least`` or more, the highest first, while there is room; how many now."""
    for k in np.argsort(-count, kind="mergesort"):
        if n == len(keyframes) or count[k] < least:
            break
        keyframes[n] = k
        n += 1
    return n


@njit(cache=True, nogil=True)
def points_seen(m, n_points, keyframes):
    """(q,) int32 points that any of some keyframes (k,) observe, each once."""
    taken = np.zeros(n_points, np.bool_)
    points = np.empty(n_points, np.int32)
    q = 0
    for k in keyframes:
        for e in range(m.kf_start[k], m.kf_start[k + 1]):
            p = m.kp_point[e]
            if p >= 0 and not taken[p]:
                taken[p] = True
                points[q] = p
                q += 1
    return points[:q].copy()
