"""What Eq. 1 predicts and what is measured, each with what it would be without any one world."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, inf, log, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from dslab.experiments.statistics.outcomes import Floats, Outcomes, World, sequence_means, world_means
from dslab.experiments.statistics.products import ROUNDING, product_of_distinct, product_without_each


@dataclass(frozen=True)
class Figure:
    """An estimate from W worlds, the sample.

    Attributes:
        value: the estimate.
        without: (W,) the estimate without each world.
        scale: magnitude of the figures that it is a sum of; its own if left out.
        kinds: (W,) kinds of the worlds, independent samples; None for one.
    """

    value: float
    without: Floats
    scale: float = 0.0
    kinds: NDArray[np.str_] | None = None

    def __post_init__(self) -> None:
        own = max(abs(self.value), float(np.abs(self.without).max(initial=0.0)))
        object.__setattr__(self, "scale", max(self.scale, own))

    @property
    def worlds(self) -> int:
        """Number of worlds."""
        return len(self.without)

    @property
    def pseudo_values(self) -> Floats:
        """(W,) what each world adds: their mean estimates, their spread is the estimate's."""
        return self.worlds * self.value - (self.worlds - 1) * self.without

    @property
    def error(self) -> float:
        """Standard error, by the spread of the pseudo-values; 0 if that is no more than rounding."""
        error = float(self.pseudo_values.std(ddof=1)) / sqrt(self.worlds)
        return error if error > ROUNDING * self.scale else 0.0

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the error.

        Source: Satterthwaite 1946, for several kinds.
        """
        if self.kinds is None or not self.error:
            return self.worlds - 1
        own = [self.pseudo_values[self.kinds == kind] for kind in np.unique(self.kinds)]
        squares = np.array([np.square(values - values.mean()).sum() for values in own])
        return float(squares.sum() ** 2 / np.sum(squares**2 / [max(len(values) - 1, 1) for values in own]))

    @property
    def t(self) -> float:
        """Student's t against 0: 0 if the figure is no more than rounding, else infinite without a spread."""
        if abs(self.value) <= ROUNDING * self.scale:
            return 0.0
        return self.value / self.error if self.error else copysign(inf, self.value)

    @property
    def p(self) -> float:
        """Two-sided p-value of this t."""
        return float(2 * stats.t.sf(abs(self.t), self.freedom))

    def __add__(self, other: "Figure") -> "Figure":
        """Sum over the same worlds."""
        scale = max(self.scale, other.scale)
        return Figure(self.value + other.value, self.without + other.without, scale, self.kinds)

    def __sub__(self, other: "Figure") -> "Figure":
        """Difference over the same worlds."""
        return self + other.times(-1.0)

    def times(self, factor: float) -> "Figure":
        """The figure times a constant."""
        return Figure(factor * self.value, factor * self.without, abs(factor) * self.scale, self.kinds)

    def log(self, least: float = 0.0) -> "Figure":
        """Its logarithm, values below ``least`` taken for that."""
        return Figure(log(max(self.value, least)), np.log(np.maximum(self.without, least)), kinds=self.kinds)

    @classmethod
    def mean(cls, by_world: Floats) -> "Figure":
        """Mean of one value per world, (W,)."""
        worlds, total = len(by_world), by_world.sum()
        without = (total - by_world) / (worlds - 1) if worlds > 1 else np.full(worlds, np.nan)
        return cls(float(total / worlds), without, float(np.abs(by_world).max(initial=0.0)))


def over_cells(figures: Sequence[Figure], worlds: Sequence[Sequence[World]]) -> Figure:
    """Mean of a figure over cells, weighted alike.

    A world is left out of all its cells at once, so that what cells share by their worlds is in the error.
    Worlds of different kinds are different ones, whatever their seeds, and their kinds independent samples.

    Args:
        figures: of each cell, over its own worlds.
        worlds: per cell their kinds and seeds.
    """
    places = {world: i for i, world in enumerate(dict.fromkeys(w for own in worlds for w in own))}
    value, change = float(np.mean([figure.value for figure in figures])), np.zeros(len(places))
    for figure, own in zip(figures, worlds, strict=True):
        if figure.worlds > 1:
            change[[places[world] for world in own]] += (figure.without - figure.value) / len(figures)
    scale = max(figure.scale for figure in figures)
    return Figure(value, value + change, scale, np.array([kind for kind, _ in places]))


