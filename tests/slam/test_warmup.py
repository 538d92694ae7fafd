"""The table of kernels holds all that the systems run, so that no run compiles."""

from dataclasses import replace

import pytest
from compiled_kernels import compiled

from dslab.slam.config import default_config
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.registry import parse_threads
from dslab.slam.factory import build_system
from dslab.slam.mapping.self_calibration import SelfCalibrationConfig
from dslab.slam.orbslam import orbslam_config
from dslab.slam.toy_sequence import CAMERA, toy_frames
from dslab.slam.warmup import read_kernels, warm_up

# Dual-SLAM: a saved map, a breakage, a recovery by three threads and a fusion, which relocalization or a
# place found would prevent. The base: a relocalization. Dual-SLAM+: its matcher, up to the first map. DSO: a
# window that keyframes leave. ORB-SLAM as published: a map that grows.
FRAMES = {"dual": 110, "base": 75, "dual+": 10, "ldso": 45, "orbslam": 30}


@pytest.mark.slow
def test_after_the_warmup_every_part_of_the_systems_runs_without_compiling():
    told, kernels = [], read_kernels("dslab.slam")
    warm_up(lambda *progress: told.append(progress))
    assert told[-1][1:] == (len(kernels), len(kernels))
    before = [len(kernel.function.signatures) for kernel in kernels]
    threads = parse_threads("orb,sift,direct")
    every = DualConfig(recovery_threads=threads, exhaustive=True, relocalization=False, place_merging=None)
    config = replace(default_config(CAMERA), self_calibration=SelfCalibrationConfig(at_keyframes=(3,)))
    configs = {"orbslam": orbslam_config(CAMERA)}
    systems = {
        name: build_system(name, CAMERA, seed=0, config=configs.get(name, config), dual=every)
        for name in FRAMES
    }
    with compiled() as lines:
        for kind, system in systems.items():
            for image, stamp_s, _ in toy_frames(FRAMES[kind], range(60, 66), step_m=0.05):
                system.process(image, stamp_s)
            system.finish()
    assert lines == [], "lines that slam/kernels.txt lacks"
    assert [len(kernel.function.signatures) for kernel in kernels] == before
    dual = systems["dual"].events
    ends = [(e.method, e.success) for e in dual if e.kind == "recovery_end"]
    assert ends == [("orb", True), ("sift", True), ("direct", True)]
    assert [e.accepted for e in dual if e.kind == "fusion"] == [True]
    assert "relocalized" in [e.kind for e in systems["base"].events]
    assert "initialized" in [e.kind for e in systems["dual+"].events]
    assert "initialized" in [e.kind for e in systems["ldso"].events]
