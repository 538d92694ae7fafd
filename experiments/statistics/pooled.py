"""Figures over several cells: over all of them, and over those of one kind of world."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dslab.experiments.statistics import estimates
from dslab.experiments.statistics.estimates import mean_over_cells
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.judged import JudgedCell, usable, worlds_of
from dslab.experiments.statistics.outcomes import Floats, world_means
from dslab.experiments.statistics.world_intervals import Interval, share_interval_of


@dataclass(frozen=True)
class Level:
    """Figures over all cells with n recovery threads, cells weighted alike, in each its worlds alike.

    Attributes:
        n: number of threads.
        cells: their number, of those with enough worlds for Eq. 1.
        eq1: pi_marg.
        in_worlds, in_sequences: pi_world and pi_seq; None where a cell has too few sequences or replicates.
        in_units: Q, the factors at once in one unit of the crossing arm.
        measured: D, dual failures of the free arm.
        first_alone: D of the first thread alone, of the same units.
    """

    n: int
    cells: int
    eq1: float
    in_worlds: float | None
    in_sequences: float | None
    in_units: float
    measured: float
    first_alone: float


@dataclass(frozen=True)
class KindOfWorld:
    """One kind of world with n recovery threads, over the cells that no n finds saturated, weighted alike.

    Attributes:
        world, n: which one.
        worlds: their number.
        cells, saturated: numbers of cells that are in the figures, and that are left out as saturated.
        eq1, weakest: means over the cells; None with too few worlds.
        measured: D, mean over the cells, of the worlds of each; None if all are saturated.
    """

    world: str
    n: int
    worlds: int
    cells: int
    saturated: int
    eq1: float | None
    weakest: float | None
    measured: Interval | None


def level(cells: Sequence[HomogeneousCell], n: int) -> Level | None:
    """Pool all cells with the first n threads; None if none has enough worlds."""
    each = [outcomes for cell in cells if len((outcomes := usable(cell, n)).breakage) > 1 + n]
    if not each:
        return None

    def mean(figures: Sequence[estimates.Figure | None]) -> float | None:
        values = [figure.value for figure in figures if figure is not None]
        return float(np.mean(values)) if len(values) == len(figures) else None

    return Level(
        n=n,
        cells=len(each),
        eq1=float(np.mean([estimates.product_of_margins(o).value for o in each])),
        in_worlds=mean([estimates.product_in_worlds(o) for o in each]),
        in_sequences=mean([estimates.product_in_sequences(o) for o in each]),
        in_units=float(np.mean([estimates.measured_in_units(o).value for o in each])),
        measured=float(np.mean([estimates.dual_failure(o).value for o in each])),
        first_alone=float(np.mean([estimates.share(o.dual_failures[0]).value for o in each])),
    )


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
    measured = [world_means(usable(cell, n).dual_failures[-1]) for cell in kept]
    worlds = [worlds_of(cell, n) for cell in kept]
    return KindOfWorld(
        world=world,
        n=n,
        worlds=len({int(seed) for cell in own for seed in cell.worlds}),
        cells=len(kept),
        saturated=len(saturated),
        eq1=float(np.mean([c.eq1 for c in told])) if known else None,
        weakest=float(np.mean([c.weakest for c in told])) if known else None,
        measured=share_interval_of(mean_over_cells(measured, worlds)) if kept else None,
    )