def mean_over_cells(by_cell: Sequence[Floats], worlds: Sequence[Sequence[World]]) -> Figure:
    """Mean over cells, weighted alike, of the mean over each cell's (W,) worlds; see :func:`over_cells`."""
    return over_cells([Figure.mean(of_cell) for of_cell in by_cell], worlds)


def share(outcome: Floats) -> Figure:
    """Share of units with an outcome, (W, S, K): equal weight per world, then sequence, then replicate."""
    return Figure.mean(world_means(outcome))


def measured_in_units(outcomes: Outcomes) -> Figure:
    """Q: all factors at once in one unit, from the crossing arm."""
    return share(np.prod(outcomes.columns, axis=0))


def dual_failure(outcomes: Outcomes) -> Figure:
    """D: the system of all threads fails, in the free arm."""
    return share(outcomes.dual_failures[-1])


def product_in_sequences(outcomes: Outcomes) -> Figure | None:
    """pi_seq: product over distinct replicates of a sequence; None with fewer than n + 1 replicates."""
    return _mean_product(product_of_distinct(outcomes.columns))


def product_in_worlds(outcomes: Outcomes) -> Figure | None:
    """pi_world: product over distinct sequences of a world; None with fewer than n + 1 sequences."""
    return _mean_product(product_of_distinct(sequence_means(outcomes.columns))[:, None])


def product_of_margins(outcomes: Outcomes) -> Figure:
    """pi_marg: product over distinct worlds, the marginal reading of Eq. 1."""
    means = world_means(outcomes.columns)
    return Figure(float(product_of_distinct(means)), product_without_each(means))


def _mean_product(by_sequence: Floats) -> Figure | None:
    """Mean over worlds of the mean over sequences of (W, S) products, NaN where there are too few rows."""
    usable = np.isfinite(by_sequence)
    if not usable.any(axis=1).all():
        return None
    return Figure.mean(np.where(usable, by_sequence, 0.0).sum(axis=1) / usable.sum(axis=1))


def chain(outcomes: Outcomes) -> dict[str, tuple[Figure, Figure]]:
    """Numerators and denominators of the steps from what Eq. 1 predicts to what is measured.

    Returns:
        Those that the design can tell: ``world``, pi_world / pi_marg: what a world shares; ``path``, pi_seq /
        pi_world: what a path shares; ``sequence``, pi_seq / pi_marg, in place of these two with one sequence
        per world; ``run``, Q / pi_seq: chance that the threads share within one run; ``arms``, D / Q: how the
        free arm differs from the crossing arm; ``whole``, D / pi_marg.

    Source: Eckhardt & Lee 1985 and Littlewood & Miller 1989 for world, path and run.
    """
    measured, units = dual_failure(outcomes), measured_in_units(outcomes)
    in_sequences, in_worlds = product_in_sequences(outcomes), product_in_worlds(outcomes)
    marginal = product_of_margins(outcomes)
    steps = {
        "world": (in_worlds, marginal),
        "path": (in_sequences, in_worlds),
        "sequence": (None if in_worlds else in_sequences, marginal),
        "run": (units, in_sequences),
        "arms": (measured, units),
        "whole": (measured, marginal),
    }
    return {name: (a, c) for name, (a, c) in steps.items() if a is not None and c is not None}


def correlation_in_sequences(outcome: Floats) -> tuple[Figure, Figure] | None:
    """ICC of an outcome (W, S, K), as numerator and denominator; None without repeats.

    1 - ICC is the share of the outcome's variance that is chance, not the difficulty of the sequence.
    """
    twice = np.stack([outcome, outcome])
    within = _mean_product(product_of_distinct(twice))
    if within is None:
        return None
    means = world_means(outcome)
    pair = np.stack([means, means])
    between = Figure(float(product_of_distinct(pair)), product_without_each(pair))
    p = Figure.mean(means)
    return within - between, Figure(p.value * (1 - p.value), p.without * (1 - p.without))
