"""Breakages at every moment: defined, one map in the end where it can be, never a crash."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from dual_scenes import (
    RECOVERED,
    RECOVERY_ONLY,
    STEP_M,
    Slow,
    dual,
    of,
    scale_between,
    with_own_threads,
    with_threads,
)  # fmt: skip
from slam_scenes import blanked, errors_m, feed, fingerprint, kinds, rms, toy

from dslab.slam.core.events import TrackingState
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryCost
from dslab.slam.dual.recovery.orb import OrbRecovery
from dslab.slam.map.invariants import check_map
from dslab.slam.toy_sequence import CAMERA

FPS = CAMERA.fps


@dataclass(frozen=True)
class Takes(RecoveryCost):
    """A cost that is the same for every result."""

    seconds_in_all: float = 0.0

    def seconds(self, result):
        return self.seconds_in_all


class Lasting(OrbRecovery):
    """The ORB recovery thread with a declared duration in frames."""

    def __init__(self, frames):
        super().__init__(RecoveryConfig())
        self.cost = Takes(0.0, 0.0, 0.0, seconds_in_all=(frames - 0.5) / FPS)


def drive(system, count, blank):
    """Feed a toy sequence; frame ``i`` is blank if ``blank(i)``."""
    images, stamps_s, T_world_cam = toy(count, 0, STEP_M)
    results = []
    for i in range(count):
        image = np.full_like(images[i], 120) if blank(i) else images[i]
        happened = len(system.events)
        results.append(system.process(image, float(stamps_s[i])))
        for map_id in system.maps() if len(system.events) > happened else ():
            check_map(system.map(map_id))
    system.finish()
    for map_id in system.maps():
        check_map(system.map(map_id))
    return results, T_world_cam


def after_start(system, first, last):
    """Predicate of the frames in a range after the start of the first recovery."""

    def blank(i):
        starts = of(system, "recovery_start")
        return 50 <= i < 56 or (bool(starts) and first <= i - starts[0].frame < last)

    return blank


def one_scale(system, T_world_cam, *parts):
    (path,) = system.trajectories()
    scales = [scale_between(path, T_world_cam, *part) for part in parts]
    return max(scales) / min(scales) < 1.05 and rms(errors_m(path, T_world_cam)[0]) < 0.06


# -- a long recovery -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def delayed():
    """A recovery over some 40 frames with a declared cost of 40 ms each, and a snapshot during it."""
    images, stamps_s, T_world_cam = toy(150, 0, STEP_M)
    images = blanked(images, range(50, 56))
    system = with_own_threads([Slow(0.04)])
    results, snapshot = [], None
    for image, stamp_s in zip(images, stamps_s, strict=True):
        results.append(system.process(image, float(stamp_s)))
        starts = of(system, "recovery_start")
        if starts and len(results) == starts[0].frame + 6:
            snapshot = system.snapshot()
    system.finish()
    return system, results, T_world_cam, stamps_s, snapshot


@pytest.mark.slow
def test_the_fusion_is_applied_at_the_time_of_the_cost_model(delayed):
    system, _, _, stamps_s, _ = delayed
    assert kinds(system) == ["initialized", *RECOVERED]
    start, end, fusion = (of(system, kind)[0] for kind in ("recovery_start", "recovery_end", "fusion"))
    ready_s = start.stamp_s + 0.04 * end.frames_covered
    assert fusion.frame == end.frame == int(np.searchsorted(stamps_s, ready_s - 1e-9))
    assert fusion.frame - start.frame > 10


def test_the_path_is_complete_and_of_one_scale(delayed):
    system, _, T_world_cam, _, _ = delayed
    (path,) = system.trajectories()
    first = int(path.frames[0])
    assert first < 5
    assert path.frames.tolist() == [i for i in range(first, 150) if not 50 <= i < 56]
    assert one_scale(system, T_world_cam, (0, 49), (56, 100), (100, 149))
    steps = np.linalg.norm(np.diff(path.T_map_cam[:, :3, 3], axis=0), axis=1) / np.diff(path.frames)
    assert steps.max() < 2.5 * np.median(steps)


def test_tracking_continues_in_the_new_map_and_then_in_the_old(delayed):
    system, results, _, _, _ = delayed
    start, fused = of(system, "recovery_start")[0].frame, of(system, "fusion")[0].frame
    assert all(r.state is TrackingState.TRACKING for r in results[start:])
    assert {r.map_id for r in results[start:fused]} == {1} and {r.map_id for r in results[fused:]} == {0}
    (path,) = system.trajectories()
    at = dict(zip(path.frames.tolist(), path.T_map_cam, strict=True))
    for r in results[fused:]:
        assert np.linalg.norm(r.T_map_cam[:3, 3] - at[r.frame][:3, 3]) < 0.02


def test_a_snapshot_during_a_recovery_continues_as_the_original(delayed):
    system, _, _, stamps_s, snapshot = delayed
    images, branch, now = toy(150, 0, STEP_M)[0], snapshot.restore(), snapshot.frames
    assert now > 56 and kinds(branch)[-1] == "recovery_start"
    feed(branch, images[now:], stamps_s[now:], check=False)
    assert fingerprint(branch) == fingerprint(system)


def feed_on(system, images, stamps_s):
    for image, stamp_s in zip(images, stamps_s, strict=True):
        system.process(image, float(stamp_s))


def test_the_end_of_input_waits_for_a_running_recovery(delayed):
    """It is applied before its time, whether the new map is tracked or saved."""
    snapshot = delayed[4]
    images, stamps_s, _ = toy(150, 0, STEP_M)
    now = snapshot.frames
    for lost in (False, True):
        system = snapshot.restore()
        shown = blanked(images[: now + 4], range(now, now + 4 * lost))
        feed_on(system, shown[now:], stamps_s[now : now + 4])
        assert of(system, "recovery_start") and not of(system, "recovery_end")
        assert ("map_saved" in kinds(system)[7:]) is lost
        system.finish()
        assert kinds(system)[-2:] == ["recovery_end", "fusion"]
        assert of(system, "fusion")[0].frame == now + 3
        assert system.maps() == [0]
        check_map(system.map(0))
        frames = system.trajectories()[0].frames
        assert frames[0] < 5 and frames[-1] == (now - 1 if lost else now + 3)


# -- breakages during a recovery -----------------------------------------------------------------------------


@pytest.mark.slow
def test_a_new_map_that_breaks_during_its_recovery_is_saved_and_still_fused():
    system = with_own_threads([Lasting(24)])
    _, T_world_cam = drive(system, 175, after_start(system, 12, 18))
    run_events = kinds(system)
    assert run_events[:7] == ["initialized", *RECOVERED[:6]]
    assert run_events[7:10] == ["breakage", "map_saved", "reinit_start"]
    fused = of(system, "fusion")
    assert [(e.old_map_id, e.new_map_id, e.by) for e in fused] == [(0, 1, "recovery"), (0, 2, "recovery")]
    start, broken = of(system, "recovery_start")[0].frame, of(system, "breakage")[1].frame
    assert broken == start + 12 and fused[0].frame == start + 24
    second = of(system, "recovery_start")[1]
    assert (second.map_id, second.old_map_id) == (2, 0) and second.frame >= fused[0].frame
    assert system.maps() == [0] and system.current_map_id == 0
    assert one_scale(system, T_world_cam, (0, 49), (56, broken - 1), (broken + 30, 174))
    # Only blank frames have no pose.
    assert len(system.trajectories()[0].frames) >= 175 - 12 - 5


@pytest.mark.slow
def test_a_breakage_in_the_frame_of_the_fusion():
    system = with_own_threads([Lasting(20)])
    _, T_world_cam = drive(system, 160, after_start(system, 20, 26))
    broken, fused = of(system, "breakage")[1], of(system, "fusion")[0]
    assert broken.frame == fused.frame == of(system, "recovery_start")[0].frame + 20
    at_once = [e.kind for e in system.events if e.frame == broken.frame]
    assert at_once == ["breakage", "map_saved", "reinit_start", "recovery_end", "fusion"]
    second = of(system, "fusion")[1]
    assert (second.old_map_id, second.new_map_id) == (0, 2)
    assert system.maps() == [0]
    assert one_scale(system, T_world_cam, (0, 49), (56, broken.frame - 1), (broken.frame + 30, 159))


@pytest.mark.slow
def test_a_third_map_that_breaks_while_it_waits_is_dropped_if_young():
    """Its frames are in the buffer: the fourth map's recovery goes over them too."""
    system = with_own_threads([Lasting(45)])
    first = after_start(system, 6, 12)

    def blank(i):
        third = [e for e in of(system, "initialized") if e.map_id == 2]
        return first(i) or (bool(third) and 3 <= i - third[0].frame < 6)

    _, T_world_cam = drive(system, 190, blank)
    dropped = of(system, "map_dropped")
    assert [(e.map_id, e.reason) for e in dropped] == [(2, "broke_before_recovery")]
    assert [(e.old_map_id, e.new_map_id) for e in of(system, "fusion")] == [(0, 1), (0, 3)]
    assert system.maps() == [0]
    assert rms(errors_m(system.trajectories()[0], T_world_cam)[0]) < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_map_that_breaks_before_its_recovery_has_ended_is_saved_and_recovered_later(workers):
    """Its frames and its link to earlier maps are kept."""
    thread = Lasting(60)
    system = with_own_threads([thread], start_keyframes=3, workers=workers)
    first = after_start(system, 6, 12)

    def blank(i):
        if of(system, "fusion"):
            thread.cost = Lasting(5).cost
        third = [e for e in of(system, "initialized") if e.map_id == 2]
        return first(i) or (bool(third) and 18 <= i - third[0].frame < 24)

    _, T_world_cam = drive(system, 190, blank)
    saved = [e.map_id for e in of(system, "map_saved")]
    assert saved == [0, 1, 2] and of(system, "map_dropped") == []
    assert [e.map_id for e in of(system, "recovery_start")] == [1, 2, 3]
    fused = of(system, "fusion")
    assert [(e.old_map_id, e.new_map_id) for e in fused] == [(0, 1), (0, 2), (0, 3)]
    assert of(system, "breakage")[2].frame < fused[0].frame
    second = of(system, "recovery_start")[1].frame
    assert second == fused[0].frame if workers == 1 else second < fused[0].frame - 20
    assert system.maps() == [0] and not system.buffer.frozen
    assert rms(errors_m(system.trajectories()[0], T_world_cam)[0]) < 0.06
    assert len(system.trajectories()[0].frames) >= 190 - 18 - 6


