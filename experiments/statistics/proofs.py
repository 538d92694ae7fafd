"""Proofs of the statistics: simulated experiments with known answers, and how often each method is right."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import inf, prod, sqrt

import numpy as np
import pandas as pd

from dslab.experiments.eq1.records import Outcome
from dslab.experiments.jobs.pool import run_each
from dslab.experiments.statistics import estimates
from dslab.experiments.statistics.boundary_proofs import NOT_REACHED, REACHED, covers, not_reached
from dslab.experiments.statistics.formulas import RIVALS, compare_formulas
from dslab.experiments.statistics.from_records import cells_of
from dslab.experiments.statistics.outcomes import Outcomes, world_means
from dslab.experiments.statistics.permutations import PermutationTest, independence, within_sequences
from dslab.experiments.statistics.simulated import Truth, simulate
from dslab.experiments.statistics.verdicts import LEVEL, Verdict, compare_forecast, compare_units, verdicts
from dslab.experiments.statistics.world_intervals import few_events, ratio_interval, share_interval

_CHUNK = 50  # experiments with one random stream
_PERMUTATIONS = 599  # 2 (1 + 14) / 600 is .05
_KINDS = ("room", "room", "corridor")

Experiment = Callable[[np.random.Generator], float]


@dataclass(frozen=True)
class Claim:
    """What is claimed of the mean of a figure over simulated experiments.

    Attributes:
        name: what the figure is.
        bounds: of its mean.
        experiment: draws an experiment and returns its figure; NaN where it has none.
    """

    name: str
    bounds: tuple[float, float]
    experiment: Experiment


@dataclass(frozen=True)
class Proof:
    """A claim and what was found.

    Attributes:
        name, low, high: of the claim.
        found: mean over the experiments.
        error: its standard error, at least one experiment in all.
        experiments: those that have the figure.
    """

    name: str
    low: float
    high: float
    found: float
    error: float
    experiments: int

    def holds(self, errors: float = 0.0) -> bool:
        """Return True if the mean is within its bounds, widened by some standard errors."""
        return self.low - errors * self.error <= self.found <= self.high + errors * self.error


def prove(experiments: int, seed: int = 0, workers: int = 1, only: str = "") -> Iterator[Proof]:
    """Simulate every claim; the figures do not depend on the number of workers.

    Args:
        experiments: per claim.
        seed: of the draws.
        workers: processes.
        only: text in the names of the claims; all by default.
    """
    chosen = {i: claim for i, claim in enumerate(claims()) if only in claim.name}
    starts = range(0, experiments, _CHUNK)
    chunks = [(i, seed, start, min(_CHUNK, experiments - start)) for i in chosen for start in starts]
    found: dict[int, dict[int, np.ndarray]] = {i: {} for i in chosen}
    for (i, _, start, _), figures in run_each(_chunk, chunks, workers):
        found[i][start] = figures
        while found and len(found[first := next(iter(found))]) == len(starts):
            of_first = found.pop(first)
            yield _proof(chosen[first], np.concatenate([of_first[start] for start in starts]))


def _proof(claim: Claim, figures: np.ndarray) -> Proof:
    known = figures[np.isfinite(figures)]
    # All alike, they tell no more than that the next may be the first of another kind.
    spread = float(known.std(ddof=1)) / sqrt(len(known)) if len(known) > 1 else inf
    error = max(spread, 1 / max(len(known), 1))
    found = float(known.mean()) if len(known) else float("nan")
    return Proof(claim.name, *claim.bounds, found, error, len(known))


@dataclass(frozen=True)
class Cell:
    """A cell to be simulated.

    Attributes:
        truth: what its outcomes depend on.
        worlds, sequences, replicates, void: as of :func:`simulate`.
    """

    truth: Truth
    worlds: int = 60
    sequences: int = 1
    replicates: int = 3
    void: float = 0.0

    def simulate(self, rng: np.random.Generator) -> Outcomes:
        """Outcomes of all worlds."""
        return simulate(self.truth, rng, self.worlds, self.sequences, self.replicates, self.void)

    def draw(self, rng: np.random.Generator) -> Outcomes:
        """Outcomes of the worlds with enough valid replicates."""
        drawn = self.simulate(rng)
        return drawn.of_first(drawn.threads).with_units()

    def __str__(self) -> str:
        shares = ", ".join(f"{share:g}" for share in self.truth.shares)
        sequences = f" of {self.sequences} sequences" if self.sequences > 1 else ""
        arms = f", arms alike in {self.truth.arms:g}" if self.truth.arms < 1 else ""
        void = f", void {self.void:g}" if self.void else ""
        correlation = f"correlation {self.truth.correlation:g} within worlds"
        return f"p0 and pr {shares}, {correlation}, {self.worlds} worlds{sequences}{arms}{void}"


# Eq. 1 is true: shares near half, rare failures, one share near 1, arms that differ and void replicates.
EQ1_TRUE = (
    Cell(Truth((0.5, 0.5))),
    Cell(Truth((0.5, 0.5, 0.5), 0.9)),
    Cell(Truth((0.165, 0.179, 0.168), 0.97), 100),
    Cell(Truth((0.1, 0.1, 0.1), 0.9), 100),
    Cell(Truth((0.11, 0.393, 0.247), 0.5), 100),
    Cell(Truth((0.2, 0.7), 0.3)),
    Cell(Truth((0.7, 0.15), 0.9), 100),
    Cell(Truth((0.3, 0.4), 0.3, arms=0.5), 60, 2, 2, 0.2),
)
RARE_WITH_ONE_CAUSE = Cell(Truth((0.165, 0.179, 0.168), 0.97, 1.0), 100)
CONSISTENT = (Cell(Truth((0.5, 0.7), 0.3, 0.3), 150), Cell(Truth((0.15, 0.05, 0.2), 0.3, 0.3), 150))
"""A share of .3 of the worlds with one cause puts them .3 of the way to the weakest link."""


def claims() -> Iterator[Claim]:
    """Every line that is to be proved."""
    size, exact, rare = (0, 0.06), (0.93, 0.97), (0.90, 1)
    for cell in EQ1_TRUE:
        yield Claim(f"size of independence, {cell}", size, partial(_independence, cell))
        yield Claim(f"size of forecast, {cell}", size, partial(_forecast, cell))
    name = f"forecast finds one cause of all, {RARE_WITH_ONE_CAUSE}"
    yield Claim(name, rare, partial(_forecast, RARE_WITH_ONE_CAUSE))
    for cell in (Cell(Truth((0.5, 0.5))), Cell(Truth((0.5, 0.5), 0.3), 60, 2, 3, 0.2)):
        yield Claim(f"size within sequences, {cell}", size, partial(_within, cell))
    for cell in CONSISTENT:
        yield Claim(f"consistent at k = .3, {cell}", size, partial(_consistent, cell))
    for (share, worlds), correlation in product(((0.3, 100), (0.5, 30), (0.06, 100)), (0.0, 0.9)):
        name = f"coverage of a share of {share:g}, {worlds} worlds, correlation {correlation:g}"
        yield Claim(name, exact, partial(_covers_share, Cell(Truth((share,), correlation), worlds)))
    for common, correlation in product((0.0, 0.5), (0.0, 0.9)):
        what = f"{common:g} of the worlds with one cause, correlation {correlation:g}"
        truth = Truth((0.5, 0.4), correlation, common)
        yield Claim(f"coverage of D over Eq. 1, {what}", exact, partial(_covers_ratio, truth))
    yield Claim(
        "coverage of D over Eq. 1, rare failures", rare, partial(_covers_ratio, Truth((0.15, 0.15), 0.3))
    )
    for threads in (1, 2):
        ratio, name = 0.4**-threads, f"pi_seq over pi_marg where one draw decides all, n = {threads}"
        yield Claim(name, (0.93 * ratio, 1.07 * ratio), partial(_planted_ratio, threads))
    yield Claim("sequences that are decided give no verdict within", (1, 1), _deterministic)
    yield Claim("a mixture of kinds is optimistic within its kinds", (0, 0.05), _mixture)
    yield Claim("a mixture of kinds is optimistic if it is one cell", (0.95, 1), _mixed_cell)
    yield Claim("a stress that acts on half of the sequences is optimistic", (0, 0.05), _half_exposed)
    for what, common, design, bounds in (
        ("Eq. 1 is true", 0.0, (60, 1, 2), (0, 0.05)),
        ("half of the worlds have one cause", 0.5, (100, 1, 3), (0.9, 1)),
    ):
        yield Claim(f"some formula beats Eq. 1 where {what}", bounds, partial(_formula_wins, common, design))
    for planted, level in REACHED:
        what = f"{level:g}, slope {planted.slopes:g}, {planted.sham_rates:g} to {planted.ceilings:g}"
        yield Claim(f"coverage of the boundary of {what}", rare, partial(covers, planted, level))
    for planted, level in NOT_REACHED:
        name = f"boundary of {level:g} is not reached, ceiling {planted.ceilings:g}"
        yield Claim(name, rare, partial(not_reached, planted, level))


def _chunk(chunk: tuple[int, int, int, int]) -> np.ndarray:
    """The figures of some experiments: claim, seed, number of the first of them, how many."""
    claim, seed, start, count = chunk
    rng = np.random.default_rng([seed, claim, start])
    experiment = list(claims())[claim].experiment
    return np.array([experiment(rng) for _ in range(count)])


def _independence(cell: Cell, rng: np.random.Generator) -> float:
    p = independence(cell.draw(rng), rng, _PERMUTATIONS).p
    return float(p is not None and p <= LEVEL)


def _forecast(cell: Cell, rng: np.random.Generator) -> float:
    """Whether Eq. 1 is said to be wrong."""
    (verdict,) = verdicts([], [compare_forecast(cell.draw(rng))])[1]
    return float(verdict in (Verdict.OPTIMISTIC, Verdict.PESSIMISTIC))


def _consistent(cell: Cell, rng: np.random.Generator) -> float:
    """Whether Eq. 1 is said to hold, if no test of independence stands against it."""
    units = compare_units(cell.draw(rng), PermutationTest(0.0, None, 1.0))
    return float(verdicts([units], [])[0] == [Verdict.CONSISTENT])


def _within(cell: Cell, rng: np.random.Generator) -> float:
    """Two cells in one kind of world and one in another."""
    drawn = [_of_kind(kind, cell.simulate(rng)) for kind in _KINDS]
    p = within_sequences(drawn, rng, _PERMUTATIONS).p
    return float("nan") if p is None else float(p <= LEVEL)


def _of_kind(kind: str, outcomes: Outcomes) -> Outcomes:
    return replace(outcomes, worlds=[(kind, seed) for _, seed in outcomes.worlds])


def _covers_share(cell: Cell, rng: np.random.Generator) -> float:
    found = share_interval(world_means(cell.simulate(rng).breakage))
    return float(found.low <= cell.truth.shares[0] <= found.high)


def _covers_ratio(truth: Truth, rng: np.random.Generator) -> float:
    outcomes = simulate(truth, rng, 100, 1, 3)
    measured, product_of_margins = estimates.dual_failure(outcomes), estimates.product_of_margins(outcomes)
    shares = outcomes.margins
    rare = shares if few_events(world_means(outcomes.dual_failures[-1]), shares) else None
    found = ratio_interval(measured, product_of_margins, rare)
    eq1 = prod(truth.shares)
    whole = truth.common * min(truth.shares) + (1 - truth.common) * eq1
    return float("nan") if found is None else float(found.low <= whole / eq1 <= found.high)


def _planted_ratio(threads: int, rng: np.random.Generator) -> float:
    outcomes = simulate(Truth((0.4,) * (1 + threads), 1.0, 1.0), rng, 400, 1, 1 + threads)
    within = estimates.product_in_sequences(outcomes)
    return float("nan") if within is None else within.value / estimates.product_of_margins(outcomes).value


def _deterministic(rng: np.random.Generator) -> float:
    return float(within_sequences([simulate(Truth((0.4, 0.4), 1.0, 1.0), rng, 60, 1, 3)], rng).p is None)


def _mixture(rng: np.random.Generator) -> float:
    kinds = [simulate(Truth((p, p), 0.3), rng, 50, 1, 2) for p in (0.35, 0.65)]
    return float(_any_optimistic(kinds, rng))


def _mixed_cell(rng: np.random.Generator) -> float:
    easy, hard = (simulate(Truth((p, p), 0.3), rng, 100, 1, 2) for p in (0.15, 0.85))
    mixed = Outcomes(
        np.concatenate([easy.breakage, hard.breakage]),
        np.concatenate([easy.thread_failures, hard.thread_failures], axis=1),
        np.concatenate([easy.dual_failures, hard.dual_failures], axis=1),
    )
    return float(_any_optimistic([mixed], rng))


def _half_exposed(rng: np.random.Generator) -> float:
    """In the other half nothing breaks, and the thread, which crosses no stress, fails seldom."""
    acted, spared = (simulate(Truth(p, 0.3), rng, 100, 1, 2) for p in ((0.5, 0.5), (0.0, 0.1)))
    table = pd.concat([_records(acted, True), _records(spared, False)], ignore_index=True)
    return float(_any_optimistic([cell.outcomes.of_first(1) for cell in cells_of(table, 1)], rng))


def _records(outcomes: Outcomes, exposed: bool) -> pd.DataFrame:
    """A cell of one thread as a table of records, whose worlds have seeds of their own."""
    world, sequence, repeat = np.indices(outcomes.breakage.shape).reshape(3, -1)
    events = {"breakage": outcomes.breakage, "cross_r1_failed": outcomes.thread_failures[0]}
    events["d1"] = outcomes.dual_failures[0]
    return pd.DataFrame(
        {
            "cell": "planted",
            "world": "planted",
            "kind": "planted",
            "outcome": Outcome.COMPLETED.value,
            "exposed": exposed,
            "world_seed": 2 * world + exposed,
            "index": np.arange(len(world)),
            "sequence": sequence,
            "repeat": repeat,
            **{name: event.ravel().astype(bool) for name, event in events.items()},
        }
    )


def _any_optimistic(cells: Sequence[Outcomes], rng: np.random.Generator) -> bool:
    units = [compare_units(cell, independence(cell, rng, _PERMUTATIONS)) for cell in cells]
    found = verdicts(units, [compare_forecast(cell) for cell in cells])
    return any(Verdict.OPTIMISTIC in each for each in found)


def _formula_wins(common: float, design: tuple[int, int, int], rng: np.random.Generator) -> float:
    shares = ((0.3, 0.4), (0.5, 0.5), (0.6, 0.3))
    cells = [
        _of_kind(kind, simulate(Truth(each, 0.3, common), rng, *design))
        for kind, each in zip(_KINDS, shares, strict=True)
    ]
    scores, _ = compare_formulas(cells, [True] * len(cells))
    return float(any(s.p is not None and s.p <= LEVEL for s in scores if s.name in RIVALS))
