"""Breakages at every moment: defined, one map in the end where it can be, never a crash."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from dual_scenes import (
    MENDED,
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

from slam.core.events import TrackingState
from slam.dual.config import DualConfig
from slam.dual.recovery.interface import RecoveryConfig, RecoveryCost
from slam.dual.recovery.orb import OrbRecovery
from slam.map.invariants import check_map
from slam.warmup import CAMERA

FPS = CAMERA.fps


@dataclass(frozen=True)
class Takes(RecoveryCost):
    """The cost of a thread that is said to take the same time whatever it does."""

    seconds_in_all: float = 0.0

    def seconds(self, result):
        return self.seconds_in_all


class Lasting(OrbRecovery):
    """The recovery thread, said to take so many frames of time."""

    def __init__(self, frames):
        super().__init__(RecoveryConfig())
        self.cost = Takes(0.0, 0.0, 0.0, (frames - 0.5) / FPS)


def drive(system, count, blank):
    """Feed a toy sequence; ``blank(i)`` tells whether frame ``i`` shows nothing."""
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
    """Whether frame ``i`` is so many frames after the first recovery has started."""

    def blank(i):
        starts = of(system, "recovery_start")
        return 50 <= i < 56 or (bool(starts) and first <= i - starts[0].frame < last)

    return blank


def one_scale(system, T_world_cam, *parts):
    (path,) = system.trajectories()
    scales = [scale_between(path, T_world_cam, *part) for part in parts]
    return max(scales) / min(scales) < 1.05 and rms(errors_m(path, T_world_cam)[0]) < 0.06


# -- a recovery that takes its time --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def delayed():
    """A recovery of some 40 frames over each of which 40 ms are said to be spent."""
    images, stamps_s, T_world_cam = toy(150, 0, STEP_M)
    system = with_own_threads([Slow(0.04)])
    return system, feed(system, blanked(images, range(50, 56)), stamps_s, check=False), T_world_cam, stamps_s


def test_the_fusion_is_applied_when_the_cost_model_says(delayed):
    system, _, _, stamps_s = delayed
    assert kinds(system) == ["initialized", *MENDED]
    start, end, fusion = (of(system, kind)[0] for kind in ("recovery_start", "recovery_end", "fusion"))
    ready_s = start.stamp_s + 0.04 * end.frames_covered
    assert fusion.frame == end.frame == int(np.searchsorted(stamps_s, ready_s - 1e-9))
    assert fusion.frame - start.frame > 10


def test_the_path_is_complete_and_of_one_scale(delayed):
    system, _, T_world_cam, _ = delayed
    (path,) = system.trajectories()
    first = int(path.frames[0])
    assert first < 5
    assert path.frames.tolist() == [i for i in range(first, 150) if not 50 <= i < 56]
    assert one_scale(system, T_world_cam, (0, 49), (56, 100), (100, 149))
    steps = np.linalg.norm(np.diff(path.T_map_cam[:, :3, 3], axis=0), axis=1) / np.diff(path.frames)
    assert steps.max() < 2.5 * np.median(steps)


def test_tracking_goes_on_meanwhile_in_the_new_map_and_then_in_the_old(delayed):
    system, results, _, _ = delayed
    start, fused = of(system, "recovery_start")[0].frame, of(system, "fusion")[0].frame
    assert all(r.state is TrackingState.TRACKING for r in results[start:])
    assert {r.map_id for r in results[start:fused]} == {1} and {r.map_id for r in results[fused:]} == {0}
    (path,) = system.trajectories()
    at = dict(zip(path.frames.tolist(), path.T_map_cam, strict=True))
    for r in results[fused:]:
        assert np.linalg.norm(r.T_map_cam[:3, 3] - at[r.frame][:3, 3]) < 0.02


def test_a_snapshot_during_a_recovery_goes_on_as_the_original(delayed):
    """And the same input gives the same bits."""
    images, stamps_s, _ = toy(150, 0, STEP_M)
    images = blanked(images, range(50, 56))
    system = with_own_threads([Slow(0.04)])
    now = of(delayed[0], "recovery_start")[0].frame + 5
    feed_on(system, images[:now], stamps_s[:now])
    branch = system.snapshot().restore()
    for one in (system, branch):
        assert kinds(one)[-1] == "recovery_start"
        feed(one, images[now:], stamps_s[now:], check=False)
        assert fingerprint(one) == fingerprint(delayed[0])


def feed_on(system, images, stamps_s):
    for image, stamp_s in zip(images, stamps_s, strict=True):
        system.process(image, float(stamp_s))


@pytest.mark.parametrize("lost", [False, True])
def test_the_end_of_input_waits_for_a_recovery_under_way(lost):
    """It is applied though its time has not come, whether the new map is still tracked in or saved."""
    images, stamps_s, _ = toy(110, 0, STEP_M)
    system = with_own_threads([Lasting(1000)])
    feed_on(system, blanked(images, range(50, 56), range(110 - 4 * lost, 110)), stamps_s)
    assert of(system, "recovery_start") and not of(system, "recovery_end")
    system.finish()
    assert kinds(system)[-2:] == ["recovery_end", "fusion"]
    assert of(system, "fusion")[0].frame == 109
    assert system.maps() == [0]
    check_map(system.map(0))
    frames = system.trajectories()[0].frames
    assert frames[0] < 5 and frames[-1] == (105 if lost else 109)


# -- breakages during a recovery -----------------------------------------------------------------------------


def test_a_new_map_that_breaks_during_its_recovery_is_saved_and_fused_all_the_same():
    system = with_own_threads([Lasting(24)])
    _, T_world_cam = drive(system, 175, after_start(system, 12, 18))
    story = kinds(system)
    assert story[:7] == ["initialized", *MENDED[:6]]
    assert story[7:10] == ["breakage", "map_saved", "reinit_start"]
    fused = of(system, "fusion")
    assert [(e.old_map_id, e.new_map_id, e.by) for e in fused] == [(0, 1, "recovery"), (0, 2, "recovery")]
    start, broken = of(system, "recovery_start")[0].frame, of(system, "breakage")[1].frame
    assert broken == start + 12 and fused[0].frame == start + 24
    second = of(system, "recovery_start")[1]
    assert (second.map_id, second.old_map_id) == (2, 0) and second.frame >= fused[0].frame
    assert system.maps() == [0] and system.current_map_id == 0
    assert one_scale(system, T_world_cam, (0, 49), (56, broken - 1), (broken + 30, 174))
    # Only what was blank has no pose.
    assert len(system.trajectories()[0].frames) >= 175 - 12 - 5


@pytest.mark.slow
def test_a_break_in_the_very_frame_of_the_fusion():
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
def test_a_third_map_that_waits_for_its_turn_and_breaks_is_dropped():
    """Young, its frames are in the buffer: the fourth map's recovery goes over them too."""
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
def test_a_map_that_breaks_while_its_recovery_waits_is_saved_and_gets_its_turn():
    """Its link to the maps before it is not lost with the breakage, nor is what it has tracked."""
    thread = Lasting(60)
    system = with_own_threads([thread], start_keyframes=3)
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
    assert of(system, "recovery_start")[1].frame == fused[0].frame
    assert system.maps() == [0] and not system.buffer.frozen
    assert rms(errors_m(system.trajectories()[0], T_world_cam)[0]) < 0.06
    assert len(system.trajectories()[0].frames) >= 190 - 18 - 6


