"""The fit finds what hypotheses were drawn with, and what it believes is as often so."""

from dataclasses import replace

import numpy as np
import pytest
from belief_scenes import seen

from dslab.experiments.belief.fit import fit, fit_torn
from dslab.experiments.belief.judge import beliefs, judge
from dslab.experiments.belief.logs import Asked
from dslab.slam.belief.model import Parameters, Unseen

TRUE = Parameters(0.8, 0.5, 7.0, 2.5, 0.5, 0.5, 0.2, 1.4, (30.0, 0.5), (2.0, 0.5))
MOTION = Unseen(3.0, 1.0, 0.5)


def drawn(n, seed):
    rng = np.random.default_rng(seed)
    alike = np.append(rng.beta(*TRUE.here, n), rng.beta(*TRUE.alike, n))
    return [Asked(str(i), "join", i >= n, MOTION, (seen(rng, a, TRUE),)) for i, a in enumerate(alike)]


@pytest.mark.slow
def test_parameters_are_found_again_and_with_them_beliefs_are_as_often_right_as_they_say():
    found = fit(drawn(300, 0))
    assert found.rate == pytest.approx(TRUE.rate, abs=0.2)
    assert found.offset == pytest.approx(TRUE.offset, abs=0.4)
    assert found.angle == pytest.approx(TRUE.angle, rel=0.4)
    assert found.farther == pytest.approx(TRUE.farther, abs=0.6)
    assert found.nearer == pytest.approx(TRUE.nearer, abs=0.6)
    assert found.view == pytest.approx(TRUE.view, rel=0.5)
    assert found.surface == pytest.approx(TRUE.surface, rel=0.35)
    others = drawn(300, 1)
    false = np.array([one.false for one in others])
    exact = replace(TRUE, doubles=1 / np.log(2))
    by = [judge(beliefs(others, p), false) for p in (found, exact)]
    assert 0.7 < by[0].slope < 1.4 and by[0].loss < by[1].loss + 0.03


def test_what_loops_tear_is_found_again_and_without_a_loop_nothing_is():
    rng = np.random.default_rng(0)
    given = replace(TRUE, torn_here=(0.7, 30.0), torn_elsewhere=(2.0, 6.0))
    torn = np.append(rng.beta(*given.torn_here, 200), rng.beta(*given.torn_elsewhere, 200))
    asked = [Asked(str(i), "loop", i >= 200, MOTION, (), share) for i, share in enumerate(torn)]
    found = fit_torn(asked, TRUE)
    assert found.torn_here == pytest.approx(given.torn_here, rel=0.3)
    assert found.torn_elsewhere == pytest.approx(given.torn_elsewhere, rel=0.3)
    assert fit_torn([], TRUE).torn_here == pytest.approx(TRUE.torn_here, rel=1e-3)
    false = np.array([one.false for one in asked])
    assert judge(beliefs(asked, found), false).loss < judge(beliefs(asked, TRUE), false).loss
