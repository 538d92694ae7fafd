"""Power by simulation: the figures of the plan, the least number of worlds, impossible assumptions."""

import pytest

from dslab.experiments.statistics.power import Design, power_of, worlds_needed


@pytest.mark.parametrize(("p", "ratio", "expected"), [(0.2, 2.0, 0.82), (0.5, 1.29, 0.95), (0.8, 1.06, 0.80)])
@pytest.mark.slow
def test_the_power_is_as_planned(p, ratio, expected):
    """With 100 worlds of three replicates, of which the world determines six tenths."""
    found = power_of(p, (p,), ratio, Design(100), experiments=300)
    assert found.independence == pytest.approx(expected, abs=0.06)
    assert found.predicted == pytest.approx(p * p) and found.measured == pytest.approx(ratio * p * p)


@pytest.mark.slow
def test_without_an_effect_the_tests_keep_their_level_and_holm_takes_power():
    assert power_of(0.5, (0.5,), 1.0, Design(60), experiments=300).independence <= 0.09
    one, many = (power_of(0.5, (0.5,), 1.29, Design(60, tests=t), experiments=150) for t in (1, 9))
    assert one.independence > many.independence + 0.1


@pytest.mark.slow
def test_the_worlds_needed_reach_the_power_and_half_of_them_do_not():
    found = worlds_needed(0.4, (0.4,), 1.5, 0.8, Design(0), experiments=150)
    assert found is not None and found.independence >= 0.8
    half = Design(found.design.worlds // 2)
    assert power_of(0.4, (0.4,), 1.5, half, experiments=150).independence < 0.75


@pytest.mark.slow
def test_more_than_can_be_had_is_none_and_the_impossible_is_refused():
    assert worlds_needed(0.05, (0.05,), 1.01, 0.9, Design(0), experiments=4) is None
    for p0, pr, ratio in ((0.0, (0.3,), 2.0), (0.3, (), 2.0), (0.3, (0.3,), 0.9), (0.3, (0.3,), 3.4)):
        with pytest.raises(ValueError, match="must be"):
            power_of(p0, pr, ratio, Design(50), experiments=2)
    with pytest.raises(ValueError, match="power"):
        worlds_needed(0.3, (0.3,), 2.0, 1.0, Design(0))


@pytest.mark.parametrize(("p0", "ratio"), [(1e-9, 2.0), (0.25, 1.0)])
def test_what_no_number_of_worlds_can_show_is_said_at_once(p0, ratio, monkeypatch):
    monkeypatch.setattr(
        "dslab.experiments.statistics.power.independence", lambda *_: pytest.fail("simulated")
    )
    monkeypatch.setattr("dslab.experiments.statistics.power.power_of", lambda *_: None)
    assert worlds_needed(p0, (0.2, 0.2), ratio, 0.8, Design(10)) is None