# -- breakages anywhere --------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("config", [RECOVERY_ONLY, DualConfig()], ids=["recovery only", "all"])
def test_many_breakages_end_in_valid_maps(config):
    system = dual(replace(config, start_keyframes=3))
    gaps = [range(20, 22), range(32, 33), range(50, 56), range(66, 70), range(90, 93), range(104, 120)]
    results, _ = drive(system, 150, lambda i: any(i in gap for gap in gaps))
    broken = of(system, "breakage")
    assert len(broken) >= 3
    kept = [e.frame for e in (*of(system, "map_saved"), *of(system, "map_dropped"))]
    assert sorted(kept) == [e.frame for e in broken]
    assert results[-1].state is TrackingState.TRACKING
    for path in system.trajectories():
        assert np.isfinite(path.T_map_cam).all() and (np.diff(path.frames) > 0).all()
    if config is RECOVERY_ONLY:
        assert len(of(system, "recovery_start")) == len(of(system, "recovery_end")) > 0


def test_blank_frames_at_the_start_and_at_the_end():
    images, stamps_s, _ = toy(75, 0, STEP_M)
    system = dual(DualConfig())
    results = feed(system, blanked(images, range(20), range(60, 75)), stamps_s)
    assert kinds(system) == ["initialized", "breakage", "map_saved", "reinit_start"]
    assert all(r.T_map_cam is None for r in (*results[:20], *results[60:]))
    assert results[-1].state is TrackingState.NOT_INITIALIZED
    assert system.trajectories()[0].frames[-1] == 59
    nothing = dual(DualConfig())
    feed(nothing, blanked(images[:10], range(10)), stamps_s[:10])
    assert nothing.events == [] and nothing.trajectories() == []
    dual(DualConfig()).finish()


