"""What is asked of all cells of the same worlds at once: chance within sequences, and formulas."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.statistics.estimates import Figure
from experiments.statistics.formulas import FORMULAS, FormulaScore, compare_formulas, second_thread_gain
from experiments.statistics.from_records import HomogeneousCell
from experiments.statistics.judged import JudgedCell
from experiments.statistics.permutations import within_sequences
from experiments.statistics.verdicts import Verdict
from experiments.statistics.world_intervals import Interval, difference_interval


@dataclass(frozen=True)
class WithinSequences:
    """The test within sequences, pooled over cells of the same worlds.

    Attributes:
        n: number of threads.
        cells, telling: numbers of cells, and of sequences in which B and a thread's failure both vary.
        ratio: Q over its mean over the permutations.
        p: two-sided; None with too few telling sequences: the outcome of a sequence is determined.
    """

    n: int
    cells: int
    telling: int
    ratio: float | None
    p: float | None


@dataclass(frozen=True)
class Formulas:
    """Formulas scored on worlds that they have not seen, over cells of the same worlds.

    Attributes:
        n: number of threads.
        cells: (name, kind of world) of each, in the order of the calibrations.
        worlds: their number.
        on_dual_failures, on_units: scores on D and on Q; none of a formula that no cell could be fitted to.
        second_thread: D of the first thread alone minus D of all n, mean over cells; None for n = 1.
    """

    n: int
    cells: tuple[tuple[str, str], ...]
    worlds: int
    on_dual_failures: tuple[FormulaScore, ...]
    on_units: tuple[FormulaScore, ...]
    second_thread: Interval | None


def of_same_worlds(cells: Sequence[HomogeneousCell]) -> list[list[HomogeneousCell]]:
    """Groups of cells with the same seeds of worlds and numbers of sequences and replicates."""
    groups: dict[tuple, list[HomogeneousCell]] = {}
    for cell in cells:
        groups.setdefault((cell.shape, tuple(cell.worlds)), []).append(cell)
    return list(groups.values())


def permuted_within(
    group: list[HomogeneousCell], n: int, rng: np.random.Generator, permutations: int
) -> list[WithinSequences]:
    """Test independence within the sequences of a group; nothing without repeats."""
    if group[0].shape[2] < 2:  # no repeats
        return []
    test = within_sequences([cell.outcomes.of_first(n) for cell in group], rng, permutations)
    ratio = test.statistic / test.expected if test.expected else None
    return [WithinSequences(n, len(group), test.telling or 0, ratio, test.p)]


def score_formulas(group: list[HomogeneousCell], judged: Sequence[JudgedCell], n: int) -> list[Formulas]:
    """Score the formulas on a group; nothing with fewer than 3 worlds that are in all cells, or without D."""
    each = [cell.outcomes.of_first(n) for cell in group]
    complete = np.all([outcomes.has_units for outcomes in each], axis=0)
    if complete.sum() < 3 or not sum(np.nansum(o.dual_failures[-1]) for o in each):
        return []
    each = [outcomes.of_worlds(complete) for outcomes in each]
    of = {(c.cell, c.world): c for c in judged if c.n == n}
    fitted = [
        (c := of[cell.name, cell.world]).verdict_in_units != Verdict.UNTESTED and not c.saturated
        for cell in group
    ]
    # Without a cell to fit them to, the factors are 0 and the formulas Eq. 1.
    told = [name for name in FORMULAS if any(fitted) or name not in ("beta factor", "one factor")]
    scores = (compare_formulas(each, fitted, on_units) for on_units in (False, True))
    on_dual_failures, on_units = (tuple(s for s in of_all if s.name in told) for of_all in scores)
    gain = Figure.mean(np.mean([second_thread_gain(o) for o in each], axis=0)) if n > 1 else None
    return [
        Formulas(
            n=n,
            cells=tuple((cell.name, cell.world) for cell in group),
            worlds=int(complete.sum()),
            on_dual_failures=on_dual_failures,
            on_units=on_units,
            second_thread=difference_interval(gain) if gain else None,
        )
    ]
