"""Recovery threads by name, and properties of every kind."""

from dataclasses import replace

import numpy as np
import pytest
from recovery_scenes import BLIND, blind_scene, same_map

from dslab.slam.config import SlamConfig
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryCost, RecoveryResult
from dslab.slam.dual.recovery.registry import ThreadSpec, build_thread, parse_threads
from dslab.slam.map.invariants import check_map
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.tracking.config import TrackingConfig
from dslab.slam.tracking.doubt import DoubtConfig
from dslab.slam.tracking.rules import own as own_rules

# Those of the paper are these with other settings.
KINDS = ("orb", "sift", "gms", "direct")

# -- names ---------------------------------------------------------------------------------------------------


def test_threads_are_named_in_order():
    assert [(t.kind, t.seed) for t in parse_threads("orb,sift, gms")] == [("orb", 0), ("sift", 0), ("gms", 0)]
    assert parse_threads("") == ()


def test_a_kind_named_twice_has_two_seeds():
    assert [t.seed for t in parse_threads("sift,orb,sift")] == [0, 0, 1]


@pytest.mark.parametrize("text", ["orb,surf", "ORB", "orb,", ","])
def test_an_unknown_kind_is_refused_with_the_known_ones(text):
    with pytest.raises(
        ValueError,
        match=r"^unknown recovery thread '.*': one of orb, sift, gms, direct, paper_orb, paper_sift$",
    ):
        parse_threads(text)


def test_a_specification_checks_its_kind():
    with pytest.raises(ValueError, match="one of orb, sift, gms"):
        ThreadSpec("icp")


@pytest.mark.parametrize("kind", KINDS)
def test_a_thread_is_of_the_specified_kind(kind):
    thread = build_thread(ThreadSpec(kind))
    assert thread.name == kind
    assert thread.needs_images == (kind in ("sift", "direct"))
    assert thread.config.max_unusable_s == RecoveryConfig().max_unusable_s


@pytest.mark.parametrize("kind", KINDS)
def test_shared_settings_reach_every_kind(kind):
    thread = build_thread(ThreadSpec(kind, config=RecoveryConfig(max_unusable_s=0.7)))
    assert thread.config.max_unusable_s == 0.7
    own = replace(thread.config, max_unusable_s=0.3)
    assert build_thread(ThreadSpec(kind, config=own)).config is own


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.slow
def test_what_a_thread_leaves_open_is_as_in_the_system(kind):
    scene = blind_scene()
    often = replace(SlamConfig(), tracking=TrackingConfig(keyframe_information=1.0, urgent_information=1.0))
    empty = replace(SlamConfig(), mapping=LocalMappingConfig(max_depth_error=1e-9))

    def result(system, **own):
        task = replace(scene.again(), system=system)
        own_config = RecoveryConfig(whole_buffer=True, **own)
        return build_thread(ThreadSpec(kind, config=own_config)).run(task)

    usual = result(SlamConfig())
    assert result(often).keyframes_made > usual.keyframes_made
    assert result(empty).map.n_points < usual.map.n_points
    own = result(often, tracking=TrackingConfig())
    assert own.keyframes_made == usual.keyframes_made
    own = result(empty, mapping=LocalMappingConfig())
    assert own.map.n_points == usual.map.n_points


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.slow
def test_the_first_pose_behind_a_gap_needs_the_same_odds_in_every_kind(kind, monkeypatch):
    assert min(f.features.index for f in blind_scene().run(kind).frames) < BLIND[0]
    monkeypatch.setattr(own_rules, "_BEHIND_A_GAP", np.inf)
    result = blind_scene().run(kind)
    assert not result.success and all(f.features.index > BLIND[-1] for f in result.frames)


@pytest.mark.parametrize("kind", KINDS)
def test_a_map_that_is_doubted_on_the_way_back_ends_the_recovery(kind):
    always = DoubtConfig(window_s=0.07, memory_s=1.0, min_frames=2, unsteady=0.0, least=0.0, min_share=0.1)
    result = blind_scene().run(kind, RecoveryConfig(doubt=always, whole_buffer=True))
    assert (result.success, result.stage) == (False, "propagation")
    assert result.reason == "motion_beyond_prediction"


