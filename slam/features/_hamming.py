"""Hamming distance of 256-bit descriptors stored as four uint64 words, for use in other kernels."""

import numpy as np
from numba import njit, types
from numba.extending import intrinsic


@intrinsic
def popcount64(typing_context, word):
    """Number of set bits of a uint64, as int64; one machine instruction on most CPUs."""
    if word != types.uint64:
        return None

    def codegen(context, builder, signature, args):
        return builder.ctpop(args[0])

    return types.int64(types.uint64), codegen


@njit(cache=True, nogil=True)
def hamming256(a: np.ndarray, b: np.ndarray) -> int:
    """Number of bits in which two descriptors differ.

    Args:
        a: (4,) uint64 descriptor, a row of an (N, 4) array.
        b: (4,) uint64 descriptor.

    Returns:
        Distance in [0, 256].
    """
    return (
        popcount64(a[0] ^ b[0]) + popcount64(a[1] ^ b[1]) + popcount64(a[2] ^ b[2]) + popcount64(a[3] ^ b[3])
    )


@njit(cache=True, nogil=True)
def hamming(desc_a: np.ndarray, i: int, desc_b: np.ndarray, j: int) -> int:
    """Distance of row ``i`` of ``desc_a`` and row ``j`` of ``desc_b``, both (N, 4) uint64."""
    return (
        popcount64(desc_a[i, 0] ^ desc_b[j, 0])
        + popcount64(desc_a[i, 1] ^ desc_b[j, 1])
        + popcount64(desc_a[i, 2] ^ desc_b[j, 2])
        + popcount64(desc_a[i, 3] ^ desc_b[j, 3])
    )
