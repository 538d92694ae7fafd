"""Room on disks and in memory, estimated before long work begins."""

import os
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from dslab.scenarios.errors import InputError
from dslab.sim.cache import MAX_BYTES

MOST_BYTES = MAX_BYTES
"""Work that writes more is to be asked for: it is more than the cache keeps, and eight times the longest
sequence of the library."""
_REMEDY = "take fewer or smaller frames, free some, or add --force (force=True) to begin nevertheless"
_PLAN_BYTES = 2048
"""Memory of the poses and times of one frame."""


@dataclass(frozen=True)
class Need:
    """What some work will write.

    Attributes:
        place: the folder; it need not exist.
        size_bytes: estimate of its size.
    """

    place: Path
    size_bytes: int


def images_need(
    place: Path, frames: int, size_px: tuple[int, int], depth: bool = False, colour: bool = False
) -> Need:
    """What a sequence folder needs at worst, if its images cannot be compressed."""
    return Need(place, frames * size_px[0] * size_px[1] * ((3 if colour else 1) + (2 if depth else 0)))


def check_room(what: str, frames: int, needs: Iterable[Need], force: bool = False) -> None:
    """Check that a sequence has room on the disks and its frame plan in the memory.

    Args:
        what: its name, for the message.
        frames: its number of frames.
        needs: what is written; needs on one disk are summed.
        force: check nothing: the estimate is of the worst case.

    Raises:
        InputError: it does not fit, or is larger than ``MOST_BYTES``.
    """
    if force:
        return
    sums: dict[int, tuple[Path, int]] = {}
    for need in needs:
        there = _existing(need.place)
        disk = there.stat().st_dev
        sums[disk] = there, need.size_bytes + sums.get(disk, (there, 0))[1]
    check_memory(what, frames, frames * _PLAN_BYTES)
    for there, size_bytes in sums.values():
        free_bytes = shutil.disk_usage(there).free
        if size_bytes > free_bytes:
            problem = f"{frames} frames need up to {_gb(size_bytes)} in {there}, {_gb(free_bytes)} are free"
            raise InputError(what, problem, _REMEDY)
    if (total_bytes := sum(size_bytes for _, size_bytes in sums.values())) > MOST_BYTES:
        problem = f"{frames} frames need up to {_gb(total_bytes)}, which is much"
        raise InputError(what, problem, "take fewer or smaller frames, or add --force (force=True)")


def check_memory(what: str, frames: int, size_bytes: int) -> None:
    """Check that what is held of a sequence fits into the memory that is free.

    Raises:
        InputError: it does not.
    """
    import psutil

    free_bytes = psutil.virtual_memory().available
    if size_bytes > free_bytes:
        problem = f"{frames} frames need about {_gb(size_bytes)} of memory, {_gb(free_bytes)} are free"
        raise InputError(what, problem, "take fewer frames, or a machine with more memory")


def _existing(place: Path) -> Path:
    place = Path(os.path.realpath(place))
    return next(folder for folder in (place, *place.parents) if folder.exists())


def _gb(size_bytes: int) -> str:
    return f"{size_bytes / 1e9:,.1f} GB"
