"""Is pr = p0 for the same pose estimator: the base forward against thread `paper` backward, by worlds."""

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
        kind, world: which ones.
        worlds: their number.
        difference: mean over worlds of B - P.
        p: two-sided, that it is 0, by Holm over all kinds and kinds of world.
        apart: units in which the thread failed later, in fusion or by the audit.
    """

    kind: str
    world: str
    worlds: int
    difference: Interval
    p: float
    apart: int


def directions(cells: Sequence[HomogeneousCell], thread: int) -> tuple[Direction, ...]:
    """Compare p0 and pr over the doses of each kind; a unit without a new map to go back from is left out."""
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
            found.append((kind, world, Figure.mean(means), apart))
    corrected = holm([figure.p for *_, figure, _ in found])
    return tuple(
        Direction(kind, world, figure.worlds, difference_interval(figure), float(p), apart)
        for (kind, world, figure, apart), p in zip(found, corrected, strict=True)
    )
