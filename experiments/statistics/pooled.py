"""Figures over several cells: over all of them, and over those of one kind of world."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.statistics.from_records import HomogeneousCell
from experiments.statistics.judged import JudgedCell
from experiments.statistics.outcomes import Floats, Outcomes, world_means
from experiments.statistics.products import product_of_distinct
from experiments.statistics.world_intervals import Interval, share_interval


@dataclass(frozen=True)
class Level:
    """Figures over all cells with n recovery threads, cells weighted by their units.

    Attributes:
        n: number of threads.
        within_kinds: product over distinct units of a cell and kind of world: Eq. 1.
        within_worlds: product over distinct units of a world; None where a world has too few.
        in_units: Q, the factors at once in one unit of the crossing arm.
        measured: D, dual failures of the free arm.
    """

    n: int
    within_kinds: float
    within_worlds: float | None
    in_units: float
    measured: float


@dataclass(frozen=True)
class KindOfWorld:
    """One kind of world with n recovery threads, over the cells that no n finds saturated, weighted alike.

    Attributes:
        world, n: which one.
        worlds: their number.
        cells, saturated: numbers of cells that are in the figures, and that are left out as saturated.
        eq1, weakest: means over the cells; None with too few worlds.
        measured: D, mean over worlds of the means over the cells; None if all are saturated.
    """

    world: str
    n: int
    worlds: int
    cells: int
    saturated: int
    eq1: float | None
    weakest: float | None
    measured: Interval | None


def level(cells: Sequence[HomogeneousCell], n: int, units: int) -> Level:
    """Pool all cells with the first n threads, whose completed units are so many."""
    each = [cell.outcomes.of_first(n) for cell in cells]
    counts = [cell.units for cell in cells]
    within_kinds = [float(product_of_distinct(o.columns.reshape(1 + n, -1))) for o in each]
    return Level(
        n=n,
        within_kinds=float(np.dot(counts, within_kinds)) / units,
        within_worlds=_within_worlds(each),
        in_units=sum(float(np.nansum(np.prod(o.columns, axis=0))) for o in each) / units,
        measured=sum(float(np.nansum(o.dual_failures[-1])) for o in each) / units,
    )


def _within_worlds(each: Sequence[Outcomes]) -> float | None:
    """Product over the distinct units of a world, worlds weighted by their units."""
    total = count = 0.0
    for outcomes in each:
        rows = outcomes.columns.reshape(*outcomes.columns.shape[:2], -1)
        product, valid = product_of_distinct(rows), np.isfinite(rows).all(axis=0).sum(axis=1)
        if np.isnan(product[valid > 0]).any():
            return None
        total += float((product[valid > 0] * valid[valid > 0]).sum())
        count += float(valid.sum())
    return total / count if count else None


def by_world(cells: Sequence[HomogeneousCell], outcomes: Sequence[Floats]) -> Floats:
    """(W,) mean over the cells of each world's mean, in whatever cells it is."""
    means: dict[tuple[str, int], list[float]] = {}
    for cell, outcome in zip(cells, outcomes, strict=True):
        for seed, mean in zip(cell.worlds, world_means(outcome), strict=True):
            if np.isfinite(mean):
                means.setdefault((cell.world, int(seed)), []).append(float(mean))
    return np.asarray([np.mean(of_world) for of_world in means.values()], dtype=np.float64)


def kind_of_world(
    cells: Sequence[HomogeneousCell], judged: Sequence[JudgedCell], world: str, n: int
) -> KindOfWorld:
    """Pool the cells of a kind of world that no number of threads finds saturated."""
    own = [cell for cell in cells if cell.world == world]
    saturated = {c.cell for c in judged if c.world == world and c.saturated}
    told = [c for c in judged if (c.world, c.n) == (world, n) and c.cell not in saturated]
    kept = [cell for cell in own if cell.name in {c.cell for c in told}]
    known = bool(told) and all(c.eq1 is not None for c in told)
    measured = by_world(kept, [c.outcomes.of_first(n).dual_failures[-1] for c in kept])
    return KindOfWorld(
        world=world,
        n=n,
        worlds=len({int(seed) for cell in own for seed in cell.worlds}),
        cells=len(kept),
        saturated=len(saturated),
        eq1=float(np.mean([c.eq1 for c in told])) if known else None,
        weakest=float(np.mean([c.weakest for c in told])) if known else None,
        measured=share_interval(measured) if len(measured) else None,
    )
