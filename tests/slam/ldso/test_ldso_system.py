"""The system as seen from outside: path, loss, restart, repetition, misuse."""

import numpy as np
import pytest
from ldso_scenes import position_error

from dslab.slam.core import events as ev
from dslab.slam.core.events import TrackingState
from dslab.slam.factory import build_system
from dslab.slam.ldso.config import DsoConfig, PhotometricConfig
from dslab.slam.ldso.system import DsoSlam
from dslab.slam.toy_sequence import CAMERA, toy_frames

FRAMES, BLANK, SHORT = 160, range(50, 120), range(30, 33)


@pytest.fixture(scope="module")
def run():
    """System, results and true positions of a sequence with some empty images."""
    system = build_system("dso", CAMERA, 3)
    results, centres = [], []
    for image, stamp_s, T_world_cam in toy_frames(FRAMES, [*SHORT, *BLANK], step_m=0.04):
        results.append(system.process(image, stamp_s))
        centres.append(T_world_cam[:3, 3])
    system.finish()
    return system, results, np.array(centres)


def test_the_path_is_found(run):
    system, results, centres = run
    paths = system.trajectories()
    assert len(paths) == 2 and sum(len(p.frames) for p in paths) > 75
    for path in paths:
        assert position_error(path, centres) < 0.004
    assert any(r.is_keyframe for r in results)
    assert len(system.map_points(paths[0].map_id)) > 300


def test_empty_images_are_passed_over_while_the_pose_is_known_and_then_a_new_map_starts(run):
    system, results, _ = run
    kinds = [type(e) for e in system.events]
    assert kinds[:4] == [ev.Initialized, ev.Breakage, ev.MapSaved, ev.ReinitStart]
    assert kinds[4:] == [ev.Initialized, ev.ReinitDone]
    assert BLANK.start + len(SHORT) < system.events[1].frame < BLANK.stop
    for result in results:
        assert (result.T_map_cam is not None) == (result.state is TrackingState.TRACKING)
    assert all(results[k].reason for k in SHORT)
    assert results[SHORT.stop].state is TrackingState.TRACKING and results[SHORT.stop].map_id == 0
    assert results[-1].state is TrackingState.TRACKING and results[-1].map_id == 1


def test_poses_given_live_are_near_the_final_ones(run):
    system, results, _ = run
    path = system.trajectories()[0]
    final = dict(zip(path.frames, path.T_map_cam, strict=True))
    live = {r.frame: r.T_map_cam for r in results if r.T_map_cam is not None and r.map_id == path.map_id}
    assert set(live) <= set(final)
    extent = np.ptp(path.T_map_cam[:, :3, 3], axis=0).max()
    off = [np.linalg.norm(T[:3, 3] - final[k][:3, 3]) for k, T in live.items()]
    assert max(off) < 0.03 * extent


def test_a_snapshot_goes_on_bit_for_bit():
    system = build_system("dso", CAMERA, 1)
    frames = list(toy_frames(34, step_m=0.05))
    for image, stamp_s, _ in frames[:24]:
        system.process(image, stamp_s)
    branch = system.snapshot().restore()
    for image, stamp_s, _ in frames[24:]:
        one, other = system.process(image, stamp_s), branch.process(image, stamp_s)
        assert one.T_map_cam is not None and np.array_equal(one.T_map_cam, other.T_map_cam)
    for a, b in zip(system.trajectories(), branch.trajectories(), strict=True):
        np.testing.assert_array_equal(a.T_map_cam, b.T_map_cam)


@pytest.mark.slow
def test_brightness_is_expected_to_follow_known_exposures():
    """Every fourth image is exposed a fifth as long; brightness must hardly differ from what is expected, and
    where exposures are not known the path is worse.
    """

    def error(known: bool) -> float:
        settings = DsoConfig(photometric=PhotometricConfig(gain_sigma=1e-5))
        system, centres = DsoSlam(CAMERA, 3, dso=settings), []
        for k, (image, stamp_s, T_world_cam) in enumerate(toy_frames(40, step_m=0.04)):
            share = 0.2 if k % 4 == 3 else 1.0
            exposure_s = 0.02 * share if known else None
            system.process(np.rint(share * image).astype(np.uint8), stamp_s, exposure_s)
            centres.append(T_world_cam[:3, 3])
        paths = system.trajectories()
        whole = len(paths) == 1 and len(paths[0].frames) == 40
        return position_error(paths[0], np.array(centres)) if whole else np.inf

    known = error(True)
    assert known < 0.0015 and known < 0.7 * error(False)


def test_misuse_raises():
    system = build_system("dso", CAMERA)
    image = np.zeros((CAMERA.height_px, CAMERA.width_px), np.uint8)
    system.process(image, 0.0)
    for bad, stamp_s in ((image.astype(float), 1.0), (image[1:], 1.0), (image, 0.0), (image, float("nan"))):
        with pytest.raises(ValueError, match="frame 1"):
            system.process(bad, stamp_s)
    with pytest.raises(ValueError, match="exposure_s must be positive"):
        system.process(image, 1.0, 0.0)


@pytest.mark.parametrize("kind", ["dso", "ldso"])
@pytest.mark.slow
def test_no_image_raises(kind):
    """Noise, blank images, a mirrored one and a jump, in a map that has begun."""
    rng, shape = np.random.default_rng(5), (CAMERA.height_px, CAMERA.width_px)
    system = build_system(kind, CAMERA)
    frames = [image for image, _, _ in toy_frames(40, step_m=0.05)]
    blank = np.zeros(shape, np.uint8)
    stripes = np.tile(np.uint8([0, 255]), (shape[0], shape[1] // 2))
    noise = rng.integers(0, 256, shape).astype(np.uint8)
    odd = [noise, blank, 255 - blank, frames[0][:, ::-1].copy(), frames[39], stripes]
    stamp_s, broken = 0.0, 0
    for image in odd:
        for usual in frames[:16]:
            stamp_s += 0.03
            system.process(usual, stamp_s)
        stamp_s += 0.03
        broken += system.process(image, stamp_s).T_map_cam is None
    assert broken >= 5
