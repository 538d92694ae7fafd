"""The base system: its results, their repeatability, and its behaviour at breakages."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from slam_scenes import (
    accuse,
    blanked,
    check_maps,
    digest_of_run,
    errors_m,
    feed,
    fingerprint,
    kinds,
    on_one_core,
    reconfigure,
    rms,
    toy,
)

from dslab.slam.association.placing import LEAST_RIGHT
from dslab.slam.config import SlamConfig
from dslab.slam.core.events import TrackingState
from dslab.slam.factory import build_system
from dslab.slam.mapping.self_calibration import SelfCalibrationConfig
from dslab.slam.toy_sequence import CAMERA

COUNT, STEP_M = 100, 0.05
REPOSITORY = Path(__file__).parents[2]
SHAPE = (CAMERA.height_px, CAMERA.width_px)


def base():
    return build_system("base", CAMERA, 0)


@pytest.fixture(scope="module")
def sequence():
    return toy(COUNT, step_m=STEP_M)


@pytest.fixture(scope="module")
def run_with_snapshots(sequence):
    """A whole run, its maps checked after every frame, with snapshots."""
    images, stamps_s, T_world_cam = sequence
    system, results, snapshots = base(), [], {}
    for i, (image, stamp_s) in enumerate(zip(images, stamps_s, strict=True)):
        if i in (30, 38, 45, 80):
            snapshots[i] = system.snapshot()
        results.append(system.process(image, float(stamp_s)))
        check_maps(system)
    system.finish()
    return (system, results, T_world_cam), snapshots


@pytest.fixture(scope="module")
def run(run_with_snapshots):
    return run_with_snapshots[0]


@pytest.fixture(scope="module")
def snapshots(run_with_snapshots):
    return run_with_snapshots[1]


# -- tracking ------------------------------------------------------------------------------------------------


def test_a_clean_sequence_is_tracked_from_its_initialisation_on(run):
    system, results, _ = run
    assert kinds(system) == ["initialized"]
    start = system.events[0].frame
    assert start < 20
    tracked = [r.state is TrackingState.TRACKING for r in results]
    assert not any(tracked[:start])
    assert np.mean(tracked[start:]) >= 0.95


def test_the_trajectory_is_near_the_truth(run):
    system, results, T_world_cam = run
    (path,) = system.trajectories()
    errors, _ = errors_m(path, T_world_cam)
    # Of a path of 5 m.
    assert rms(errors) < 0.03 and errors.max() < 0.1
    first = system.current_map.frame_index(0)
    tracked = [r.frame for r in results if r.T_map_cam is not None]
    # The frames between the two of the initialization are tracked too.
    assert tracked[0] > first + 1
    assert path.frames.tolist() == [*range(first, tracked[0]), *tracked]
    assert len(path.frames) >= 0.9 * COUNT
    rotation = path.T_map_cam[:, :3, :3] @ path.T_map_cam[0, :3, :3].T
    cosine = (np.trace(rotation, axis1=1, axis2=2) - 1) / 2
    assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).max() < 1.0


def test_the_poses_at_the_time_of_tracking_are_near_the_truth(run):
    """Before later adjustment."""
    system, results, T_world_cam = run
    (path,) = system.trajectories()
    online = [r for r in results if r.T_map_cam is not None]
    now = replace(
        path, frames=np.array([r.frame for r in online]), T_map_cam=np.array([r.T_map_cam for r in online])
    )
    assert rms(errors_m(now, T_world_cam)[0]) < 0.04


def test_every_result_is_complete(run):
    system, results, _ = run
    for i, r in enumerate(results):
        assert (r.frame, r.stamp_s) == (i, pytest.approx(i / CAMERA.fps))
        assert r.keypoints_px.shape == (len(r.inlier_mask), 2) and r.keypoints_px.dtype == np.float32
        assert r.inlier_mask.dtype == bool
        if r.state is TrackingState.TRACKING:
            assert r.reason == "" and r.T_map_cam.shape == (4, 4)
            assert r.inliers <= r.matches
            assert r.map_id == system.current_map_id
        else:
            assert r.reason and r.T_map_cam is None and r.inliers == 0 and not r.inlier_mask.any()
    tracked = [r for r in results[system.events[0].frame + 1 :] if not r.is_keyframe]
    assert all(r.inlier_mask.sum() == r.inliers >= LEAST_RIGHT for r in tracked)


def test_keyframes_are_reported_when_they_are_made(run):
    system, results, _ = run
    declared = [r.frame for r in results if r.is_keyframe]
    # The first keyframe is the reference frame of the initialisation, declared with the second.
    made = [system.current_map.frame_index(k) for k in range(system.current_map.n_keyframes)]
    assert made[1:] == declared
    assert len(declared) >= 5
    (path,) = system.keyframe_trajectories()
    assert set(path.frames) <= {made[0], *declared}


def test_every_stage_is_timed(run):
    system, results, _ = run
    start = system.events[0].frame
    for r in results:
        tracked = {"initialize"} if r.frame <= start else {"predict", "local_map"}
        expected = {"extract", "other"} | tracked
        assert set(r.ms) == set(r.cpu_ms)
        assert expected <= set(r.ms) <= expected | {"second_motion"}
        assert all(0 <= r.cpu_ms[s] < 10_000 and r.ms[s] > 0 for s in expected)
        assert (r.mapping_cpu_ms > 0) is (r.is_keyframe and r.frame > start)


def test_poses_of_frames_follow_their_keyframes(run):
    """Adjustment moves keyframes after their frames were tracked; the trajectory follows."""
    system, results, _ = run
    (path,), m = system.trajectories(), system.current_map
    at = {int(f): T for f, T in zip(path.frames, path.T_map_cam, strict=True)}
    for k in m.keyframes():
        np.testing.assert_allclose(at[m.frame_index(int(k))], np.linalg.inv(m.T_cam_map(int(k))), atol=1e-9)
    moved = [np.abs(at[r.frame] - r.T_map_cam).max() for r in results if r.T_map_cam is not None]
    assert max(moved) > 1e-4


def test_map_points_are_a_copy(run):
    system, _, _ = run
    points = system.map_points(system.current_map_id)
    assert points.shape == (len(system.current_map.points()), 3) and np.isfinite(points).all()
    points[:] = 0
    assert np.abs(system.map_points(system.current_map_id)).max() > 1


def test_settings_and_events_can_be_written_as_json(run):
    system, _, _ = run
    assert json.loads(json.dumps(system.settings))["tracking"]["local_map_keyframes"] == 20
    for event in system.events:
        record = event.record()
        assert json.loads(json.dumps(record)) == record
        assert all(isinstance(v, (str, int, float, bool)) for v in record.values()), "flat"
        assert record["event"] == event.kind


def test_a_frame_whose_pose_is_not_believed_has_no_inliers(sequence, snapshots):
    images, stamps_s, _ = sequence
    system = snapshots[45].restore()
    system.tracker.config = replace(system.tracker.config, max_uncertainty=1e-9)
    lost = system.process(images[45], float(stamps_s[45]))
    assert lost.reason == "uncertain_pose" and lost.inliers > 50
    assert lost.T_map_cam is None and not lost.inlier_mask.any()


# -- repeatability -------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_run_bit_by_bit(run, sequence):
    images, stamps_s, _ = sequence
    again = base()
    feed(again, images, stamps_s, check=False)
    assert fingerprint(again) == fingerprint(run[0])


def test_another_seed_gives_another_run(sequence):
    """The start of ``paper`` is that of its RANSAC; the search for all motions finds the same from any."""
    images, stamps_s, _ = sequence
    systems = [build_system("paper", CAMERA, seed) for seed in (0, 1)]
    for system in systems:
        feed(system, images[:30], stamps_s[:30], check=False)
        assert len(system.trajectories()) == 1
    assert fingerprint(systems[0]) != fingerprint(systems[1])


@pytest.mark.slow
def test_another_process_on_one_core_gives_the_same_run():
    """With a recovery and a fusion; neither threads nor earlier runs in the process matter."""
    run = ("dual", 110, (60, 66))
    other = on_one_core("slam_scenes", f"digest_of_run(*{run!r})")
    here = [digest_of_run(*run) for _ in range(2)]
    assert here == [other] * 2
    assert here[0].endswith("recovery_end fusion")


# -- breakage ------------------------------------------------------------------------------------------------


def test_a_map_with_too_few_keyframes_is_dropped_and_another_initialized(sequence):
    images, stamps_s, _ = sequence
    system = base()
    results = feed(system, blanked(images[:45], range(13, 15)), stamps_s[:45])
    assert kinds(system) == ["initialized", "breakage", "map_dropped", "initialized"]
    started, broken, dropped, again = system.events
    assert (broken.frame, broken.map_id, broken.inliers) == (13, 0, 0) and broken.reason
    assert (dropped.frame, dropped.map_id, dropped.reason) == (13, 0, "too_few_keyframes")
    assert 2 <= dropped.keyframes <= SlamConfig().min_map_keyframes
    assert again.map_id == 1 and again.frame > 14 > started.frame
    assert system.maps() == [1]
    (path,) = system.trajectories()
    assert path.map_id == 1 and path.frames.min() >= 15
    assert results[13].state is TrackingState.NOT_INITIALIZED
    assert results[-1].state is TrackingState.TRACKING and results[-1].map_id == 1


def test_an_older_map_is_kept_and_the_system_is_lost(sequence, run, snapshots):
    images, stamps_s, T_world_cam = sequence
    system = snapshots[80].restore()
    results = run[1][:80] + feed(system, blanked(images[80:90], range(10)), stamps_s[80:90])
    assert kinds(system) == ["initialized", "breakage"]
    assert system.events[1].frame == 80
    assert len(system.current_map.keyframes()) > SlamConfig().min_map_keyframes
    assert results[80].state is TrackingState.LOST
    for r in results[80:]:
        assert r.T_map_cam is None and not r.is_keyframe
    assert all(r.state is TrackingState.RELOCALIZING and r.reason == "too_few_matches" for r in results[81:])
    (path,) = system.trajectories()
    assert path.frames.max() == 79
    assert rms(errors_m(path, T_world_cam)[0]) < 0.03


@pytest.mark.parametrize(("least", "kept"), [(2, True), (50, False)])
def test_the_fewest_keyframes_of_a_kept_map_are_a_setting(sequence, snapshots, least, kept):
    images, stamps_s, _ = sequence
    system = snapshots[38].restore()
    reconfigure(system, min_map_keyframes=least)
    feed(system, blanked(images[38:40], range(2)), stamps_s[38:40], check=False)
    assert ("map_dropped" in kinds(system)) is not kept
    assert system.maps() == ([0] if kept else [])
    assert system.state is (TrackingState.RELOCALIZING if kept else TrackingState.NOT_INITIALIZED)


@pytest.mark.slow
def test_corners_between_the_pixels_give_a_better_path(sequence):
    images, stamps_s, truth = sequence

    def ate_m(**orb):
        config = replace(SlamConfig(), orb=replace(SlamConfig().orb, **orb))
        system = build_system("base", CAMERA, 0, config=config)
        feed(system, images, stamps_s, check=False)
        return rms(errors_m(system.trajectories()[0], truth)[0])

    assert ate_m() < 0.9 * ate_m(subpixel=False)


# -- starts --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_map_begun_from_the_wrong_motion_is_dropped_with_its_poses_and_begun_again(sequence, monkeypatch):
    images, stamps_s, T_world_cam = sequence
    accuse(monkeypatch, range(10), at=25)
    system = base()
    results = feed(system, images, stamps_s)
    check_maps(system)
    assert kinds(system)[:3] == ["initialized", "map_dropped", "initialized"]
    dropped = system.events[1]
    assert (dropped.frame, dropped.map_id, dropped.reason) == (25, 0, "second_motion")
    assert results[24].state is TrackingState.TRACKING
    assert results[25].state is TrackingState.NOT_INITIALIZED and results[25].reason == "second_motion"
    (path,) = system.trajectories()
    assert path.map_id == 1 and path.frames[0] > 25 and path.frames[-1] == COUNT - 1
    assert rms(errors_m(path, T_world_cam)[0]) < 0.04


def test_the_camera_is_not_refined_by_a_map_whose_start_is_in_doubt(sequence, monkeypatch):
    images, stamps_s, _ = sequence
    config = replace(SlamConfig(), self_calibration=SelfCalibrationConfig((3,), 0.0, 0.0))
    for in_doubt in (range(10), range(0)):
        accuse(monkeypatch, in_doubt, at=COUNT)
        system = build_system("base", CAMERA, 0, config)
        feed(system, images[:40], stamps_s[:40])
        assert ("camera_refined" in kinds(system)) == (not in_doubt)
