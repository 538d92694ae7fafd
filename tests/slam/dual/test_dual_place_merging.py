"""A saved map whose recovery has failed is fused when its place is recognised, and only then."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from dual_scenes import RECOVERED, RECOVERY_ONLY, STEP_M, dual, of, scale_between
from slam_scenes import PointWorld, blanked, errors_m, feed, kinds, rms, toy, tracked_in, walk

from dslab.slam.belief.config import BeliefConfig
from dslab.slam.core.events import TrackingState
from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.dual.fusion.place_merging import PlaceMerger
from dslab.slam.dual.recovery.interface import RecoveryConfig
from dslab.slam.dual.recovery.registry import ThreadSpec
from dslab.slam.loop_closing.map_alignment import Sim3AlignmentConfig, align
from dslab.slam.map.invariants import check_map
from dslab.slam.tracking.relocalization import RelocalizationOutcome

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
            beliefs, seed = system.engine.config.belief, system.engine.seed
            system.places = PlaceMerger(BY_PLACE.place_merging, beliefs, seed)
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


LAX = Sim3AlignmentConfig(min_candidates=20, min_inliers=20, min_share=0.3, min_matches=20)


class FoundByOneView:
    """Place recognition that knows of a keyframe which shares nothing, and places a view nevertheless."""

    def __init__(self, placed):
        self.database = self.relocalizer = self
        self._placed = placed

    def relocalization_candidates(self, bow):
        return [0]

    def relocalize(self, frame, rng, similar):
        assert similar == [0]
        if len(frame.features) != len(self._placed.point):
            return RelocalizationOutcome(False, -1, 0, 0, "too_few_matches")
        frame.point[:], frame.T_cam_map = self._placed.point, self._placed.T_cam_map
        frame.reference_keyframe = self._placed.reference_keyframe
        return RelocalizationOutcome(True, 0, 50, 50)


def test_a_view_finds_a_map_that_none_of_its_keyframes_aligns_with():
    world, rng = PointWorld(points=6000), np.random.default_rng(1)
    old, of_old = world.map_of([world.see(i, walk(i), rng, noise_px=0.5) for i in range(0, 300, 5)], rng)
    seen = [world.see(900 + i, walk(i), rng, noise_px=0.5) for i in (295, 299)]
    new, _ = world.map_of(seen, rng, map_id=1)
    new.transform(2.0, np.eye(3), np.array([1.0, 0.0, 0.0]))
    for k in range(2):
        assert align(old, new, 0, k, rng, LAX)[0] is None
    placed = tracked_in(old, of_old, seen[0], 59)
    merger = PlaceMerger(FusionConfig(confirmations=1, min_matches=20), BeliefConfig(), 0)
    merger.search(new, [old], lambda _: FoundByOneView(placed), nullcontext())
    found = merger._supposed[0].alignments[0]
    assert found.scale == pytest.approx(0.5, rel=0.02) and found.old_keyframe == 59
    assert found.S_old_new @ [1.0, 0.0, 0.0, 1.0] == pytest.approx([0, 0, 0, 1], abs=0.2)
