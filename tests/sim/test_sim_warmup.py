"""The table of kernels holds all that the simulator runs, so that no rendering compiles."""

import numpy as np
import pytest
from compiled_kernels import compiled

from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.registry import DEGRADATIONS
from dslab.sim.sensors.shared_view import seen_share
from dslab.sim.sequence_rendering import render_sequence
from dslab.slam.warmup import read_kernels

SEGMENT_S, EVERY_S = 0.3, 0.4
CAMERA = {
    "width_px": 96, "height_px": 72, "fx_px": 68, "fy_px": 68, "cx_px": 47.5, "cy_px": 35.5, "fps": 10,
}  # fmt: skip
LENSES = (
    {"model": "radtan", "k1": -0.05},
    {"model": "equidistant", "k1": -0.05},
)


@pytest.mark.slow
def test_every_degradation_and_lens_is_rendered_without_compiling(tmp_path):
    kernels = read_kernels("dslab.sim")
    for kernel in kernels:
        kernel.compile()
    before = [len(kernel.function.signatures) for kernel in kernels]
    rng = np.random.default_rng(0)
    segments = [
        {"kind": kind, "start_s": EVERY_S * k, "duration_s": SEGMENT_S, **degradation.sample(rng)}
        for k, (kind, degradation) in enumerate(DEGRADATIONS.items())
    ]
    with compiled() as lines:
        for lens, acting in zip(LENSES, (segments, []), strict=True):
            spec = {
                "name": "every",
                "duration_s": EVERY_S * max(len(acting), 1),
                "world": {"kind": "corridor", "length_m": 10, "turns": 0},
                "camera": {**CAMERA, "distortion": lens},
                "segments": acting,
            }
            render_sequence(Scenario.model_validate(spec), cache_dir=tmp_path)
        ones = np.ones((2, 2), np.float32)
        seen_share(ones, ones, np.eye(3), np.zeros(3), np.ones(2), np.ones(2), 0.05)
    assert lines == [], "lines that sim/kernels.txt lacks"
    assert [len(kernel.function.signatures) for kernel in kernels] == before