# -- threads -------------------------------------------------------------------------------------------------


class Strict(OrbRecovery):
    """A thread that fails at the first unusable frame."""

    name = "strict"

    def __init__(self):
        super().__init__(RecoveryConfig(max_unusable_s=0.0))


@pytest.fixture(scope="module")
def both_ways():
    """The same three threads, run until the first success and all of them."""
    threads = [Strict(), *(OrbRecovery(RecoveryConfig()) for _ in range(2))]
    images, stamps_s = toy(100, 0, STEP_M)[:2]
    runs = {}
    for exhaustive in (False, True):
        runs[exhaustive] = with_own_threads(threads, seeds=(0, 1, 2), exhaustive=exhaustive)
        feed(runs[exhaustive], blanked(images, range(50, 56)), stamps_s, check=False)
    return runs[False], runs[True]


def outcome(event):
    return {k: v for k, v in event.record().items() if k not in ("cpu_ms", "frame", "stamp_s")}


@pytest.mark.slow
def test_exhaustive_runs_all_threads_otherwise_the_first_success_stops(both_ways):
    product, laboratory = both_ways
    ends = [(e.thread, e.success, e.stage) for e in of(product, "recovery_end")]
    assert ends == [(1, False, "propagation"), (2, True, ""), (3, False, "cancelled")]
    ends = [(e.thread, e.success) for e in of(laboratory, "recovery_end")]
    assert ends == [(1, False), (2, True), (3, True)]
    for system in both_ways:
        assert [e.thread for e in of(system, "recovery_start")] == [
            e.thread for e in of(system, "recovery_end")
        ]
        assert len({e.buffered_frames for e in of(system, "recovery_start")}) == 1
        assert len(of(system, "fusion")) == 1, "only the first success counts"


