"""Shares by dose, by rescuability and by delay of the declaration, with intervals by worlds."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from dslab.experiments.eq1.records import SHAM, thread_column
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.judged import share_among, share_by_world
from dslab.experiments.statistics.outcomes import Floats, world_means
from dslab.experiments.statistics.world_intervals import Interval

DELAYS_S = (0.1, 0.5)
"""Ends of the classes of delay from the true loss to its declaration."""


@dataclass(frozen=True)
class DosePoint:
    """Shares at one dose of one kind of degradation in one setting.

    Attributes:
        kind, world, setting, cell, severity: which one; the sham's severity is 0.
        worlds: their number.
        shares: ``breakage``, ``thread_1`` to ``thread_n`` (R_j of the crossing arm), ``dual_1`` to
            ``dual_n`` (D_J).
    """

    kind: str
    world: str
    setting: str
    cell: str
    severity: float
    worlds: int
    shares: dict[str, Interval]


def dose_points(
    cells: Sequence[HomogeneousCell], shams: Sequence[HomogeneousCell], threads: int
) -> tuple[DosePoint, ...]:
    """Shares against dose, in the order of the cells; a sham of the same setting is the dose zero."""
    found = []
    for kind, world, setting in dict.fromkeys((c.kind, c.world, c.setting) for c in cells):
        own = [c for c in cells if (c.kind, c.world, c.setting) == (kind, world, setting)]
        zero = [c for c in shams if (c.world, c.setting) == (world, setting)]
        for cell in [*zero, *own]:
            if cell.units:
                severity = 0.0 if cell.kind == SHAM else cell.severity
                shares = _shares(cell, threads)
                found.append(DosePoint(kind, world, setting, cell.name, severity, len(cell.worlds), shares))
    return tuple(found)


def _shares(cell: HomogeneousCell, threads: int) -> dict[str, Interval]:
    outcomes, numbers = cell.outcomes, range(1, threads + 1)
    free = cell.says("breakage")
    events = {"breakage": outcomes.breakage} if free else {}
    for j, event in zip(numbers, outcomes.thread_failures, strict=True):
        if cell.says(thread_column("cross", j, "failed")):
            events[f"thread_{j}"] = event
    events |= {f"dual_{n}": event for n, event in zip(numbers, outcomes.dual_failures, strict=True) if free}
    shares = {name: share_by_world(event) for name, event in events.items()}
    return {name: share for name, share in shares.items() if share is not None}


@dataclass(frozen=True)
class Part:
    """A part of the breakages of one kind of world, over all its cells.

    Attributes:
        world: kind of world.
        part: which one.
        breakages: their number.
        share: of the breakages for which it is known to which part they belong.
        dual_failures: per n, D_J of the part's breakages.
    """

    world: str
    part: str
    breakages: int
    share: Interval | None
    dual_failures: tuple[Interval | None, ...]


def rescuable_parts(cells: Sequence[HomogeneousCell]) -> tuple[Part, ...]:
    """Breakages after which images could recover, and geometrically hopeless ones; none where unknown."""
    return _parts(cells, "rescuable", {"rescuable": lambda x: x == 1, "hopeless": lambda x: x == 0})


def delay_parts(cells: Sequence[HomogeneousCell]) -> tuple[Part, ...]:
    """Breakages by the delay of their declaration; none where it is unknown."""
    short, long = DELAYS_S
    parts: dict[str, Callable[[Floats], np.ndarray]] = {
        f"up to {short:g} s": lambda delay: delay <= short,
        f"{short:g} to {long:g} s": lambda delay: (delay > short) & (delay <= long),
        f"over {long:g} s": lambda delay: delay > long,
    }
    return _parts(cells, "declaration_delay_s", parts)


def _parts(
    cells: Sequence[HomogeneousCell], column: str, parts: Mapping[str, Callable[[Floats], np.ndarray]]
) -> tuple[Part, ...]:
    found = []
    cells = [cell for cell in cells if cell.says(column)]
    for world, (name, is_in) in product(dict.fromkeys(cell.world for cell in cells), parts.items()):
        own = [cell for cell in cells if cell.world == world]
        values = [cell.values(column) for cell in own]
        broken = [c.outcomes.breakage * np.isfinite(x) for c, x in zip(own, values, strict=True)]
        if not sum(np.nansum(b) for b in broken):
            continue
        inside = [b * is_in(x) for b, x in zip(broken, values, strict=True)]
        duals = zip(
            *([d * i for d in c.outcomes.dual_failures] for c, i in zip(own, inside, strict=True)),
            strict=True,
        )
        found.append(
            Part(
                world,
                name,
                int(sum(np.nansum(x) for x in inside)),
                _ratio(own, inside, broken),
                tuple(_ratio(own, of_first_n, inside) for of_first_n in duals),
            )
        )
    return tuple(found)


def _ratio(
    cells: Sequence[HomogeneousCell], events: Sequence[Floats], of: Sequence[Floats]
) -> Interval | None:
    """Share of events among others, over all cells, with its interval by worlds."""
    return share_among(*(Figure.mean(_over_cells(cells, x)) for x in (events, of)))


def _over_cells(cells: Sequence[HomogeneousCell], events: Sequence[Floats]) -> Floats:
    """(W,) mean over cells of the world means; a world without a unit in a cell adds nothing there."""
    seeds = np.unique(np.concatenate([cell.worlds for cell in cells]))
    total = np.zeros(len(seeds))
    for cell, event in zip(cells, events, strict=True):
        total[np.searchsorted(seeds, cell.worlds)] += np.nan_to_num(world_means(event))
    return total / len(cells)
