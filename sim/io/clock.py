"""Stamps in whole nanoseconds.

They count from the first frame where they are nanoseconds since 1970, since a float64 of seconds cannot hold
those; ``stamp_origin_ns`` in the sequence's ``meta`` keeps the first frame's. Of forms whose stamps are
seconds since 1970, ``Sequence.stamps_ns`` keeps what float64 does not hold.
"""

from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.sim.sequence import Sequence

ORIGIN_KEY = "stamp_origin_ns"
_NS_PER_S = 1_000_000_000
_MOST_NS = 10**19 - 1
"""Largest number of the digits that readers take."""


def origin_ns(sequence: Sequence) -> int:
    """Nanoseconds at 0 s of a sequence."""
    return int(sequence.meta.get(ORIGIN_KEY, 0))


def choose_origin_ns(stamps: list[int]) -> int:
    """The first stamp if the last exceeds float64 precision in nanoseconds, else 0."""
    return stamps[0] if stamps[-1] >= 2**53 else 0


def to_ns(stamps_s: np.ndarray, origin: int) -> list[int]:
    """Whole nanoseconds of stamps in seconds since an origin."""
    return [origin + round(float(stamp_s) * _NS_PER_S) for stamp_s in stamps_s]


def held_stamps(path: Path, stamps: list[Decimal]) -> tuple[np.ndarray, np.ndarray | None]:
    """(N,) float64 of increasing stamps in seconds, and (N,) int64 nanoseconds where that does not hold them.

    Raises:
        InputError: of the file, if two are one in float64.
    """
    stamps_s = np.array(stamps, float)
    same = np.flatnonzero(np.diff(stamps_s) <= 0)
    if len(same):
        problem = f"{stamps[same[0] + 1]} cannot be told from {stamps[same[0]]}"
        raise InputError(f"{path}: stamp", problem, "remove doubles")
    whole = [round(stamp * _NS_PER_S) for stamp in stamps]
    unheld = 2**53 <= max(map(abs, whole)) < 2**63
    return stamps_s, np.array(whole, np.int64) if unheld else None


def written_ns(sequence: Sequence) -> list[int]:
    """Whole nanoseconds of the frames, as they were read, for a form that holds no others.

    Raises:
        InputError: one is below 0 or too large, or two frames have the same.
    """
    origin = origin_ns(sequence)
    stamps = [origin + stamp for stamp in _read_or_rounded(sequence)]
    if not 0 <= stamps[0] <= stamps[-1] <= _MOST_NS:
        problem = "has stamps below 0" if stamps[0] < 0 else f"has stamps above {_MOST_NS} ns"
        raise InputError(sequence.name, f"{problem}, which this form cannot hold", "use tum")
    return stamps


def written_seconds(sequence: Sequence) -> list[str]:
    """Seconds of the frames with nine decimals, as they were read.

    Raises:
        InputError: two frames have the same.
    """
    if sequence.stamps_ns is None:
        texts = [f"{stamp_s:.9f}" for stamp_s in sequence.stamps_s]
        _check_apart(sequence, [float(text) for text in texts])
        return texts
    return [f"{Decimal(stamp).scaleb(-9):.9f}" for stamp in _read_or_rounded(sequence)]


def _read_or_rounded(sequence: Sequence) -> list[int]:
    """Nanoseconds since the origin: as read where a stamp is still the one that was read."""
    stamps = to_ns(sequence.stamps_s, 0)
    if sequence.stamps_ns is not None:
        pairs = zip(sequence.stamps_ns.tolist(), stamps, sequence.stamps_s, strict=True)
        # To the step of float64 at that time.
        stamps = [read if abs(read / _NS_PER_S - s) <= np.spacing(abs(s)) else now for read, now, s in pairs]
    _check_apart(sequence, stamps)
    return stamps


def _check_apart(sequence: Sequence, stamps: list) -> None:
    if any(later <= earlier for earlier, later in pairwise(stamps)):
        problem = "has frames less than a nanosecond apart, which no form can hold"
        raise InputError(sequence.name, problem, "leave one of them out")


def to_seconds(stamps: list[int], origin: int) -> np.ndarray:
    """(M,) float64 seconds since an origin, exact to the nanosecond."""
    return np.array([stamp - origin for stamp in stamps], float) / _NS_PER_S
