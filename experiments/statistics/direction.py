"""Is pr = p0, or less: the base forward against the threads of Algorithm 1 backward, by worlds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dslab.experiments.eq1.records import thread_column
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.pooled import by_world
from dslab.experiments.statistics.verdicts import holm
from dslab.experiments.statistics.world_intervals import Interval, difference_interval


@dataclass(frozen=True)
class Direction:
    """B against P, a failure of the thread in propagation, in one kind of degradation and of world.

    Attributes:
        thread: its number.
        kind, world: which ones.
        worlds: their number.
        difference: mean over worlds of B - P.
        p: two-sided, that it is 0, by Holm over all kinds, kinds of world and threads.
        apart: units in which the thread failed later, in fusion or by the audit.
    """

    thread: int
    kind: str
    world: str
    worlds: int
    difference: Interval
    p: float
    apart: int


def directions(cells: Sequence[HomogeneousCell], threads: Sequence[int]) -> tuple[Direction, ...]:
    """Compare p0 and pr over the doses of each kind; a unit without a new map to go back from is left out."""
    found = [each for thread in threads for each in _of_thread(cells, thread)]
    corrected = holm([figure.p for *_, figure, _ in found])
    return tuple(
        Direction(*of, figure.worlds, difference_interval(figure), float(p), apart)
        for (*of, figure, apart), p in zip(found, corrected, strict=True)
    )


def _of_thread(cells: Sequence[HomogeneousCell], thread: int) -> list[tuple[int, str, str, Figure, int]]:
    failed, stage = (thread_column("cross", thread, name) for name in ("failed", "stage"))
    found = []
    for kind, world in dict.fromkeys((c.kind, c.world) for c in cells if c.says(failed)):
        own = [cell for cell in cells if (cell.kind, cell.world) == (kind, world)]
        differences, apart = [], 0
        for cell in own:
            stages = cell.rows[stage].fillna("").astype(str).to_numpy()
            propagation = cell.grid((stages == "propagation").astype(float))
            begun = cell.grid(np.where(stages == "no_reinit", np.nan, 1.0))
            differences.append((cell.outcomes.breakage - propagation) * begun)
            apart += int((cell.counted & np.isin(stages, ("overlap", "sim3", "fusion", "audit"))).sum())
        means = by_world(own, differences)
        if len(means) > 2:
            found.append((thread, kind, world, Figure.mean(means), apart))
    return found
