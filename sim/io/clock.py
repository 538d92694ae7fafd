"""Stamps in whole nanoseconds.

They count from the first frame where they are nanoseconds since 1970, since a float64 of seconds cannot hold
those; ``stamp_origin_ns`` in the sequence's ``meta`` keeps the first frame's.
"""

import numpy as np

from dslab.sim.sequence import Sequence

ORIGIN_KEY = "stamp_origin_ns"
_NS_PER_S = 1_000_000_000


def origin_ns(sequence: Sequence) -> int:
    """Nanoseconds at 0 s of a sequence."""
    return int(sequence.meta.get(ORIGIN_KEY, 0))


def choose_origin_ns(stamps: list[int]) -> int:
    """The first stamp if the last exceeds float64 precision in nanoseconds, else 0."""
    return stamps[0] if stamps[-1] >= 2**53 else 0


def to_ns(stamps_s: np.ndarray, origin: int) -> list[int]:
    """Whole nanoseconds of stamps in seconds since an origin."""
    return [origin + round(float(stamp_s) * _NS_PER_S) for stamp_s in stamps_s]


def to_seconds(stamps: list[int], origin: int) -> np.ndarray:
    """(M,) float64 seconds since an origin, exact to the nanosecond."""
    return np.array([stamp - origin for stamp in stamps], float) / _NS_PER_S