def test_up_to_the_first_success_both_are_identical(both_ways):
    product, laboratory = both_ways
    ends = zip(of(product, "recovery_end"), of(laboratory, "recovery_end"), strict=True)
    for one, other in list(ends)[:2]:
        assert outcome(one) == outcome(other)
    paths = [system.trajectories() for system in both_ways]
    assert len(paths[0]) == len(paths[1]) == 1
    assert paths[0][0].T_map_cam.tobytes() == paths[1][0].T_map_cam.tobytes()
    assert paths[0][0].frames.tobytes() == paths[1][0].frames.tobytes()


def test_without_threads_maps_are_only_saved():
    system = with_threads(80, [range(50, 56)], [])
    assert kinds(system) == ["initialized", *RECOVERED[:5]]
    assert sorted(system.maps()) == [0, 1]
    assert not system.buffer.frozen


# -- laboratory ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_after_a_cut_recovery_crosses_all_buffered_frames():
    images, stamps_s, T_world_cam = toy(125, 0, STEP_M)
    system = dual()
    with pytest.raises(RuntimeError, match="no healthy map"):
        system.cut()
    feed_on(system, images[:50], stamps_s[:50])
    with pytest.raises(RuntimeError, match="restart without a cut"):
        system.restart()
    system.cut()
    with pytest.raises(RuntimeError, match="no healthy map"):
        system.cut()
    held = [system.process(images[i], float(stamps_s[i])) for i in range(50, 72)]
    assert {(r.state, r.reason) for r in held} == {(TrackingState.NOT_INITIALIZED, "held")}
    system.restart()
    with pytest.raises(RuntimeError, match="restart without a cut"):
        system.restart()
    feed(system, images[72:], stamps_s[72:])
    assert kinds(system) == ["initialized", "map_cut", "map_saved", *RECOVERED[2:]]
    by_kind = {e.kind: e for e in system.events}
    assert (by_kind["map_cut"].frame, by_kind["map_cut"].map_id) == (49, 0)
    assert by_kind["reinit_start"].frame == 71
    done = by_kind["reinit_done"]
    assert done.frames_taken == done.frame - 71
    end = by_kind["recovery_end"]
    assert end.success and end.frames_covered >= 22
    (path,) = system.trajectories()
    assert path.frames.tolist() == list(range(int(path.frames[0]), 125))
    assert one_scale(system, T_world_cam, (0, 49), (72, 124))
