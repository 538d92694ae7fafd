"""Recovery beside tracking, in its own thread."""

import threading
import time

import pytest
from dual_scenes import RECOVERED, STEP_M, of, scale_between, with_own_threads
from slam_scenes import blanked, errors_m, kinds, rms, toy

from dslab.slam.core.events import TrackingState
from dslab.slam.dual.recovery.interface import RecoveryConfig
from dslab.slam.dual.recovery.orb import OrbRecovery
from dslab.slam.map.invariants import check_map
from dslab.slam.runtime.backend import ExecutionMode

BLANK = range(50, 56)
PATIENCE_S = 60.0
MAPPING_S = 5.0


class Waiting(OrbRecovery):
    """A recovery thread that waits for a release."""

    def __init__(self):
        super().__init__(RecoveryConfig())
        self.started, self.released = threading.Event(), threading.Event()
        self.on = ""

    def run(self, task):
        self.on = threading.current_thread().name
        self.started.set()
        assert self.released.wait(PATIENCE_S)
        return super().run(task)


class Breaking:
    """A recovery thread that raises an exception."""

    name = "breaking"
    needs_images = False
    cost = OrbRecovery.cost

    def run(self, task):
        raise ZeroDivisionError("in the recovery thread")


def threaded(threads, **config):
    return with_own_threads(threads, ExecutionMode.THREADED, **config)


def feed_in_time(system, first, last, until=None):
    """Feed frames of the toy sequence, waiting for mapping after each; a fusion is taken over by the next."""
    images, stamps_s, _ = toy(150, 0, STEP_M)
    images = blanked(images, BLANK)
    results = []
    for i in range(first, last):
        results.append(system.process(images[i], float(stamps_s[i])))
        give_up_s = time.monotonic() + MAPPING_S
        while not system.engine.backend.idle and time.monotonic() < give_up_s:
            time.sleep(0.002)
        if until is not None and until():
            break
    return results


@pytest.mark.slow
def test_a_slow_recovery_delays_no_frame_and_finish_waits_for_it():
    before = set(threading.enumerate())
    thread = Waiting()
    system = threaded([thread])
    results = feed_in_time(system, 0, 120)
    assert thread.started.is_set() and thread.on == "recovery 1"
    start = of(system, "recovery_start")[0].frame
    assert len(results) - start > 20
    assert all(r.state is TrackingState.TRACKING and r.map_id == 1 for r in results[start:])
    assert of(system, "recovery_end") == []
    thread.released.set()
    system.finish()
    assert set(threading.enumerate()) == before
    assert kinds(system) == ["initialized", *RECOVERED]
    assert system.maps() == [0] and of(system, "fusion")[0].frame == 119
    check_map(system.current_map)
    (path,) = system.trajectories()
    T_world_cam = toy(150, 0, STEP_M)[2]
    assert rms(errors_m(path, T_world_cam)[0]) < 0.06
    before, after = (scale_between(path, T_world_cam, *side) for side in ((0, 49), (56, 119)))
    assert before / after == pytest.approx(1, abs=0.05)


def test_a_threaded_recovery_ends_in_one_fused_tracked_map():
    thread = Waiting()
    thread.released.set()
    system = threaded([thread])
    results = feed_in_time(system, 0, 110)
    give_up_s = time.monotonic() + PATIENCE_S
    while not of(system, "fusion") and time.monotonic() < give_up_s and len(results) < 149:
        time.sleep(0.5)  # 20 s in all: other work on the machine may slow the recovery down
        results += feed_in_time(system, len(results), len(results) + 1)
    fused = of(system, "fusion")[0].frame
    system.finish()
    assert kinds(system) == ["initialized", *RECOVERED]
    assert system.maps() == [0] and system.current_map_id == 0
    assert all(r.state is TrackingState.TRACKING and r.map_id == 0 for r in results[fused:])
    check_map(system.current_map)
    frames = system.trajectories()[0].frames
    assert frames[0] < 5 and frames[-1] == len(results) - 1
    assert len(set(range(frames[0], len(results))) - set(frames.tolist()) - set(BLANK)) < 5
    assert rms(errors_m(system.trajectories()[0], toy(150, 0, STEP_M)[2])[0]) < 0.06


def test_an_exception_in_a_recovery_reaches_the_caller():
    before = set(threading.enumerate())
    system = threaded([Breaking()])
    with pytest.raises(ZeroDivisionError, match="in the recovery thread"):
        feed_in_time(system, 0, 150)
    assert of(system, "recovery_start"), "not before it has started"
    with pytest.raises(ZeroDivisionError, match="in the recovery thread"):
        system.finish()
    assert set(threading.enumerate()) <= before
