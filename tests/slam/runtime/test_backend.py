"""Mapping and loop closing beside tracking, in lockstep and in threads."""

import threading
import time

import numpy as np
import pytest
from slam_scenes import blanked, errors_m, feed, kinds, rms, toy

from dslab.slam.core.events import TrackingState
from dslab.slam.factory import build_system
from dslab.slam.loop_closing.correction import Loop
from dslab.slam.loop_closing.map_alignment import Alignment
from dslab.slam.map.adjustment import MapAdjustment
from dslab.slam.map.invariants import check_map
from dslab.slam.runtime.backend import ExecutionMode, MapChange
from dslab.slam.toy_sequence import CAMERA

COUNT, STEP_M = 65, 0.05
THREADED = ExecutionMode.THREADED

STANDING = Alignment(np.eye(4), 1.0, 0, 0, 0, np.zeros(0, np.int32), np.zeros(0, np.int32))


def fed_in_time(system, images, stamps_s, pause_s=0.02):
    """Feed frames with some time between them, as from a camera."""
    results = []
    for image, stamp_s in zip(images, stamps_s, strict=True):
        results.append(system.process(image, float(stamp_s)))
        time.sleep(pause_s)
    system.finish()
    return results


@pytest.fixture(scope="module")
def sequence():
    return toy(COUNT, step_m=STEP_M)


def test_threads_track_and_map_as_lockstep_does(sequence):
    images, stamps_s, T_world_cam = sequence
    before = set(threading.enumerate())
    system = build_system("base", CAMERA, 0, mode=THREADED)
    results = fed_in_time(system, images, stamps_s)
    assert set(threading.enumerate()) == before
    assert kinds(system) == ["initialized"]
    start = system.events[0].frame
    assert all(r.state is TrackingState.TRACKING for r in results[start:])
    check_map(system.current_map)
    assert len(system.current_map.keyframes()) >= 5
    errors, _ = errors_m(system.trajectories()[0], T_world_cam)
    assert rms(errors) < 0.05
    assert sum(r.mapping_cpu_ms for r in results) > 0


class Told(MapChange):
    """A change of nothing that notes what is asked of it."""

    def __init__(self, has_work, is_valid):
        self.has_work, self.is_valid, self.calls = has_work, is_valid, []

    def prepare(self):
        self.calls.append(("prepare", threading.current_thread().name))
        return self.has_work

    def is_still_valid(self):
        return self.is_valid

    def commit(self):
        self.calls.append(("commit", threading.current_thread().name))


@pytest.mark.parametrize(
    ("mode", "beside"), [(ExecutionMode.LOCKSTEP, "MainThread"), (THREADED, "loop closing")]
)
@pytest.mark.parametrize(("has_work", "is_valid"), [(True, True), (True, False), (False, True)])
def test_a_change_is_prepared_beside_tracking_and_committed_there_while_valid(
    mode, beside, has_work, is_valid
):
    system, change = build_system("base", CAMERA, 0, mode=mode), Told(has_work, is_valid)
    system.engine.backend.beside(change)
    system.finish()
    committed = [("commit", "MainThread")] if has_work and is_valid else []
    assert change.calls == [("prepare", beside), *committed]


def test_tracking_does_not_wait_for_mapping(sequence, monkeypatch):
    """With a slow mapper, tracking continues and makes no further keyframes meanwhile."""
    images, stamps_s, _ = sequence
    system = build_system("base", CAMERA, 0, mode=THREADED)
    gate, inside = threading.Event(), threading.Event()
    frames = zip(images, stamps_s, strict=True)
    while system.state is not TrackingState.TRACKING:
        system.process(*next(frames))
    insert = system.mapper.insert

    def slowly(frame):
        inside.set()
        gate.wait(20)
        return insert(frame)

    monkeypatch.setattr(system.mapper, "insert", slowly)
    asked = 0
    for _ in range(12):
        result = system.process(*next(frames))
        assert result.state is TrackingState.TRACKING
        asked += result.is_keyframe
    assert inside.is_set() and asked == 1
    gate.set()
    system.finish()
    check_map(system.current_map)


def test_an_exception_in_a_thread_reaches_the_caller(sequence, monkeypatch):
    images, stamps_s, _ = sequence
    system = build_system("base", CAMERA, 0, mode=THREADED)

    def fail(frame):
        raise ZeroDivisionError("in the mapper")

    def go_on():
        for image, stamp_s in zip(images, stamps_s, strict=True):
            system.process(image, float(stamp_s))
            if system.state is TrackingState.TRACKING:
                monkeypatch.setattr(system.mapper, "insert", fail)
        system.finish()

    with pytest.raises(ZeroDivisionError, match="in the mapper"):
        go_on()


