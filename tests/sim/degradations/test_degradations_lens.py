"""Image-space degradations behind a distorting lens: each acts on the image of its own stage."""

import numpy as np
import pytest
from degradation_worlds import SEVERITIES, segment, small_backend, small_scenario

from dslab.sim.degradations.registry import IMAGE_KINDS
from dslab.sim.sequence_rendering import render_sequence

LENS = {"model": "radtan", "k1": -0.28, "k2": 0.07}
# One kind of each stage.
KINDS = list({degradation.stage: kind for kind, degradation in IMAGE_KINDS.items()}.values())


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    cache_dir = tmp_path_factory.mktemp("cache")

    def frames(*segments):
        camera = {**small_scenario("corridor").camera.model_dump(), "distortion": LENS}
        scenario = small_scenario("corridor", *segments, camera=camera)
        sequence = render_sequence(scenario, seed=4, cache_dir=cache_dir, backend=small_backend())
        return np.stack([sequence.frames[i] for i in range(len(sequence))])

    return frames


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_acts_through_a_distorting_lens(kind, frames):
    clean, bad = frames(), frames(segment(kind, **SEVERITIES[kind][-1]))
    assert clean.shape == bad.shape
    assert (clean[:4] == bad[:4]).all()
    assert not (clean[6:10] == bad[6:10]).all()
