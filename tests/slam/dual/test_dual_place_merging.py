"""A saved map whose recovery has failed is fused when its place is recognised, and only then."""

from dataclasses import replace

import numpy as np
import pytest
from dual_scenes import RECOVERED, RECOVERY_ONLY, STEP_M, dual, of, scale_between
from slam_scenes import blanked, errors_m, feed, kinds, rms, toy

from dslab.slam.core.events import TrackingState
from dslab.slam.core.frame import Frame
from dslab.slam.dual.dual_slam import DualSlam
from dslab.slam.dual.fusion import place_merging
from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.dual.fusion.place_merging import PlaceMerger
from dslab.slam.dual.recovery.interface import RecoveryConfig
from dslab.slam.dual.recovery.registry import ThreadSpec
from dslab.slam.loop_closing.place_check import PlaceCheckConfig
from dslab.slam.map.invariants import check_map
from dslab.slam.tracking.probation import ProbationConfig
from dslab.slam.tracking.tracker import TrackingOutcome

# Recovery fails at the first unusable frame: only place recognition is left.
BY_PLACE = replace(
    RECOVERY_ONLY,
    recovery_threads=(ThreadSpec("orb", 0, RecoveryConfig(max_unusable_s=0.0)),),
    place_merging=FusionConfig(),
)


@pytest.fixture(scope="module")
def fused_by_place():
    """The scene of the saved map is still in view after the breakage."""
    images, stamps_s, T_world_cam = toy(130, 0, STEP_M)
    system = dual(replace(BY_PLACE, start_keyframes=50))
    results = feed(system, blanked(images, range(50, 56)), stamps_s)
    return system, results, T_world_cam


def test_a_recognised_map_is_fused_by_place(fused_by_place):
    system, results, _ = fused_by_place
    assert kinds(system) == ["initialized", *RECOVERED[:5], "fusion"], "before a recovery is due"
    (fusion,) = of(system, "fusion")
    assert (fusion.by, fusion.accepted, fusion.reason) == ("place", True, "")
    assert (fusion.map_id, fusion.old_map_id, fusion.new_map_id) == (0, 0, 1)
    assert system.maps() == [0] and system.current_map_id == 0
    assert results[-1].state is TrackingState.TRACKING
    assert all(r.state is TrackingState.TRACKING for r in results[fusion.frame :])


def test_the_fused_map_has_one_scale_and_frame(fused_by_place):
    system, results, T_world_cam = fused_by_place
    (path,) = system.trajectories()
    assert rms(errors_m(path, T_world_cam)[0]) < 0.05
    before, after = (scale_between(path, T_world_cam, *side) for side in ((0, 49), (70, 129)))
    assert before / after == pytest.approx(1, abs=0.05)
    at = dict(zip(path.frames.tolist(), path.T_map_cam, strict=True))
    for r in results[of(system, "fusion")[0].frame :]:
        assert np.linalg.norm(r.T_map_cam[:3, 3] - at[r.frame][:3, 3]) < 0.03


def test_no_keyframe_of_the_saved_map_is_culled_at_the_seam(fused_by_place):
    """No recovery has covered those frames again."""
    system, _, _ = fused_by_place
    frames = system.trajectories()[0].frames.tolist()
    assert set(range(10, 50)) <= set(frames)
    keyframes = system.keyframe_trajectories()[0].frames
    assert ((keyframes > 40) & (keyframes < 50)).any()


def test_another_place_is_not_recognised():
    (here, stamps_s, _), (there, _, _) = toy(120, 0, STEP_M), toy(120, 7, STEP_M)
    system = dual(BY_PLACE)
    feed(system, blanked([*here[:56], *there[56:]], range(50, 56)), stamps_s, check=False)
    assert "fusion" not in kinds(system)
    assert sorted(system.maps()) == [0, 1]


@pytest.mark.slow
def test_what_spoke_against_a_place_counts_at_the_next_keyframe(monkeypatch):
    """Contradicted at two keyframes, the same similarity needs three sound ones before it is believed."""
    said = iter(["contradicted"] * 2)
    found = place_merging.fault_of_alignment
    monkeypatch.setattr(place_merging, "fault_of_alignment", lambda *args: next(said, None) or found(*args))
    images, stamps_s, _ = toy(130, 0, STEP_M)
    system = dual(BY_PLACE)
    feed(system, blanked(images, range(50, 56)), stamps_s)
    reasons = [fusion.reason for fusion in of(system, "fusion")]
    assert reasons == ["contradicted"] * 2 + [""]
    assert of(system, "fusion")[-1].frame > of(system, "fusion")[-2].frame + 5


