"""Recovery threads beside each other, in the crossing arm, where all of them cross the same segment."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dslab.experiments.eq1.records import thread_column
from dslab.experiments.statistics.conditional import odds_ratio_over_cells, same_run
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.judged import share_by_world, share_of_part
from dslab.experiments.statistics.world_intervals import Interval


@dataclass(frozen=True)
class ThreadShares:
    """How often a thread fails in one cell of one kind of world.

    Attributes:
        cell, world: which one.
        thread: its number from 1.
        units: that every thread crossed.
        failed: R_j.
        rescuable: units whose views on either side of the stress share enough.
        failed_rescuable: R_j of these; None where the records do not say or there are none.
        needed: units in which all threads before it fail; all units for the first.
        adds: share of these that it crosses.
    """

    cell: str
    world: str
    thread: int
    units: int
    failed: Interval
    rescuable: int
    failed_rescuable: Interval | None
    needed: int
    adds: Interval | None


@dataclass(frozen=True)
class ThreadPair:
    """Whether two threads fail in the same units of one cell of one kind of world.

    Attributes:
        cell, world: which one.
        first, second: numbers of the threads.
        both, only_first, only_second, neither: units in which so many of the two fail.
        odds_ratio: odds that one fails where the other does, over those where it does not: 1 if they fail
            independently, more if in the same units, less if in others. None with fewer than three worlds, or
            if one of the two fails in all units or in none.
    """

    cell: str
    world: str
    first: int
    second: int
    both: int
    only_first: int
    only_second: int
    neither: int
    odds_ratio: Interval | None


def thread_shares(cells: Sequence[HomogeneousCell]) -> tuple[ThreadShares, ...]:
    """Shares of every thread, by cell and thread; cells without a crossing arm are left out."""
    found = []
    for cell in filter(_crosses, cells):
        failures, says = cell.outcomes.thread_failures, cell.says("rescuable")
        needed = np.where(np.isfinite(failures[0]), 1.0, np.nan)
        rescuable = cell.values("rescuable") if says else 0 * needed
        for thread, failed in enumerate(failures, 1):
            if share := share_by_world(failed):
                found.append(
                    ThreadShares(
                        cell=cell.name,
                        world=cell.world,
                        thread=thread,
                        units=int(np.isfinite(failed).sum()),
                        failed=share,
                        rescuable=int(np.nansum(rescuable)),
                        failed_rescuable=share_of_part(failed, rescuable) if says else None,
                        needed=int(np.nansum(needed)),
                        adds=share_of_part(1 - failed, needed),
                    )
                )
            needed = needed * failed
    return tuple(found)


def thread_pairs(cells: Sequence[HomogeneousCell]) -> tuple[ThreadPair, ...]:
    """Every pair of threads, by cell; cells without a crossing arm are left out."""
    found = []
    for cell in filter(_crosses, cells):
        for (first, one), (second, other) in combinations(enumerate(cell.outcomes.thread_failures, 1), 2):
            by_world = same_run(one, other).sum(axis=1)
            counts = map(int, by_world.sum(axis=0))
            odds_ratio = odds_ratio_over_cells(by_world[None])
            found.append(ThreadPair(cell.name, cell.world, first, second, *counts, odds_ratio))
    return tuple(found)


def _crosses(cell: HomogeneousCell) -> bool:
    return cell.says(*(thread_column("cross", j, "failed") for j in range(1, cell.threads + 1)))
