"""Stage timers: the stages sum up to the time of a frame."""

import time

import numpy as np
import pytest
from slam_scenes import toy

from dslab.slam.core.timing import OTHER, StageTimer
from dslab.slam.factory import build_system
from dslab.slam.toy_sequence import CAMERA


def busy(cpu_s):
    end = time.thread_time() + cpu_s
    while time.thread_time() < end:
        pass


def test_time_outside_all_stages_is_other():
    timer = StageTimer()
    timer.begin()
    with timer("a"):
        busy(0.02)
    busy(0.01)
    with timer("a"):
        busy(0.02)
    with timer.apart():
        busy(0.05)
    ms, cpu_ms = timer.read()
    assert set(ms) == set(cpu_ms) == {"a", OTHER}
    assert cpu_ms["a"] == pytest.approx(40, abs=2)
    assert cpu_ms[OTHER] == pytest.approx(10, abs=2)
    assert ms["a"] >= cpu_ms["a"] - 0.5


def test_waiting_is_wall_time_only():
    timer = StageTimer()
    timer.begin()
    time.sleep(0.02)
    ms, cpu_ms = timer.read()
    assert ms[OTHER] >= 20 and cpu_ms[OTHER] < 5


def test_each_frame_starts_from_zero():
    timer = StageTimer()
    timer.begin()
    with timer.apart():
        busy(0.01)
    with pytest.raises(KeyError), timer("a"):
        raise KeyError
    timer.begin()  # the frame before was given up half way
    busy(0.01)
    _, cpu_ms = timer.read()
    assert set(cpu_ms) == {OTHER} and cpu_ms[OTHER] == pytest.approx(10, abs=2)


def test_a_timer_without_a_frame_reports_its_stages_only():
    timer = StageTimer()
    with timer("a"):
        busy(0.001)
    assert set(timer.read()[1]) == {"a"}
    assert timer.read() == ({}, {})


def test_stages_mapping_and_loop_closing_sum_up_to_a_frame():
    images, stamps_s, _ = toy(60, step_m=0.05)
    for count in (30, 60):  # the first run loads kernels outside of all stages
        system = build_system("base", CAMERA, 0)
        whole_ms, reported_ms, other_ms = [], [], []
        for image, stamp_s in zip(images[:count], stamps_s, strict=False):
            start = time.thread_time()
            result = system.process(image, float(stamp_s))
            whole_ms.append(1e3 * (time.thread_time() - start))
            reported_ms.append(sum(result.cpu_ms.values()) + result.mapping_cpu_ms + result.loop_cpu_ms)
            other_ms.append(result.cpu_ms[OTHER])
    # Handing a keyframe over belongs to no stage.
    assert sum(reported_ms) == pytest.approx(sum(whole_ms), rel=0.05)
    assert np.median(reported_ms) == pytest.approx(np.median(whole_ms), rel=0.05)
    assert 0.0 < np.median(other_ms) < 0.5 * np.median(whole_ms)
