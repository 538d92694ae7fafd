"""What transfers to conditions that no parameter was fitted to, on conditions that share one correlation."""

from dataclasses import replace

import numpy as np
import pytest

from dslab.experiments.statistics.difficulties import Margin, draw
from dslab.experiments.statistics.formulas import beta_factor
from dslab.experiments.statistics.outcomes import Outcomes
from dslab.experiments.statistics.transfer import Condition, beta_of, transfer

CORRELATION = 0.8
SHARES = ((0.5, 0.5, 0.1), (0.3, 0.6, 0.9), (0.4, 0.3, 0.95), (0.6, 0.4, 0.3))
"""Of B and of the thread, and how much of both is difficulty."""


def outcomes(columns):
    return Outcomes(columns[0], columns[1:], np.cumprod(columns, axis=0)[1:])


@pytest.fixture
def conditions():
    rng = np.random.default_rng(0)
    return [
        Condition(
            outcomes(draw((Margin(p0, r), Margin(pr, r)), CORRELATION, rng, (150, 1, 3))),
            group=f"kind {i // 2}",
            fitted=True,
        )
        for i, (p0, pr, r) in enumerate(SHARES)
    ]


def test_one_correlation_of_difficulties_predicts_conditions_whose_beta_differs(conditions):
    scores = {score.name: score for score in transfer(conditions)}
    correlated, beta = scores["correlated difficulties"], scores["beta factor"]
    assert correlated.parameters == pytest.approx([CORRELATION] * 4, abs=0.15)
    assert max(map(abs, correlated.errors)) < 0.04 < max(map(abs, beta.errors))
    assert correlated.gain_over(scores["Eq. 1"]).low > 0 and min(scores["Eq. 1"].errors) < -0.08
    assert correlated.loss.value == min(score.loss.value for score in scores.values())


@pytest.mark.slow
def test_parameters_come_from_the_other_groups_alone(conditions):
    before = transfer(conditions)
    other = draw((Margin(0.5, 0.9), Margin(0.5, 0.9)), 0.0, np.random.default_rng(1), (150, 1, 3))
    changed = transfer([replace(conditions[0], outcomes=outcomes(other)), *conditions[1:]])
    unfitted = transfer([*conditions[:2], *(replace(c, fitted=False) for c in conditions[2:])])
    for one, another, none in zip(before[2:], changed[2:], unfitted[2:], strict=True):
        assert one.parameters[:2] == another.parameters[:2] and one.parameters[2:] != another.parameters[2:]
        assert none.parameters[:2] == (0.0, 0.0), "no cell of another group to fit to: Eq. 1"
        assert none.errors[0] == pytest.approx(unfitted[0].errors[0], abs=1e-6)


def test_a_world_is_predicted_from_the_others(conditions):
    """One of 150 worlds always fails: the weakest link is .5 / 150 for it and 1.5 / 150 for the others."""
    columns = np.zeros((2, 150, 1, 3))
    columns[:, 0] = 1
    lonely = replace(conditions[0], outcomes=outcomes(columns))
    weakest = next(score for score in transfer([lonely, conditions[2]]) if score.name == "weakest link")
    assert weakest.errors[0] == pytest.approx((149 * 1.5 + 0.5) / 150**2 - 1 / 150)


@pytest.mark.slow
def test_the_interval_of_beta_holds_the_truth():
    """A share .4 of the failures of both is common, the rest independent."""
    rng, missed = np.random.default_rng(2), 0
    common, own = 0.4 * 0.3, (0.3 - 0.12) / 0.88
    assert beta_factor(np.array([0.3, 0.3]), 0.4) == pytest.approx(common + (1 - common) * own**2)
    for _ in range(100):
        columns = (rng.random((1, 100, 1, 1)) < common) | (rng.random((2, 100, 1, 1)) < own)
        found = beta_of(outcomes(np.broadcast_to(columns, (2, 100, 1, 3)).astype(float)))
        missed += not found.low <= 0.4 <= found.high
    assert missed <= 11
    assert beta_of(outcomes(np.ones((2, 20, 1, 3)))) is None
