"""The fit finds what hypotheses were drawn with, and what it believes is as often so."""

from dataclasses import replace

import numpy as np
import pytest
from belief_scenes import seen

from dslab.experiments.belief.fit import fit
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
