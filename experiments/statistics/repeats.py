"""In how many of its runs a sequence breaks, and in how many a thread fails to cross it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dslab.experiments.statistics.from_records import HomogeneousCell


@dataclass(frozen=True)
class Repeats:
    """Sequences of one cell by their runs with B and with a failure of one thread in the crossing arm.

    Attributes:
        cell, world: which one.
        thread: its number from 1.
        sequences: (K + 1, K + 1) their number, by runs with B and then with R_j; those of K counted runs.
    """

    cell: str
    world: str
    thread: int
    sequences: tuple[tuple[int, ...], ...]


def repeats(cells: Sequence[HomogeneousCell]) -> tuple[Repeats, ...]:
    """Count the sequences of every cell, by thread; cells without repeats are left out."""
    return tuple(
        found
        for cell in cells
        if cell.shape[2] > 1
        for thread in range(1, cell.threads + 1)
        if (found := _of_thread(cell, thread)) is not None
    )


def _of_thread(cell: HomogeneousCell, thread: int) -> Repeats | None:
    runs = cell.shape[2]
    both = np.stack([cell.outcomes.breakage, cell.outcomes.thread_failures[thread - 1]])
    counts = both.sum(axis=-1).reshape(2, -1)  # NaN where a run does not count
    counts = counts[:, np.isfinite(counts).all(axis=0)].astype(int)
    if not counts.shape[1]:
        return None
    table = np.zeros((runs + 1, runs + 1), int)
    np.add.at(table, tuple(counts), 1)
    return Repeats(cell.name, cell.world, thread, tuple(tuple(map(int, row)) for row in table))
