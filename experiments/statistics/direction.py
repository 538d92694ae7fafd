"""Is pr = p0 for the same pose estimator: the base forward against thread `paper` backward, by worlds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from dslab.experiments.eq1.records import thread_column
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.outcomes import world_means
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
    """Compare p0 and pr over the doses of each kind; a unit without a new map to go back from is left out.

    Args:
        cells: with a dose.
        thread: number of the thread nearest to Algorithm 1's thread 1.
    """
    failed, stage = (thread_column("cross", thread, name) for name in ("failed", "stage"))
    found = []
    for kind, world in dict.fromkeys((c.kind, c.world) for c in cells if c.says(failed)):
        by_seed: dict[int, list[float]] = {}
        apart = 0
        for cell in (c for c in cells if (c.kind, c.world) == (kind, world)):
            stages = cell.rows[stage].fillna("").astype(str).to_numpy()
            propagation = cell.grid((stages == "propagation").astype(float))
            begun = cell.grid(np.where(stages == "no_reinit", np.nan, 1.0))
            means = world_means((cell.outcomes.breakage - propagation) * begun)
            for seed, mean in zip(cell.worlds, means, strict=True):
                if np.isfinite(mean):
                    by_seed.setdefault(int(seed), []).append(float(mean))
            apart += int((cell.counted & np.isin(stages, ("overlap", "sim3", "fusion", "audit"))).sum())
        if len(by_seed) > 2:
            figure = Figure.mean(np.array([np.mean(means) for means in by_seed.values()]))
            found.append((kind, world, figure, apart))
    corrected = holm([_p(figure) for *_, figure, _ in found])
    return tuple(
        Direction(kind, world, figure.worlds, difference_interval(figure), float(p), apart)
        for (kind, world, figure, apart), p in zip(found, corrected, strict=True)
    )


def _p(figure: Figure) -> float:
    return float(2 * stats.t.sf(abs(figure.t), figure.freedom))
