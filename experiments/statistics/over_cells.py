"""What is asked of all cells at once: chance within sequences, and formulas.

Cells of one kind of world are paired by their worlds; kinds of world are independent samples, also where
their worlds have the same seeds.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dslab.experiments.statistics.estimates import mean_over_cells
from dslab.experiments.statistics.formulas import FORMULAS, FormulaScore, Unseen, second_thread_gain
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.judged import JudgedCell, usable, worlds_of
from dslab.experiments.statistics.outcomes import Outcomes
from dslab.experiments.statistics.permutations import within_sequences
from dslab.experiments.statistics.verdicts import Verdict
from dslab.experiments.statistics.world_intervals import Interval, difference_interval


@dataclass(frozen=True)
class WithinSequences:
    """The test within sequences, summed over cells.

    Attributes:
        n: number of threads.
        cells, telling: numbers of cells, and of their sequences that enter and in which B and a thread's
            failure both vary.
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
    """Formulas scored on worlds that they have not seen: means over cells, weighted alike.

    Attributes:
        n: number of threads.
        cells: (name, kind of world) of each, in the order of the calibrations.
        worlds: their number, over all kinds.
        on_dual_failures, on_units: scores on D and on Q; none of a formula that no cell could be fitted to.
        second_thread: D of the first thread alone minus D of all n, on the same units; None for n = 1.
    """

    n: int
    cells: tuple[tuple[str, str], ...]
    worlds: int
    on_dual_failures: tuple[FormulaScore, ...]
    on_units: tuple[FormulaScore, ...]
    second_thread: Interval | None


def permuted_within(
    cells: Sequence[HomogeneousCell], n: int, rng: np.random.Generator, permutations: int
) -> list[WithinSequences]:
    """Test independence within the sequences of all cells at once; nothing without repeats."""
    if max((cell.shape[2] for cell in cells), default=1) < 2:  # no repeats
        return []
    kinds = [cell.world for cell in cells]
    placed: list[Outcomes] = []
    for cell in cells:
        own = [other for other in cells if other.world == cell.world]
        seeds = np.unique(np.concatenate([other.worlds for other in own]))
        sequences, repeats = (max(other.shape[axis] for other in own) for axis in (1, 2))
        at = np.searchsorted(seeds, cell.worlds)
        placed.append(cell.outcomes.of_first(n).placed(at, (len(seeds), sequences, repeats)))
    test = within_sequences(placed, rng, permutations, kinds)
    ratio = test.statistic / test.expected if test.expected else None
    return [WithinSequences(n, len(cells), test.telling or 0, ratio, test.p)]


def score_formulas(cells: Sequence[HomogeneousCell], judged: Sequence[JudgedCell], n: int) -> list[Formulas]:
    """Score the formulas on all cells with enough worlds for Eq. 1; nothing without one, or without D."""
    of = {(c.cell, c.world): c for c in judged if c.n == n and c.eq1 is not None}
    told = [cell for cell in cells if (cell.name, cell.world) in of]
    each = [usable(cell, n) for cell in told]
    if not sum(np.nansum(o.dual_failures[-1]) for o in each):
        return []
    worlds = [worlds_of(cell, n) for cell in told]
    fitted = [
        (c := of[cell.name, cell.world]).verdict_in_units != Verdict.UNTESTED and not c.saturated
        for cell in told
    ]
    unseen = Unseen.of(each, fitted, worlds)
    # Without a cell to fit them to, the factors are 0 and the formulas Eq. 1.
    names = [name for name in FORMULAS if any(fitted) or name not in ("beta factor", "one factor")]
    on_dual_failures, on_units = (
        tuple(s for s in unseen.scores(on_units) if s.name in names) for on_units in (False, True)
    )
    gain = mean_over_cells([second_thread_gain(o) for o in each], worlds) if n > 1 else None
    return [
        Formulas(
            n=n,
            cells=tuple((cell.name, cell.world) for cell in told),
            worlds=len({world for own in worlds for world in own}),
            on_dual_failures=on_dual_failures,
            on_units=on_units,
            second_thread=difference_interval(gain) if gain else None,
        )
    ]
