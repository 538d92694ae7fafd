"""A fusion and the start of a recovery are prepared beside tracking and taken over between two frames."""

import threading
import time
from types import SimpleNamespace

import pytest
from dual_scenes import STEP_M, of, with_own_threads
from slam_scenes import blanked, errors_m, feed_until, rms, toy

from dslab.slam.core.events import TrackingState
from dslab.slam.dual.fusion import fuse
from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.dual.fusion.merge_recovered import RecoveredFusion
from dslab.slam.dual.fusion.place_merging import PlaceMerger
from dslab.slam.dual.recovery.interface import RecoveryConfig
from dslab.slam.dual.recovery.orb import OrbRecovery
from dslab.slam.dual.recovery_jobs import RecoveryJobs
from dslab.slam.invariants import check_system
from dslab.slam.runtime.backend import Backend, ExecutionMode
from dslab.slam.tracking.tracker import TrackingOutcome

COUNT, BLANK, PATIENCE_S = 150, range(50, 56), 60.0


class Held:
    """A function that, once called, waits for a release."""

    def __init__(self, real):
        self._real = real
        self.entered, self.released = threading.Event(), threading.Event()

    def __call__(self, *args):
        self.entered.set()
        assert self.released.wait(PATIENCE_S)
        return self._real(*args)


class Threaded:
    """A threaded system over a toy sequence with a breakage, fed frame by frame."""

    def __init__(self, *blank, **config):
        images, self._stamps_s, self.truth = toy(COUNT, 0, STEP_M)
        self._images = blanked(images, BLANK, *blank)
        self.system = with_own_threads([OrbRecovery(RecoveryConfig())], ExecutionMode.THREADED, **config)
        self.results = []

    def feed(self, count):
        """Feed frames, with time for mapping after each unless it is held up."""
        for i in range(len(self.results), len(self.results) + count):
            self.results.append(self.system.process(self._images[i], float(self._stamps_s[i])))
            give_up_s = time.monotonic() + 0.3
            while not self.system.engine.backend.idle and time.monotonic() < give_up_s:
                time.sleep(0.002)
        return self.results[-count:]

    def feed_until(self, happened):
        """Feed frames until something has happened, slowly once a recovery runs: it takes its time."""
        while not happened():
            self.feed(1)
            give_up_s = time.monotonic() + (0.5 if of(self.system, "recovery_start") else 0.0)
            while not happened() and time.monotonic() < give_up_s:
                time.sleep(0.005)

    def waiting(self):
        """Frames that wait to become keyframes."""
        return [t.frame.features.index for t in self.system.engine.backend.in_work if t.keyframe < 0]

    def end(self):
        """Finish, and check the one map that is to be left."""
        self.system.finish()
        check_system(self.system)
        assert self.system.maps() == [0]
        (path,) = self.system.trajectories()
        assert rms(errors_m(path, self.truth)[0]) < 0.06
        return path


@pytest.fixture
def fusing(monkeypatch):
    """Holds up every fusion until it is released."""
    held = Held(fuse.fuse)
    monkeypatch.setattr(fuse, "fuse", held)
    return held


@pytest.mark.slow
def test_tracking_goes_on_while_maps_are_fused_and_nothing_of_it_is_lost(fusing):
    run = Threaded()
    run.feed_until(fusing.entered.is_set)
    began = len(run.results)
    run.feed_until(run.waiting)
    (asked,) = run.waiting()
    assert not any(r.is_keyframe for r in run.feed(10)), "mapping waits for the fusion"
    assert run.waiting() == [asked]
    assert all(r.state is TrackingState.TRACKING and r.map_id == 1 for r in run.results[began:])
    assert of(run.system, "fusion") == []
    fusing.released.set()
    run.feed_until(lambda: of(run.system, "fusion"))
    (fused,) = of(run.system, "fusion")
    run.feed(8)
    assert all(r.state is TrackingState.TRACKING and r.map_id == 0 for r in run.results[fused.frame :])
    path = run.end()
    assert set(range(began, len(run.results))) <= set(path.frames.tolist())
    m = run.system.map(0)
    (row,) = (k for k in range(m.n_keyframes) if m.frame_index(k) == asked)
    assert (m.observed_points(row) >= 0).sum() > 50
    at = dict(zip(path.frames.tolist(), path.T_map_cam, strict=True))
    for r in run.results[fused.frame :]:
        assert abs(r.T_map_cam[:3, 3] - at[r.frame][:3, 3]).max() < 0.03


