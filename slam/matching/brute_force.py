"""Unguided descriptor matching."""

import numpy as np
from numba import njit

from dslab.slam.features._hamming import popcount64
from dslab.slam.matching.orientation import common_turn

# A key packs a distance above an index: one integer minimum finds the nearest and, of equals, the first.
_INDEX_BITS = 21
_NO_KEY = np.int32(2**31 - 1)


@njit(cache=True, nogil=True)
def _keys_of_row(a0, a1, a2, a3, b0, b1, b2, b3, keys):
    for j in range(np.uint64(keys.size)):
        distance = (
            popcount64(a0 ^ b0[j]) + popcount64(a1 ^ b1[j]) + popcount64(a2 ^ b2[j]) + popcount64(a3 ^ b3[j])
        )
        keys[j] = np.int32((distance << _INDEX_BITS) | np.int64(j))


@njit(cache=True, nogil=True)
def _least(keys):
    least = _NO_KEY
    for j in range(np.uint64(keys.size)):
        least = min(least, keys[j])
    return least


@njit(cache=True, nogil=True)
def _match(desc_a, words_b, max_distance, ratio):
    n_b = words_b.shape[1]
    keys = np.empty(n_b, np.int32)
    best_of_b = np.full(n_b, -1, np.int32)
    distance_of_b = np.full(n_b, 257, np.int32)
    for i in range(desc_a.shape[0]):
        a = desc_a[i]
        _keys_of_row(a[0], a[1], a[2], a[3], words_b[0], words_b[1], words_b[2], words_b[3], keys)
        first = _least(keys)
        distance = first >> _INDEX_BITS
        j = first & ((1 << _INDEX_BITS) - 1)
        if distance > max_distance or distance >= distance_of_b[j]:
            continue
        keys[j] = _NO_KEY
        # With a single candidate the second distance is that of _NO_KEY, larger than any other.
        if distance < ratio * (_least(keys) >> _INDEX_BITS):
            best_of_b[j] = i
            distance_of_b[j] = distance
    return best_of_b


def match_brute_force(desc_a: np.ndarray, desc_b: np.ndarray, max_distance: int, ratio: float) -> np.ndarray:
    """Match descriptors of A with their nearest in B, if near and unambiguous.

    Args:
        desc_a: (N, 4) uint64.
        desc_b: (M, 4) uint64, M < 2**21.
        max_distance: largest distance of a match, bits.
        ratio: the nearest must be nearer than ``ratio`` times the second nearest (Lowe's test).

    Returns:
        (K, 2) int32 rows (index in A, index in B), by index in A. No index occurs twice: of several matches
        with the same one of B the nearest is kept, and the first among equals. Empty if either side is.

    Raises:
        ValueError: an array has another shape or type.
    """
    for name, desc in (("desc_a", desc_a), ("desc_b", desc_b)):
        if desc.dtype != np.uint64 or desc.ndim != 2 or desc.shape[1] != 4:
            raise ValueError(f"{name} must be (N, 4) uint64, is {desc.shape} {desc.dtype}")
    if len(desc_b) >= 2**_INDEX_BITS:
        raise ValueError(f"desc_b has {len(desc_b)} rows, most is {2**_INDEX_BITS - 1}")
    best_of_b = _match(
        np.ascontiguousarray(desc_a), np.ascontiguousarray(desc_b.T), int(max_distance), float(ratio)
    )
    matched = np.flatnonzero(best_of_b >= 0)
    matches = np.stack([best_of_b[matched], matched], axis=1).astype(np.int32)
    return matches[np.argsort(matches[:, 0])]


def match_oriented(
    desc_a: np.ndarray,
    angle_a: np.ndarray,
    desc_b: np.ndarray,
    angle_b: np.ndarray,
    max_distance: int,
    ratio: float,
) -> np.ndarray:
    """Match as :func:`match_brute_force`, and keep what has the :func:`common_turn`; angles in degrees."""
    pairs = match_brute_force(desc_a, desc_b, max_distance, ratio)
    return pairs[common_turn(angle_b[pairs[:, 1]].astype(float) - angle_a[pairs[:, 0]])]