def test_a_breakage_waits_for_mapping_and_leaves_a_valid_map(sequence):
    images, stamps_s, _ = (each[:45] for each in sequence)
    for kind in ("base", "dual"):
        system = build_system(kind, CAMERA, 0, mode=THREADED)
        fed_in_time(system, blanked(images, range(36, 40)), stamps_s, pause_s=0.0)
        assert "breakage" in kinds(system)
        for map_id in system.maps():
            check_map(system.map(map_id))


def test_a_snapshot_needs_lockstep_mode(sequence):
    system = build_system("base", CAMERA, 0, mode=THREADED)
    with pytest.raises(RuntimeError, match="lockstep"):
        system.snapshot()
    system.finish()


# -- a loop --------------------------------------------------------------------------------------------------


class SupposedFake:
    """A loop that is believed until the corrected map is asked."""

    believed = 0.7

    def tear(self, new, share):
        self.believed = 0.0

    def is_believed(self, others):
        return self.believed > 0.5


def drifted(scale, supposed=None):
    """A detector that reports a loop at the keyframe's own place, with lengths off by ``scale``."""

    def detect(self, keyframe, rng):
        if keyframe < 6 or self._last_loop:
            return None, []
        S = self.map.T_cam_map(keyframe).copy()
        centre = np.linalg.inv(S)[:3, 3]
        S[:3, :3] *= scale
        S[:3, 3] = -S[:3, :3] @ centre
        nothing = np.empty(0, np.int32)
        return (Loop(keyframe, 0, S, nothing.astype(int), nothing, supposed), nothing), []

    return detect


@pytest.mark.parametrize("mode", list(ExecutionMode))
@pytest.mark.slow
def test_a_loop_is_corrected_and_tracking_continues(sequence, monkeypatch, mode):
    images, stamps_s, _ = sequence
    monkeypatch.setattr("dslab.slam.loop_closing.detection.LoopDetector.detect", drifted(1.25))
    monkeypatch.setattr(
        "dslab.slam.runtime.backend.adjust_globally", lambda map_, iterations, apart: _unchanged(map_)
    )
    system = build_system("base", CAMERA, 0, mode=mode)
    feeding = fed_in_time if mode is THREADED else feed
    results = feeding(system, images, stamps_s)
    assert kinds(system) == ["initialized", "loop_closed", "map_adjusted"]
    closed = system.events[1]
    assert closed.scale == pytest.approx(0.8) and closed.loop_keyframe == system.current_map.frame_index(0)
    assert all(r.state is TrackingState.TRACKING for r in results[system.events[0].frame :])
    assert sum(r.loop_cpu_ms for r in results) > closed.cpu_ms
    check_map(system.current_map)
    # Steps of frames shrink towards the loop as the lengths around their keyframes do, without jumps.
    path = system.trajectories()[0]
    steps = np.linalg.norm(np.diff(path.T_map_cam[:, :3, 3], axis=0), axis=1) / np.diff(path.frames)
    assert steps.max() < 3 * np.median(steps)


@pytest.mark.parametrize("mode", list(ExecutionMode))
@pytest.mark.slow
def test_a_loop_that_the_corrected_map_contradicts_is_refused(sequence, monkeypatch, mode):
    images, stamps_s, _ = sequence
    plain = build_system("base", CAMERA, 0)
    feed(plain, images, stamps_s)
    detect = drifted(1.25, SupposedFake())
    monkeypatch.setattr("dslab.slam.loop_closing.detection.LoopDetector.detect", detect)
    system = build_system("base", CAMERA, 0, mode=mode)
    (fed_in_time if mode is THREADED else feed)(system, images, stamps_s)
    refused = [e for e in system.events if e.kind == "loop_refused"]
    assert set(kinds(system)) == {"initialized", "loop_refused"}
    assert refused[0].loop_keyframe == system.current_map.frame_index(0)
    # Beside tracking, one of the two keyframes may be culled while the loop is judged.
    reasons = {(e.reason, e.believed) for e in refused} - {("map_has_changed", 0.0), ("map_has_changed", 0.7)}
    assert reasons == {("map_is_torn", 0.0)}
    if mode is ExecutionMode.LOCKSTEP:  # nothing of it is left
        for mine, theirs in zip(system.trajectories(), plain.trajectories(), strict=True):
            assert mine.T_map_cam.tobytes() == theirs.T_map_cam.tobytes()


def _unchanged(map_):
    rows, points = map_.keyframes(), map_.points()
    nothing = np.empty(0, np.int32)
    return MapAdjustment(
        rows,
        map_.arrays.kf_T_cam_map[rows],
        points,
        map_.arrays.pt_xyz[points],
        np.empty((0, 2), int),
        nothing,
    )
