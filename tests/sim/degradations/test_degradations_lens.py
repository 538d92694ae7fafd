"""Image-space degradations behind a distorting lens: each acts on the image of its own stage."""

import numpy as np
import pytest
from degradation_worlds import SEVERITIES, segment, small_scenario, small_studio

from sim.degradations.registry import IMAGE_KINDS
from sim.sequence_rendering import render_sequence

LENS = {"model": "radtan", "k1": -0.28, "k2": 0.07}


@pytest.fixture(scope="module")
def studio():
    return small_studio()


def frames(kind, severity, studio, cache_dir):
    scenario = small_scenario("room", segment(kind, **severity))
    camera = scenario.camera.model_copy(update={"distortion": type(scenario.camera.distortion)(**LENS)})
    scenario = scenario.model_copy(update={"camera": camera})
    sequence = render_sequence(scenario, seed=0, cache_dir=cache_dir, studio=studio)
    return np.stack([sequence.frames[i] for i in range(len(sequence))])


@pytest.mark.parametrize("kind", sorted(IMAGE_KINDS))
def test_a_kind_acts_through_a_distorting_lens(kind, studio, tmp_path):
    harmless, *_, fatal = SEVERITIES[kind]
    clean, bad = (frames(kind, severity, studio, tmp_path) for severity in (harmless, fatal))
    assert clean.shape == bad.shape
    assert (clean[:4] == bad[:4]).all()
    assert not (clean[6:10] == bad[6:10]).all()