@pytest.mark.slow
def test_frames_of_a_map_whose_recovery_has_failed_are_sought_in_saved_maps(monkeypatch):
    """Neither before the new map nor by its keyframes is the place found here."""
    nothing = TrackingOutcome(False, 0, 0, "no_candidates")
    monkeypatch.setattr(PlaceMerger, "search", lambda *_: ())
    seek = DualSlam._seek_beside  # also of a frame that was offered before, as when a recovery ends at it
    monkeypatch.setattr(DualSlam, "_seek_beside", lambda *given: [seek(*given) for _ in range(2)])
    monkeypatch.setattr(DualSlam, "_find_back", lambda _, frame, outcome=None: (frame, outcome or nothing))
    images, stamps_s, T_world_cam = toy(130, 2, STEP_M)
    system = dual(replace(BY_PLACE, relocalization=True))
    feed(system, blanked(images, range(50, 56)), stamps_s)
    (ended,), (fusion,) = of(system, "recovery_end"), of(system, "fusion")
    assert not ended.success and ended.frame < fusion.frame
    assert (fusion.by, fusion.accepted, fusion.old_map_id, fusion.new_map_id) == ("place", True, 0, 1)
    (path,) = system.trajectories()
    before, after = (scale_between(path, T_world_cam, *side) for side in ((0, 49), (70, 129)))
    assert before / after == pytest.approx(1, abs=0.05)


def test_a_frame_with_fewer_features_than_its_keyframe_relates_no_maps():
    """As one that was sought in a saved map before the new one was begun from it."""
    images, stamps_s, _ = toy(80, 0, STEP_M)
    system = dual(replace(BY_PLACE, place_merging=None))
    feed(system, blanked(images, range(50, 56)), stamps_s, check=False)
    engine, store = system.engine, system.engine.store
    begun_from = store.current.features(int(store.current.keyframes()[0]))
    engine._image = images[begun_from.index]
    fewer = engine._features(begun_from.index, begun_from.stamp_s, dense=False)
    assert len(fewer) < len(begun_from)
    merger = PlaceMerger(FusionConfig(), PlaceCheckConfig(), 0)
    assert merger.of_frames(store.current, store[store.saved[0]], [Frame(fewer)]) == ()


def test_far_in_time_a_view_may_contradict_a_join_no_more_than_a_frame_a_relocalization():
    assert PlaceCheckConfig().far_bar.max_contradicted == ProbationConfig().far_bar.max_contradicted


def test_place_merging_can_be_switched_off(fused_by_place):
    images, stamps_s, _ = toy(130, 0, STEP_M)
    count = of(fused_by_place[0], "fusion")[0].frame + 3
    system = dual(replace(BY_PLACE, start_keyframes=50, place_merging=None))
    feed(system, blanked(images, range(50, 56))[:count], stamps_s[:count], check=False)
    assert kinds(system) == kinds(fused_by_place[0])[:-1]


@pytest.mark.slow
def test_the_older_map_absorbs_the_newer_when_the_older_is_tracked():
    """Relocalized in the first map while the second is saved, the camera reaches the second's scene."""
    images, _, T_world_cam = toy(130, 0, STEP_M)
    _, stamps_s, _ = toy(150, 0, STEP_M)
    order = [*range(100), *range(45, 95)]
    system = dual(replace(BY_PLACE, place_merging=None, relocalization=True))
    relocalize = system.engine.relocalize
    # Once two maps are saved, only the first is searched.
    system.engine.relocalize = lambda frame, map_ids, *rest: relocalize(frame, map_ids[1:], *rest)
    shown = blanked([images[i] for i in order], range(50, 56), range(97, 100))
    for i, (image, stamp_s) in enumerate(zip(shown, stamps_s, strict=True)):
        if i == 100:  # before, the two maps would have been fused
            place, seed = system.engine.config.place, system.engine.seed
            system.places = PlaceMerger(BY_PLACE.place_merging, place, seed)
        system.process(image, float(stamp_s))
    system.finish()
    check_map(system.current_map)
    (back,) = of(system, "relocalized")
    assert back.map_id == 0
    (fusion,) = of(system, "fusion")
    assert (fusion.by, fusion.map_id, fusion.old_map_id, fusion.new_map_id) == ("place", 0, 0, 1)
    assert system.maps() == [0] and system.current_map_id == 0 and system.engine.store.saved == []
    assert system.state is TrackingState.TRACKING
    (path,) = system.trajectories()
    assert len(path.frames) > 130
    truth = T_world_cam[order]
    assert rms(errors_m(path, truth)[0]) < 0.05
