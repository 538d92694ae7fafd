"""Both readings of Eq. 1, of each sequence and of averages over sequences, beside what is measured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dslab.experiments.statistics.estimates import (
    Figure,
    dual_failure,
    measured_in_units,
    over_cells,
    product_in_sequences,
    product_of_margins,
)
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.judged import ratio_of_shares
from dslab.experiments.statistics.outcomes import Outcomes
from dslab.experiments.statistics.world_intervals import Interval, difference_interval, share_interval


@dataclass(frozen=True)
class Reading:
    """One reading of Eq. 1 against what is measured.

    Attributes:
        predicted: pi_seq or pi_marg.
        ratio, ratio_in_units: D and Q over the prediction; None where it predicts nothing.
        difference: D minus the prediction, over several cells; None in one, whose events may be too few.
    """

    predicted: float
    ratio: Interval | None
    ratio_in_units: Interval | None
    difference: Interval | None


@dataclass(frozen=True)
class Readings:
    """Both readings with the first n threads, in one cell or over all.

    Attributes:
        n: number of threads.
        cell, world: which one; None over all cells, weighted alike.
        units, worlds: their numbers.
        measured: D.
        in_units: Q.
        of_sequences: by each sequence's own p0 and pr; None with too few replicates.
        of_averages: by averages over sequences.
    """

    n: int
    cell: str | None
    world: str | None
    units: int
    worlds: int
    measured: Interval
    in_units: float
    of_sequences: Reading | None
    of_averages: Reading


@dataclass(frozen=True)
class Rescuable:
    """Eq. 1 over the rescuable units of a cell alone.

    Attributes:
        cell, world: which one.
        n: number of threads.
        readings: over these units; None with too few worlds.
        failures, hopeless: dual failures of all units, and those that no recovery by images can prevent.
    """

    cell: str
    world: str
    n: int
    readings: Readings | None
    failures: int
    hopeless: int


def both_readings(cells: Sequence[HomogeneousCell], n: int) -> list[Readings]:
    """Compare D with both readings: over all cells, if there are several, then in each with enough worlds."""
    each = [(cell, o) for cell in cells if len((o := cell.usable(n)).breakage) > 1 + n]
    pooled = [_readings([o for _, o in each])] if len(each) > 1 else []
    return [*pooled, *(_readings([o], cell) for cell, o in each)]


def rescuable_readings(cells: Sequence[HomogeneousCell], n: int) -> list[Rescuable]:
    """Compare D with Eq. 1 over units whose views on either side of the stress share enough.

    Whether a unit is rescuable is known only after it ran: this describes and predicts nothing. Cells whose
    records do not say it are left out.
    """
    found = []
    for cell in (cell for cell in cells if cell.says("rescuable")):
        first, rescuable = cell.outcomes.first(n), cell.values("rescuable")
        own = first.where(rescuable == 1).with_units()
        failed = first.dual_failures[-1] == 1
        readings = _readings([own], cell) if len(own.breakage) > 1 + n else None
        hopeless = int((failed & (rescuable == 0)).sum())
        found.append(Rescuable(cell.name, cell.world, n, readings, int(failed.sum()), hopeless))
    return found


def _readings(cells: Sequence[Outcomes], alone: HomogeneousCell | None = None) -> Readings:
    """The readings over cells, or in the only one."""
    worlds = [outcomes.worlds for outcomes in cells]
    measured, in_units, of_averages = (
        over_cells([estimate(outcomes) for outcomes in cells], worlds)
        for estimate in (dual_failure, measured_in_units, product_of_margins)
    )
    of_sequences = [f for outcomes in cells if (f := product_in_sequences(outcomes)) is not None]

    def reading(predicted: Figure, shares: tuple[float, ...] = ()) -> Reading:
        return Reading(
            predicted.value,
            ratio_of_shares(measured, predicted, shares),
            ratio_of_shares(in_units, predicted, shares),
            None if alone else difference_interval(measured - predicted),
        )

    return Readings(
        n=cells[0].threads,
        cell=alone.name if alone else None,
        world=alone.world if alone else None,
        units=sum(int(np.isfinite(outcomes.breakage).sum()) for outcomes in cells),
        worlds=measured.worlds,
        measured=share_interval(measured),
        in_units=in_units.value,
        of_sequences=reading(over_cells(of_sequences, worlds)) if len(of_sequences) == len(cells) else None,
        of_averages=reading(of_averages, cells[0].margins if alone else ()),
    )
