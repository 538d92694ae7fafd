"""Compilation of all kernels, by rendering a short scenario with every kind of degradation."""

import numpy as np

from dslab.scenarios.spec import Scenario
from dslab.sim.degradations.registry import DEGRADATIONS
from dslab.sim.sensors.shared_view import seen_share
from dslab.sim.sequence_rendering import render_sequence
from dslab.sim.unfinished import scratch_folder

_SEGMENT_S, _EVERY_S = 0.3, 0.4
_CAMERA = {
    "width_px": 96, "height_px": 72, "fx_px": 68, "fy_px": 68, "cx_px": 47.5, "cy_px": 35.5, "fps": 10,
    "distortion": {"model": "radtan", "k1": -0.05},
}  # fmt: skip


def warm_up() -> None:
    """Compile the kernels and store them in numba's cache.

    Raises:
        InputError: there is no GL.
    """
    rng = np.random.default_rng(0)
    segments = [
        {"kind": kind, "start_s": _EVERY_S * k, "duration_s": _SEGMENT_S, **degradation.sample(rng)}
        for k, (kind, degradation) in enumerate(DEGRADATIONS.items())
    ]
    scenario = Scenario.model_validate(
        {
            "name": "warmup",
            "duration_s": _EVERY_S * len(segments),
            "world": {"kind": "corridor", "length_m": 10, "turns": 0},
            "camera": _CAMERA,
            "segments": segments,
        }
    )
    with scratch_folder() as folder:
        render_sequence(scenario, cache_dir=folder)
    seen_share(
        depth_m := np.ones((2, 2), np.float32), depth_m, np.eye(3), np.zeros(3), np.ones(2), np.ones(2), 0.05
    )