@pytest.mark.slow
def test_keyframes_mapped_before_a_fusion_are_searched_for_loops_in_the_fused_map(monkeypatch):
    """They have waited behind the fusion for the thread of loop closing."""
    run, released, seen = Threaded(), threading.Event(), []
    real = Backend._close_loop

    def close_loop(self, task, keyframe):
        assert released.wait(PATIENCE_S)
        mine = task.mapper.map
        seen.append((task.detector.map is mine, mine.frame_index(keyframe) == task.frame.features.index))
        return real(self, task, keyframe)

    released.set()
    run.feed_until(lambda: of(run.system, "recovery_start"))
    monkeypatch.setattr(Backend, "_close_loop", close_loop)
    released.clear()
    asked, begin = [], RecoveredFusion.__init__
    monkeypatch.setattr(RecoveredFusion, "__init__", lambda *args: asked.append(begin(*args)))
    run.feed_until(lambda: asked)
    run.feed_until(lambda: len([t for t in run.system.engine.backend.in_work if t.keyframe >= 0]) >= 3)
    released.set()
    run.feed_until(lambda: of(run.system, "fusion"))
    run.end()
    assert len(seen) >= 3 and all(map(all, seen))


@pytest.mark.slow
def test_a_map_that_breaks_during_its_fusion_is_lost_as_the_fused_one(fusing):
    run = Threaded(range(110, COUNT))
    run.feed_until(fusing.entered.is_set)
    assert len(run.results) < 105
    threading.Timer(1.0, fusing.released.set).start()
    run.feed_until(lambda: len(of(run.system, "breakage")) == 2)
    (fused,), broken = of(run.system, "fusion"), of(run.system, "breakage")[1]
    assert broken.map_id == 0 and fused.frame <= broken.frame
    assert run.system.engine.store.saved == [0]
    run.end()


def test_a_map_fused_meanwhile_is_not_dropped_for_a_place_in_a_saved_one(monkeypatch):
    images, stamps_s, _ = toy(60, 0, STEP_M)
    system = with_own_threads([])
    feed_until(system, images, stamps_s, "initialized")
    engine, frame = system.engine, system.engine.newest
    found = SimpleNamespace(believed=None,
        map_id=0, faults=[], frames=[], keyframe=0, first=frame, tracker=engine.tracker,
        reason="", withdraw=lambda reason: setattr(found, "reason", reason), withdrawn=lambda: None,
    )  # fmt: skip
    monkeypatch.setattr(engine.search, "offer", lambda *_: (TrackingOutcome(True, 50, 60), found))
    engine.store.current_id = 1
    monkeypatch.setattr(engine.backend, "drain", lambda: setattr(engine.store, "current_id", 0))
    left = []
    outcome = engine.relocalize(frame, [0], left.append)
    assert not outcome.success and left == [] and found.reason == "maps_are_joined"
    assert system.events[-1].kind == "relocalization_withdrawn"


@pytest.mark.parametrize("place", [False, True])
@pytest.mark.slow
def test_nothing_is_copied_searched_or_fused_on_the_tracking_thread(monkeypatch, place):
    on = {}

    def noting(owner, name):
        real = getattr(owner, name)

        def noted(*args):
            on[name] = threading.current_thread().name
            return real(*args)

        monkeypatch.setattr(owner, name, noted)

    noting(RecoveryJobs, "copies")
    noting(PlaceMerger, "search")
    noting(fuse, "fuse")
    run = Threaded(**({"place_merging": FusionConfig(), "start_keyframes": 50} if place else {}))
    run.feed_until(lambda: of(run.system, "fusion"))
    assert of(run.system, "fusion")[0].by == ("place" if place else "recovery")
    run.end()
    assert on == dict.fromkeys(["search", "fuse"] if place else ["copies", "fuse"], "loop closing")


@pytest.mark.slow
def test_the_time_of_a_take_over_is_a_stage_of_its_frame():
    run = Threaded()
    run.feed_until(lambda: of(run.system, "fusion"))
    (fused,) = of(run.system, "fusion")
    assert [r.frame for r in run.results if "fusion" in r.ms] == [fused.frame]
    run.end()
