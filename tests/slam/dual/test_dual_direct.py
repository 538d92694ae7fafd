"""Recovery by intensities: blank, faded and smeared frames, and what it must not believe."""

from dataclasses import replace

import numpy as np
import pytest
from recovery_scenes import FADED, SMEARED, blind_scene, faded_scene, same_map, smeared_scene
from slam_scenes import rigid

from dslab.slam.core.events import CANCELLED
from dslab.slam.dual.recovery import other_way, propagation
from dslab.slam.dual.recovery.appearance import LooksConfig
from dslab.slam.dual.recovery.direct import DirectRecoveryConfig
from dslab.slam.dual.recovery.other_way import OtherWayConfig
from dslab.slam.dual.recovery.registry import ThreadSpec, build_thread
from dslab.slam.map._map_kernels import median_depth
from dslab.slam.map.invariants import check_map
from dslab.slam.optimization.sim3 import sim3_decompose, sim3_matrix


@pytest.fixture(scope="module")
def faded():
    return faded_scene().run("direct")


@pytest.mark.slow
def test_blank_frames_are_passed_over():
    scene = blind_scene()
    result = scene.run("direct")
    assert result.success and result.frames_passed_over == 6
    assert max(scene.errors_m(result).values()) < 0.02
    assert abs(scene.scale_error(result)) < 0.04


def test_faded_frames_are_crossed_with_a_pose_each(faded):
    """At a twentieth of the contrast, over a path whose ends share no view."""
    scene = faded_scene()
    assert faded.success and faded.frames_passed_over == 0
    errors = scene.errors_m(faded)
    assert set(FADED) <= set(errors) and max(errors.values()) < 0.1
    assert abs(scene.scale_error(faded)) < 0.05
    check_map(faded.map)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_recovery_bit_by_bit(faded):
    again = faded_scene().run("direct")
    assert same_map(again.map, faded.map)
    assert again.alignment.S_old_new.tobytes() == faded.alignment.S_old_new.tobytes()


@pytest.mark.slow
def test_smeared_frames_are_entered_and_left_through_blur():
    scene = smeared_scene()
    result = scene.run("direct")
    assert result.success and result.frames_passed_over == 0
    errors = scene.errors_m(result)
    assert set(SMEARED) <= set(errors) and max(errors.values()) < 0.2
    assert abs(scene.scale_error(result)) < 0.02
    made = {result.map.frame_index(int(k)) for k in result.map.keyframes()}
    assert not made & set(SMEARED)
    sharp = scene.run("direct", DirectRecoveryConfig(through_blur=False))
    assert not set(SMEARED) & {f.features.index for f in sharp.frames}


@pytest.mark.slow
def test_faint_images_of_something_else_do_not_look_alike():
    """Their residuals are small, as they hold next to nothing; only the patterns tell."""
    scene = faded_scene()
    task = scene.again()
    noise = np.random.default_rng(0).normal(120, 3, task.image_of(60).shape).astype(np.uint8)
    shown = dict.fromkeys(FADED, noise)
    task = replace(task, image_of=lambda index: shown.get(index, scene.images[index]))
    result = build_thread(ThreadSpec("direct")).run(task)
    assert not result.success and result.reason == "images_differ"
    assert not set(FADED) & {f.features.index for f in result.frames}


def test_a_small_image_is_a_reason():
    task = blind_scene().again()
    small = replace(task.camera, width_px=80, height_px=60, cx=40.0, cy=30.0)
    result = build_thread(ThreadSpec("direct")).run(replace(task, camera=small))
    assert (result.success, result.stage, result.reason) == (False, "propagation", "image_too_small")


def planted(monkeypatch, change):
    """Give all alignments a fault that matches of features are made to overlook."""
    found_by = propagation.align

    def align(old, new, old_keyframe, *rest):
        found, reason, count = found_by(old, new, old_keyframe, *rest)
        if found is not None:
            T = old.T_cam_map(old_keyframe)
            S = np.linalg.inv(T) @ change(median_depth(old.arrays, old_keyframe)) @ T @ found.S_old_new
            found = replace(found, S_old_new=S, scale=sim3_decompose(S)[0])
        return found, reason, count

    monkeypatch.setattr(propagation, "align", align)
    monkeypatch.setattr(propagation.Supposed, "is_believed", lambda _: True)


WRONG = {
    "scale": lambda depth: sim3_matrix(1.25, np.eye(3), np.array([0, 0, -0.25 * depth])),
    "scale about the camera": lambda depth: sim3_matrix(0.6, np.eye(3), np.zeros(3)),
    "turn": lambda depth: rigid((0, 0, 0), (0, 3, 0)),
    "shift": lambda depth: rigid((0.1 * depth, 0, 0), (0, 0, 0)),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
@pytest.mark.slow
def test_an_alignment_under_which_the_old_surface_looks_wrong_is_refused(monkeypatch, wrong):
    planted(monkeypatch, wrong)
    refused = blind_scene().run("direct")
    assert (refused.success, refused.stage, refused.reason) == (False, "sim3", "images_differ")


def test_without_the_photometric_check_a_planted_alignment_passes(monkeypatch):
    planted(monkeypatch, WRONG["shift"])
    unchecked = DirectRecoveryConfig(looks=LooksConfig(min_sound=0.0), other_way=OtherWayConfig(check=False))
    assert blind_scene().run("direct", unchecked).success


UNLOOKED = DirectRecoveryConfig(looks=LooksConfig(min_sound=0.0))


def test_both_ways_through_faded_frames_agree(faded):
    one_way = faded_scene().run("direct", DirectRecoveryConfig(other_way=OtherWayConfig(check=False)))
    assert one_way.success and one_way.alignment.S_old_new.tobytes() == faded.alignment.S_old_new.tobytes()
    assert faded.frames_checked > len(FADED) and one_way.frames_checked == 0


FAR = WRONG | {
    "turn": lambda depth: rigid((0, 0, 0), (0, 6, 0)),
    "shift": lambda depth: rigid((0.2 * depth, 0, 0), (0, 0, 0)),
}


@pytest.mark.parametrize("wrong", FAR.values(), ids=FAR)
@pytest.mark.slow
def test_an_alignment_that_the_other_way_does_not_lead_to_is_refused(monkeypatch, wrong):
    planted(monkeypatch, wrong)
    refused = blind_scene().run("direct", UNLOOKED)
    assert (refused.success, refused.stage, refused.reason) == (False, "sim3", "ways_disagree")


def test_if_the_other_way_is_not_passable_the_recovery_fails(monkeypatch):
    task_ahead = other_way._task_ahead

    def in_the_dark(task, found):
        return replace(task_ahead(task, found), image_of=lambda index: np.zeros_like(task.image_of(index)))

    monkeypatch.setattr(other_way, "_task_ahead", in_the_dark)
    result = blind_scene().run("direct", UNLOOKED)
    assert (result.success, result.stage, result.reason) == (False, "sim3", "not_found_back")


def test_a_thread_that_is_ended_on_its_other_way_is_cancelled(monkeypatch):
    task_ahead = other_way._task_ahead

    def ended(task, found):
        monkeypatch.setattr(task.cancellation, "requested", True)
        return task_ahead(task, found)

    monkeypatch.setattr(other_way, "_task_ahead", ended)
    result = blind_scene().run("direct", UNLOOKED)
    assert (result.success, result.stage, result.reason) == (False, CANCELLED, "")
