"""The notation of distributions, and their draws."""

import numpy as np
import pytest
from scipy.stats import kstest

from dslab.scenarios.distributions import (
    KEYS,
    Choice,
    LogUniform,
    NotationError,
    Uniform,
    is_distribution,
    parse_distribution,
)
from dslab.scenarios.kinds import models_in
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.spec import Scenario


def draws(distribution, count: int = 2000) -> np.ndarray:
    """One draw per seed, as a family does."""
    return np.array([distribution.draw(rng_for(seed, "family", "world.length_m")) for seed in range(count)])


def test_uniform_is_uniform():
    drawn = draws(parse_distribution({"uniform": [-2, 6]}))
    assert kstest(drawn, "uniform", args=(-2, 8)).pvalue > 0.001
    assert drawn.min() >= -2 and drawn.max() <= 6


def test_log_uniform_is_uniform_in_the_logarithm():
    drawn = draws(parse_distribution({"log_uniform": [0.05, 0.5]}))
    assert kstest(np.log(drawn), "uniform", args=(np.log(0.05), np.log(10))).pvalue > 0.001
    # Half of it lies below the geometric mean, far from half below the arithmetic one.
    assert np.mean(drawn < np.sqrt(0.05 * 0.5)) == pytest.approx(0.5, abs=0.04)
    assert np.mean(drawn < 0.275) == pytest.approx(np.log(5.5) / np.log(10), abs=0.04)
    assert drawn.min() >= 0.05 and drawn.max() <= 0.5


@pytest.mark.parametrize("distribution", [Uniform(3, 3), LogUniform(0.1, 0.1), LogUniform(1e-300, 1e-300)])
def test_a_range_of_one_number_gives_that_number(distribution):
    assert set(draws(distribution, 20)) == {distribution.low}


def test_a_choice_without_weights_is_even():
    counts = np.bincount(draws(parse_distribution({"choice": ["a", "b", "c", "d"]})), minlength=4)
    assert counts / counts.sum() == pytest.approx([0.25] * 4, abs=0.04)


def test_weights_are_relative_and_zero_is_never():
    drawn = draws(parse_distribution({"choice": ["a", "b", "c", "d"], "weights": [0, 6, 2, 0]}))
    counts = np.bincount(drawn, minlength=4)
    assert counts[0] == counts[3] == 0
    assert counts[1] / counts.sum() == pytest.approx(0.75, abs=0.04)


class _Highest:
    """A generator whose numbers are as near to 1 as they get."""

    def random(self) -> float:
        return np.nextafter(1, 0)


@pytest.mark.parametrize("weights", [(0.1,) * 10, (1.0, 0.0), (1e299, 1e299)])
def test_the_highest_draw_is_still_an_option_with_weight(weights):
    assert weights[Choice(tuple(range(len(weights))), weights).draw(_Highest())] > 0


@pytest.mark.parametrize(
    ("node", "problem"),
    [
        ({"uniform": [2, 1]}, "uniform from 2 to 1 is empty"),
        ({"uniform": [1, 2, 3]}, "has no two numbers"),
        ({"uniform": [True, 2]}, "has no two numbers"),
        ({"uniform": [1, float("nan")]}, "has no two numbers"),
        ({"uniform": [0, 10**400]}, "has no two numbers"),
        ({"log_uniform": [0, 1]}, "has no logarithm"),
        ({"choice": []}, "no options"),
        ({"choice": [1, 2], "weights": [1]}, "1 weights for 2 options"),
        ({"choice": [1, 2], "weights": [1, -1]}, "no list of numbers"),
        ({"choice": [1, 2], "weights": [0, 0]}, "every weight is 0"),
        ({"kind": "room", "choice": [1, 2]}, "kind stands beside choice"),
    ],
)
def test_bad_notation_is_reported(node, problem):
    assert is_distribution(node)
    with pytest.raises(NotationError, match=problem):
        parse_distribution(node)


def test_no_field_of_a_scenario_has_the_name_of_a_distribution():
    seen, waiting = set(), [Scenario]
    while waiting:
        model = waiting.pop()
        seen.add(model)
        assert not {*KEYS, "weights", "members"} & set(model.model_fields)
        waiting += [m for f in model.model_fields.values() for m in models_in(f) if m not in seen]
    assert len(seen) > 20
