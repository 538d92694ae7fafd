"""What transfers between conditions: formulas with parameters of other conditions or kinds of stress."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from dslab.experiments.statistics.difficulties import Counts, Margin, common_correlation, fit_margin, predict
from dslab.experiments.statistics.estimates import Figure, mean_over_cells, measured_in_units
from dslab.experiments.statistics.formulas import (
    beta_factor,
    eq1,
    fit_factors,
    fit_parameter,
    one_factor,
    weakest_link,
)
from dslab.experiments.statistics.outcomes import Floats, Outcomes, world_means
from dslab.experiments.statistics.world_intervals import Interval, difference_interval, student

TRANSFERRED = ("Eq. 1", "weakest link", "beta factor", "one factor", "correlated difficulties")


@dataclass(frozen=True)
class Condition:
    """Outcomes of a cell with n threads, in the worlds that have units.

    Attributes:
        outcomes: see there.
        group: that is left out as a whole when the cell is predicted.
        fitted: whether parameters may be fitted to it, for other groups.
    """

    outcomes: Outcomes
    group: str
    fitted: bool


@dataclass(frozen=True)
class TransferScore:
    """How well a formula predicts D of conditions that its parameters were not fitted to.

    Attributes:
        name: of the formula.
        parameters: of each cell, from the other groups; None for a formula without one.
        errors: (cells,) mean prediction minus mean D.
        loss: mean over cells and their worlds of -[y log f + (1 - y) log(1 - f)]; less is better.
    """

    name: str
    parameters: tuple[float, ...] | None
    errors: tuple[float, ...]
    loss: Figure

    def gain_over(self, other: "TransferScore") -> Interval:
        """How much less the loss is than another formula's."""
        return difference_interval(other.loss - self.loss)


def transfer(conditions: Sequence[Condition]) -> list[TransferScore]:
    """Predict D of every condition from its other worlds' shares and the other groups' parameters.

    The correlated difficulties take from the condition's other worlds besides how much of each event is the
    sequence's difficulty, which repeats tell; from the other groups one correlation of all difficulties.
    """
    margins = [_margins(c.outcomes) for c in conditions]
    each = list(zip(conditions, margins, strict=True))
    parameters = [
        _parameters([of for of in each if of[0].fitted and of[0].group != c.group]) for c in conditions
    ]
    losses, errors = [], []
    for condition, (beta, r, correlation) in zip(conditions, parameters, strict=True):
        f = _without_each_world(condition.outcomes, beta, r, correlation)
        y = world_means(condition.outcomes.dual_failures[-1])
        errors.append((f - y).mean(axis=1))
        f = np.clip(f, 0.5 / len(y), 1 - 0.5 / len(y))
        losses.append(-(y * np.log(f) + (1 - y) * np.log(1 - f)))
    return [
        TransferScore(
            name,
            tuple(p[i - 2] for p in parameters) if i > 1 else None,
            tuple(float(e[i]) for e in errors),
            mean_over_cells([loss[i] for loss in losses], [c.outcomes.worlds for c in conditions]),
        )
        for i, name in enumerate(TRANSFERRED)
    ]


def beta_of(outcomes: Outcomes) -> Interval | None:
    """Fit the beta factor's beta to the Q of one cell, with those that its worlds do not contradict.

    None where Eq. 1 and the weakest link are the same. An end is 0 or 1 where the data set no limit.

    Source: test inversion by pseudo-values, as Fieller 1940 for ratios.
    """
    means, measured = world_means(outcomes.columns), measured_in_units(outcomes)
    p, worlds = means.mean(axis=1), measured.worlds
    if weakest_link(p) - eq1(p) < 1e-9:
        return None
    without = (means.sum(axis=1, keepdims=True) - means).T / (worlds - 1)

    def agrees(beta: float) -> bool:
        off = measured - Figure(float(beta_factor(p, beta)), beta_factor(without, beta))
        return abs(off.t) <= student(worlds - 1)

    best = fit_parameter(beta_factor, p[None], np.array([measured.value]))
    held = [beta for beta in np.linspace(0, 1, 201) if agrees(beta)]
    return Interval(best, min([best, *held]), max([best, *held]))


def _margins(outcomes: Outcomes) -> tuple[Counts, list[Margin]]:
    counts = Counts.of(outcomes.columns)
    return counts, [fit_margin(counts.only(e)) for e in range(1 + outcomes.threads)]


def _parameters(
    others: Sequence[tuple[Condition, tuple[Counts, list[Margin]]]],
) -> tuple[float, float, float]:
    """Parameters of the beta factor, of one factor and of correlated difficulties; 0 without a cell."""
    if not others:
        return 0.0, 0.0, 0.0
    means = [world_means(c.outcomes.columns) for c, _ in others]
    p = np.stack([(m.sum(axis=1) + 0.5) / (m.shape[1] + 1) for m in means])
    measured = np.array([measured_in_units(c.outcomes).value for c, _ in others])
    return *fit_factors(p, measured), common_correlation([of for _, of in others])


def _without_each_world(outcomes: Outcomes, beta: float, r: float, correlation: float) -> Floats:
    """(formulas, W) predictions for each world from the others."""
    means = world_means(outcomes.columns)
    p = ((means.sum(axis=1, keepdims=True) - means + 0.5) / means.shape[1]).T
    simple = [f(p) for f in (eq1, weakest_link, partial(beta_factor, beta=beta), partial(one_factor, r=r))]
    difficulties = np.stack([_difficulties(column) for column in outcomes.columns], axis=1)
    predicted = [
        predict([Margin(*map(float, each)) for each in zip(*margins, strict=True)], correlation)
        for margins in zip(p, difficulties, strict=True)
    ]
    return np.stack([*simple, np.array(predicted)])


def _difficulties(outcome: Floats) -> Floats:
    """(W,) how much of one event, (W, S, K), is the sequence's difficulty, by the others of its worlds."""
    found: dict[bytes, float] = {}
    alike = [np.sort(np.stack([np.nansum(w, axis=1), np.isfinite(w).sum(axis=1)])).tobytes() for w in outcome]
    for world, key in enumerate(alike):
        if key not in found:
            others = np.delete(outcome, world, axis=0)
            found[key] = fit_margin(Counts.of(others[None])).difficulty
    return np.array([found[key] for key in alike])
