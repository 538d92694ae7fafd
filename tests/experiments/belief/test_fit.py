"""The fit finds the parameters that hypotheses were drawn with."""

import numpy as np
import pytest
from belief_scenes import seen

from dslab.experiments.belief.fit import fit
from dslab.experiments.belief.logs import Asked
from dslab.slam.belief.model import Parameters

TRUE = Parameters(0.5, 7.0, 1.5, 0.7, 1.4, 0.4, 0.9, (0.6, 0.25, 0.15))


@pytest.mark.slow
def test_parameters_are_found_again():
    rng = np.random.default_rng(0)
    places = rng.choice([0.0, TRUE.part, TRUE.double], 300, p=TRUE.weights)
    asked = [Asked("", "join", False, (seen(rng, 1.0, TRUE),), ("",)) for _ in range(300)]
    asked += [Asked("", "join", True, (seen(rng, alike, TRUE),), ("",)) for alike in places]
    found = fit(asked)
    assert found.offset == pytest.approx(TRUE.offset, abs=0.4)
    assert found.angle == pytest.approx(TRUE.angle, rel=0.4)
    assert found.zoom == pytest.approx(TRUE.zoom, abs=0.6)
    assert found.view == pytest.approx(TRUE.view, rel=0.35)
    assert found.surface == pytest.approx(TRUE.surface, rel=0.35)
    assert found.part == pytest.approx(TRUE.part, abs=0.2) and found.double > 0.75
    assert found.weights == pytest.approx(TRUE.weights, abs=0.12)
