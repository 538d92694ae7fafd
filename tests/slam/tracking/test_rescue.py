"""Rescue by intensities before a breakage is declared: through blur, told by events, off by default."""

from dataclasses import replace

import numpy as np
import pytest
from recovery_scenes import SMEARED, smeared_scene
from slam_scenes import blanked, errors_m, feed, kinds, toy

from dslab.slam.config import SlamConfig, default_config
from dslab.slam.core import events as ev
from dslab.slam.dual.paper import paper_config
from dslab.slam.invariants import check_system
from dslab.slam.system import MonocularSlam
from dslab.slam.toy_sequence import CAMERA
from dslab.slam.tracking.rescue import RescueConfig

STAMPS_S = np.arange(200) / 30.0


def run(images, max_s):
    system = MonocularSlam(CAMERA, 0, replace(default_config(CAMERA), rescue=RescueConfig(max_s=max_s)))
    return system, feed(system, images, STAMPS_S[: len(images)], check=False)


@pytest.fixture(scope="module")
def smeared():
    scene = smeared_scene()
    return scene, *run(scene.images[:100], 2.0)


def test_it_is_off_unless_it_is_set():
    assert SlamConfig().rescue.max_s == 0 and paper_config(CAMERA).rescue.max_s == 0
    system, _ = run(smeared_scene().images[:60], 0.0)
    assert "breakage" in kinds(system) and "rescue_start" not in kinds(system)


def test_frames_that_features_cannot_track_are_placed_and_tracking_goes_on(smeared):
    scene, system, results = smeared
    assert "breakage" not in kinds(system)
    assert all(results[i].T_map_cam is not None for i in SMEARED)
    path = system.trajectories()[0]
    errors = dict(zip(path.frames, errors_m(path, scene.T_world_cam[:100])[0], strict=True))
    assert max(errors[i] for i in SMEARED) < 0.2 and max(errors.values()) < 0.2
    check_system(system)


def test_events_tell_of_a_rescue(smeared):
    _, system, results = smeared
    start, end = (
        next(e for e in system.events if isinstance(e, kind)) for kind in (ev.RescueStart, ev.RescueEnd)
    )
    assert start.frame in SMEARED and start.reason.startswith("too_few") and end.success
    rescued = {r.frame for r in results if "rescue" in r.ms}
    assert rescued and end.frames == len([f for f in rescued if start.frame <= f < end.frame])


def test_no_keyframe_is_made_of_a_rescued_frame(smeared):
    _, _, results = smeared
    assert not any(r.is_keyframe for r in results if "rescue" in r.ms)


@pytest.mark.parametrize("max_s", [2.0])
def test_frames_that_show_nothing_are_not_rescued(max_s):
    images, _, _ = toy(80)
    system, _ = run(blanked(images, range(50, 60)), max_s)
    assert "breakage" in kinds(system) and "rescue_start" not in kinds(system)


@pytest.mark.slow
def test_a_rescue_ends_in_a_breakage_when_it_takes_too_long():
    images = smeared_scene().images
    system, results = run([*images[:56], *([images[55]] * 30)], 0.2)
    start = next(e for e in system.events if isinstance(e, ev.RescueStart))
    end = next(e for e in system.events if isinstance(e, ev.RescueEnd))
    breakage = next(e for e in system.events if isinstance(e, ev.Breakage))
    assert not end.success and end.frame == breakage.frame and end.frames == breakage.frame - start.frame
    assert breakage.stamp_s - start.stamp_s <= 0.2 + 1e-6
    assert results[breakage.frame].T_map_cam is None