# -- any number, anywhere ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("config", [RECOVERY_ONLY, DualConfig()], ids=["recovery only", "all"])
def test_breakages_in_a_row_end_in_sound_maps(config):
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


def test_blank_from_the_first_frame_and_to_the_end():
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


class Held(OrbRecovery):
    """A thread that gives up at the first unusable frame."""

    name = "held"

    def __init__(self):
        super().__init__(RecoveryConfig(max_unusable_s=0.0))


@pytest.fixture(scope="module")
def both_ways():
    """The same four threads, run to the first success and all of them."""
    threads = [Held(), *(OrbRecovery(RecoveryConfig()) for _ in range(3))]
    spans = [range(50, 56)]
    runs = {}
    for exhaustive in (False, True):
        images, stamps_s, _ = toy(110, 0, STEP_M)
        runs[exhaustive] = with_own_threads(threads, seeds=(0, 1, 2, 3), exhaustive=exhaustive)
        feed(runs[exhaustive], blanked(images, *spans), stamps_s, check=False)
    return runs[False], runs[True]


def outcome(event):
    return {k: v for k, v in event.record().items() if k not in ("cpu_ms", "frame", "stamp_s")}


def test_exhaustive_runs_all_threads_and_first_success_stops(both_ways):
    product, laboratory = both_ways
    assert [(e.thread, e.success) for e in of(product, "recovery_end")] == [(1, False), (2, True)]
    ends = [(e.thread, e.success) for e in of(laboratory, "recovery_end")]
    assert ends == [(1, False), (2, True), (3, True), (4, True)]
    for system in both_ways:
        assert [e.thread for e in of(system, "recovery_start")] == [
            e.thread for e in of(system, "recovery_end")
        ]
        assert len({e.buffered_frames for e in of(system, "recovery_start")}) == 1
        assert len(of(system, "fusion")) == 1, "only the first success counts"


def test_up_to_the_first_success_they_are_one(both_ways):
    product, laboratory = both_ways
    for one, other in zip(of(product, "recovery_end"), of(laboratory, "recovery_end"), strict=False):
        assert outcome(one) == outcome(other)
    paths = [system.trajectories() for system in both_ways]
    assert len(paths[0]) == len(paths[1]) == 1
    assert paths[0][0].T_map_cam.tobytes() == paths[1][0].T_map_cam.tobytes()
    assert paths[0][0].frames.tobytes() == paths[1][0].frames.tobytes()


def test_without_any_thread_maps_are_saved_and_nothing_else():
    system = with_threads(90, [range(50, 56)], [])
    assert kinds(system) == ["initialized", *MENDED[:5]]
    assert sorted(system.maps()) == [0, 1]
    assert not system.buffer.frozen


# -- laboratory ----------------------------------------------------------------------------------------------


def test_a_cut_makes_recovery_cross_all_that_is_held():
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
    assert kinds(system) == ["initialized", "map_cut", "map_saved", *MENDED[2:]]
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
