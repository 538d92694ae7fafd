"""Experiments drawn on a run's own margins: what its tests can see, and what they say if Eq. 1 is true."""

import numpy as np
import pytest

from dslab.experiments.statistics.difficulties import Margin, draw
from dslab.experiments.statistics.outcomes import Outcomes
from dslab.experiments.statistics.rehearsal import exchange_power, rehearse_words


def outcomes(columns):
    return Outcomes(columns[0], columns[1:], np.cumprod(columns, axis=0)[1:])


def cells(difficulty, worlds=100, number=3, shares=(0.5, 0.5)):
    rng = np.random.default_rng(0)
    margins = [Margin(share, difficulty) for share in shares]
    return [outcomes(draw(margins, 0.5, rng, (worlds, 1, 3))) for _ in range(number)]


@pytest.mark.slow
def test_the_power_within_sequences_grows_with_the_shared_runs_and_is_the_level_without():
    own = cells(0.7)
    rng = np.random.default_rng(1)
    none, half, most = (exchange_power(own, s, rng, 60, 99) for s in (0.0, 0.4, 0.9))
    assert none.power < 0.15 and most.power > 0.9 and none.power < half.power < most.power
    assert none.error == pytest.approx(np.sqrt(none.power * (1 - none.power) / 60))


def test_the_chances_are_those_of_the_sequences():
    """As many sequences vary as in the run; where its sequences are all alike, nearly all do."""
    rng = np.random.default_rng(2)
    hard, alike = (exchange_power(cells(r), 0.0, rng, 20, 19).telling for r in (0.97, 0.01))
    varies = [(c.columns.min(axis=-1) < c.columns.max(axis=-1)).all(axis=0).sum() for c in cells(0.97)]
    assert hard == pytest.approx(sum(varies), abs=10) and alike > 5 * hard


def test_if_eq1_is_true_a_test_says_consistent_only_where_worlds_suffice():
    few, many = cells(0.9, 40, 1, (0.4, 0.4)), cells(0.5, 1500, 1, (0.4, 0.4))
    rare, hopeless = cells(0.9, 60, 1, (0.05, 0.9)), cells(0.5, 300, 1, (0.99, 0.99))
    tests = [(cell, 1) for cell in (*few, *many, *rare, *hopeless)]
    small, large, seldom, always = rehearse_words(tests, np.random.default_rng(3), 12, 39)
    assert small.on_units.get("consistent", 0) <= 0.2 and large.on_units["consistent"] > 0.9
    assert large.on_dual_failures["consistent"] > 0.9
    assert seldom.on_units["untested"] > 0.9 and always.on_units == {"saturated": 1.0}
    assert all(sum(words.on_units.values()) == pytest.approx(1) for words in (small, large, seldom, always))


def test_runs_that_are_left_out_stay_out():
    (own,) = cells(0.7, 60, 1)
    columns = own.columns.copy()
    columns[:, :30] = np.nan
    found = exchange_power([outcomes(columns)], 0.0, np.random.default_rng(4), 5, 19)
    assert found.telling < 20
    (words,) = rehearse_words([(outcomes(columns[:, :39]), 1)], np.random.default_rng(5), 3, 19)
    assert words.on_units == {"untested": 1.0}, "nine worlds are left"


def test_a_sequence_keeps_what_its_own_runs_tell():
    """Both events happen in half of the runs of 60 sequences and in none of 60 others: the same ones vary."""
    rng = np.random.default_rng(6)
    columns = (rng.random((2, 120, 1, 3)) < 0.5 * (np.arange(120) < 60)[:, None, None]).astype(float)
    swapped = np.stack([columns[0], columns[1, ::-1]])
    own, others = (exchange_power([outcomes(x)], 0.0, rng, 20, 19) for x in (columns, swapped))
    assert own.telling > 1.4 * others.telling
