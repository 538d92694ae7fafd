"""The stopping rule of a spec, evaluated at fixed numbers of units of a cell."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from experiments.eq1.records import Outcome, dual_column, thread_column
from experiments.statistics.intervals import Proportion
from experiments.statistics.sequences import confidence_sequence

if TYPE_CHECKING:
    from experiments.eq1.spec import Stopping

EVALUATED_EVERY = 10


class NarrowEnough:
    """Rule that the confidence sequence of one quantity of a cell is narrow enough.

    It is evaluated at ``min_units`` units and after every ten more: often enough to save units, and rarely
    enough that workers seldom wait for one another.

    Args:
        stopping: the rule in the spec.
    """

    def __init__(self, stopping: "Stopping") -> None:
        self._stopping = stopping
        self._column = event_column(stopping.quantity)

    def checkpoints(self, budget: int) -> Sequence[int]:
        """Numbers of units at which it is evaluated."""
        return range(self._stopping.min_units, budget, EVALUATED_EVERY)

    def is_met(self, records: Sequence[Mapping[str, Any]]) -> bool:
        """True if the first units of a cell are enough; void ones and errors do not count."""
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
    """The rule of a spec; None if it has none."""
    return None if stopping is None else NarrowEnough(stopping)


def event_column(quantity: str) -> str:
    """The column of a quantity ``p0``, ``pr1`` … or ``d1`` …, which is its share of true values."""
    if quantity == "p0":
        return "breakage"
    number = int(quantity.lstrip("prd"))
    return dual_column(number) if quantity[0] == "d" else thread_column("cross", number, "failed")