@pytest.mark.parametrize("limit_s", [-1.0, float("nan")])
def test_an_invalid_limit_is_refused(limit_s):
    with pytest.raises(ValueError, match="max_unusable_s"):
        RecoveryConfig(max_unusable_s=limit_s)


def test_the_cost_of_a_recovery_is_that_of_its_steps():
    result = RecoveryResult(blind_scene().task.new_map)
    result.frames_covered, result.keyframes_made, result.alignments_tried = 10, 3, 2
    assert RecoveryCost(5.0, 20.0, 4.0).seconds(result) == pytest.approx(0.118)
    assert RecoveryCost(5.0, 20.0, 4.0, start_ms=60.0).seconds(result) == pytest.approx(0.178)


# -- every kind ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=KINDS)
def crossed(request):
    """The kind, its result on the blank frames, and copies of the old maps."""
    untouched = [m.copy() for m in blind_scene().task.old_maps]
    return request.param, blind_scene().run(request.param), untouched


@pytest.mark.slow
def test_the_old_map_is_reached_across_blank_frames(crossed):
    _, result, _ = crossed
    assert result.success and (result.stage, result.reason) == ("", "")
    assert result.frames_passed_over >= len(BLIND)
    assert abs(blind_scene().scale_error(result)) < 0.03
    assert result.inliers == result.alignment.inliers >= 40
    assert result.keyframes_made >= 2 and result.alignments_tried >= 2
    check_map(result.map)


def test_every_placed_frame_is_near_the_truth(crossed):
    errors = blind_scene().errors_m(crossed[1])
    assert not set(errors) & set(BLIND)
    assert min(errors) < BLIND.start and max(errors.values()) < 0.05


def test_the_old_maps_are_not_changed(crossed):
    assert all(same_map(a, b) for a, b in zip(blind_scene().task.old_maps, crossed[2], strict=True))


# The same seed of the SIFT thread: see the slow test of the faded scene.
@pytest.mark.parametrize("crossed", ["orb", "gms"], indirect=True)
def test_the_same_seed_gives_the_same_recovery(crossed):
    kind, result, _ = crossed
    again = blind_scene().run(kind)
    assert same_map(again.map, result.map)
    assert again.alignment.S_old_new.tobytes() == result.alignment.S_old_new.tobytes()
    for a, b in zip(again.frames, result.frames, strict=True):
        assert a.T_cam_map.tobytes() == b.T_cam_map.tobytes() and a.point.tobytes() == b.point.tobytes()


@pytest.mark.parametrize("kind", KINDS)
def test_without_a_limit_of_unusable_frames_the_first_one_ends_the_recovery(kind):
    """As in the paper."""
    result = blind_scene().run(kind, RecoveryConfig(max_unusable_s=0.0))
    assert (result.success, result.stage, result.frames_passed_over) == (False, "propagation", 1)
    assert result.reason.startswith(("too_few", "images_differ"))
    assert result.frames_covered == blind_scene().task.first.features.index - BLIND.stop + 1
    check_map(result.map)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_with_an_infinite_limit_all_unusable_frames_are_passed_over(kind):
    """As in the released code: the end of the buffer is reached."""
    scene = blind_scene()
    everything = range(scene.task.first.features.index)
    result = scene.run(kind, RecoveryConfig(max_unusable_s=float("inf")), everything)
    assert (result.success, result.stage, result.reason) == (False, "overlap", "old_map_not_reached")
    assert result.frames_covered == result.frames_passed_over == len(scene.task.backward)
    limited = scene.run(kind, RecoveryConfig(max_unusable_s=0.5), everything)
    assert (limited.success, limited.stage) == (False, "propagation")
    assert limited.frames_covered == limited.frames_passed_over == 16


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_an_old_map_of_another_scene_is_not_aligned(kind):
    scene = blind_scene()
    old = scene.task.old_maps[0].copy()
    rng = np.random.default_rng(0)
    old.arrays.kp_descriptor[:] = rng.integers(0, 2**63, old.arrays.kp_descriptor.shape)
    short = [f for f in scene.task.backward if f.index > BLIND.start - 12]
    task = replace(scene.again(), old_maps=[old], backward=short)
    result = build_thread(ThreadSpec(kind)).run(task)
    assert (result.success, result.stage, result.reason) == (False, "overlap", "too_few_common_points")
    assert result.alignments_tried > 0
