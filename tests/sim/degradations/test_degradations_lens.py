"""Image-space degradations behind a distorting lens: each acts on the image of its own stage."""

import numpy as np
import pytest
from degradation_worlds import SEVERITIES, segment, small_backend, small_scenario

from sim.degradations.registry import IMAGE_KINDS
from sim.sequence_rendering import render_sequence

LENS = {"model": "radtan", "k1": -0.28, "k2": 0.07}


@pytest.fixture(scope="module")
def backend():
    return small_backend()


def frames(kind, severity, backend, cache_dir):
    scenario = small_scenario("room", segment(kind, **severity))
    camera = scenario.camera.model_copy(update={"distortion": type(scenario.camera.distortion)(**LENS)})
    scenario = scenario.model_copy(update={"camera": camera})
    sequence = render_sequence(scenario, seed=0, cache_dir=cache_dir, backend=backend)
    return np.stack([sequence.frames[i] for i in range(len(sequence))])


@pytest.mark.parametrize("kind", sorted(IMAGE_KINDS))
def test_a_kind_acts_through_a_distorting_lens(kind, backend, tmp_path):
    harmless, *_, fatal = SEVERITIES[kind]
    clean, bad = (frames(kind, severity, backend, tmp_path) for severity in (harmless, fatal))
    assert clean.shape == bad.shape
    assert (clean[:4] == bad[:4]).all()
    assert not (clean[6:10] == bad[6:10]).all()
