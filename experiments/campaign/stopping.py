"""When a cell has units enough: the stopping rule of a spec, asked at fixed numbers of units."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from experiments.eq1.records import Outcome, dual_column, thread_column
from experiments.statistics.intervals import Proportion
from experiments.statistics.sequences import confidence_sequence

if TYPE_CHECKING:
    from experiments.eq1.spec import Stopping

ASKED_EVERY = 10


class NarrowEnough:
    """The confidence sequence of one quantity of a cell is narrow enough.

    It is asked when the cell has ``min_units`` units and every tenth from there: often enough to save units,
    and seldom enough that workers need not wait for one another at every unit.

    Args:
        stopping: the rule as the spec has it.
    """

    def __init__(self, stopping: "Stopping") -> None:
        self._stopping = stopping
        self._column = event_column(stopping.quantity)

    def checkpoints(self, budget: int) -> Sequence[int]:
        """Numbers of units at which it is asked."""
        return range(self._stopping.min_units, budget, ASKED_EVERY)

    def is_met(self, records: Sequence[Mapping[str, Any]]) -> bool:
        """Whether the first units of a cell are enough; void ones and errors do not count."""
        interval = self.interval(records)
        wide = (interval.high - interval.low) / 2 > self._stopping.half_width
        return interval.units >= self._stopping.min_units and not wide

    def interval(self, records: Sequence[Mapping[str, Any]]) -> Proportion:
        """The confidence sequence of the quantity."""
        events = [
            record[self._column]
            for record in records
            if record["outcome"] == Outcome.COMPLETED and record[self._column] is not None
        ]
        return confidence_sequence(sum(events), len(events), self._stopping.confidence)


def stopping_rule(stopping: "Stopping | None") -> NarrowEnough | None:
    """The rule of a spec, None where it has none."""
    return None if stopping is None else NarrowEnough(stopping)


def event_column(quantity: str) -> str:
    """The column whose share a quantity is: of ``p0``, ``pr1`` …, ``d1`` …"""
    if quantity == "p0":
        return "breakage"
    number = int(quantity.lstrip("prd"))
    return dual_column(number) if quantity[0] == "d" else thread_column("cross", number, "failed")
