"""The probit model of difficulties finds what was drawn, and predicts the failures of its own draws."""

from math import asin, pi

import numpy as np
import pytest

from dslab.experiments.statistics.difficulties import (
    Counts,
    Margin,
    common_correlation,
    correlation_of,
    draw,
    fit_margin,
    log_likelihood,
    predict,
)

MARGINS = (Margin(0.4, 0.8), Margin(0.5, 0.6), Margin(0.2, 0.9))


@pytest.mark.parametrize("correlation", [0.0, 0.7])
@pytest.mark.slow
def test_shares_difficulties_and_their_correlation_are_found(correlation):
    columns = draw(MARGINS, correlation, np.random.default_rng(0), (1500, 1, 3))
    counts = Counts.of(columns)
    for event, margin in enumerate(MARGINS):
        found = fit_margin(counts.only(event))
        assert found.share == pytest.approx(margin.share, abs=0.03)
        assert found.difficulty == pytest.approx(margin.difficulty, abs=0.06)
    found = correlation_of(counts.only(0, 1))
    assert found.low < correlation < found.high < found.low + 0.25
    assert common_correlation([(counts, MARGINS)]) == pytest.approx(correlation, abs=0.06)
    measured = columns.prod(axis=0).mean()
    assert predict(MARGINS, correlation) == pytest.approx(measured, abs=0.02)


def test_without_common_difficulties_the_model_is_eq1_and_with_one_the_normal_orthant():
    assert predict(MARGINS, 0.0) == pytest.approx(0.4 * 0.5 * 0.2, rel=1e-6)
    halves = (Margin(0.5, 0.9), Margin(0.5, 0.9))
    assert predict(halves, 1.0) == pytest.approx(0.25 + asin(0.9) / (2 * pi), abs=1e-4)


def test_difficulties_that_run_against_each_other_have_a_negative_correlation():
    columns = draw(MARGINS[:2], 1.0, np.random.default_rng(1), (300, 1, 3))
    counts = Counts.of(np.stack([columns[0], 1 - columns[1]]))
    found = correlation_of(counts)
    assert found.low >= -1 and found.high < -0.8


def test_the_likelihood_is_the_mean_over_difficulties():
    """Against draws of difficulties, for the counts 3 and 1 of 3 runs."""
    counts = Counts(np.array([[3, 1]]), np.array([3]), np.array([1]))
    rng = np.random.default_rng(2)
    common, own = rng.normal(size=400_000), rng.normal(size=(2, 400_000))
    p = [m.in_runs(np.sqrt(0.6) * common + np.sqrt(0.4) * d) for m, d in zip(MARGINS, own, strict=False)]
    chance = (p[0] ** 3 * 3 * p[1] * (1 - p[1]) ** 2).mean()
    assert np.exp(log_likelihood(counts, MARGINS[:2], 0.6)) == pytest.approx(chance, rel=0.02)


def test_void_runs_and_designs_without_repeats():
    columns = draw(MARGINS[:2], 0.5, np.random.default_rng(3), (300, 1, 3))
    once = Counts.of(columns[..., :1])
    assert fit_margin(once.only(0)).difficulty == 0 and correlation_of(once) is None
    columns[:, :, 0, 1] = np.nan
    counts = Counts.of(columns)
    assert set(counts.runs) == {2} and counts.sequences.sum() == 300
    assert correlation_of(Counts.of(np.stack([columns[0], np.zeros_like(columns[0])]))) is None
