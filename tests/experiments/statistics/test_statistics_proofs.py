"""What `dslab experiment prove` shows in hours, in a minute."""

import pytest

from dslab.experiments.statistics.proofs import prove


@pytest.mark.slow
def test_the_statistics_do_on_known_experiments_what_is_claimed():
    proofs = list(prove(40, seed=1, workers=2))
    assert len(proofs) > 25 and all(proof.experiments > 5 for proof in proofs)
    assert [proof.name for proof in proofs if not proof.holds(errors=3.0)] == []


@pytest.mark.slow
def test_the_forecast_keeps_its_size_where_failures_are_rare_and_finds_a_common_cause():
    proofs = list(prove(200, only="forecast"))
    assert len(proofs) == 9 and [proof.name for proof in proofs if not proof.holds(errors=3.0)] == []


@pytest.mark.slow
def test_proofs_are_the_same_for_any_number_of_workers():
    one, two = (list(prove(60, 0, workers, only="coverage of a share of 0.5")) for workers in (1, 2))
    assert one == two and len(one) == 2 and one[0].experiments == 60
    assert 0.8 < one[0].found <= 1 and not one[0].holds(errors=-100.0)
