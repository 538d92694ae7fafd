"""Every kind of degradation is pure and measured; kinds on frame plans; sensor noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.scenarios import spec
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.sim.degradations.base import FramePlan
from dslab.sim.degradations.registry import DEGRADATIONS, FRAME_PLAN_KINDS
from dslab.sim.degradations.truth import true_runs, truths_of
from dslab.sim.motion.walker import plan_walk
from dslab.sim.sensors.sensor import SensorNoise
from dslab.sim.worlds.base import Route

FPS, FRAMES = 30.0, 300


def make_plan() -> FramePlan:
    """A straight walk past ten surfaces, each of which fills the view for one second."""
    stamps_s = np.arange(FRAMES) / FPS
    route = Route(np.array([[0.0, 0], [30, 0]]), 1.0, False)
    share = np.maximum(0, 1 - np.abs(stamps_s[:, None] - (np.arange(10) + 0.5)))
    return FramePlan(
        stamps_s=stamps_s,
        motion=plan_walk(route, spec.Trajectory(), 10, 0),
        exposure_s=np.full(FRAMES, 0.004),
        contrast=np.ones(10),
        view_share=share.astype(np.float32),
    )


def make_segment(kind: str, seed: int = 0, **severity):
    drawn = {**DEGRADATIONS[kind].sample(rng_for(seed, kind)), **severity}
    return SEGMENT_KINDS[kind](kind=kind, start_s=4.0, duration_s=2.0, **drawn)


def test_every_kind_of_segment_has_its_degradation():
    assert set(DEGRADATIONS) == set(SEGMENT_KINDS)


@pytest.mark.parametrize("kind", DEGRADATIONS)
def test_sampled_severities_are_valid_and_repeat_with_the_seed(kind):
    drawn = [make_segment(kind, seed) for seed in range(20)]
    assert drawn[3] == make_segment(kind, 3)
    # The ends of some ranges are drawn more often than what lies between.
    assert len({str(segment.severity) for segment in drawn}) > 5


@pytest.mark.parametrize("kind", FRAME_PLAN_KINDS)
def test_apply_leaves_the_given_plan_unchanged_and_acts_within_the_segment(kind):
    plan, segment = make_plan(), make_segment(kind, 1)
    before = replace(plan, exposure_s=plan.exposure_s.copy(), contrast=plan.contrast.copy())
    poses = plan.motion.T_world_cam(plan.stamps_s)
    degraded = DEGRADATIONS[kind].apply(plan, segment)
    np.testing.assert_array_equal(plan.exposure_s, before.exposure_s)
    np.testing.assert_array_equal(plan.contrast, before.contrast)
    np.testing.assert_array_equal(plan.motion.T_world_cam(plan.stamps_s), poses)

    (truth,), columns = truths_of((segment,), degraded, (), np.full(FRAMES, 20.0))
    measure = columns[truth.measure]
    assert measure.shape == (len(degraded.stamps_s),)
    # Half a second after its start a swing is still slow and a stop still braking.
    first_s, last_s = degraded.stamps_s[[truth.first_frame, truth.last_frame]]
    assert 3.8 <= first_s <= 4.5
    assert 5.5 <= last_s <= 6.2
    assert truth.severity == segment.severity
    assert truth.measure == DEGRADATIONS[kind].measure_name
    assert measure[truth.first_frame] >= truth.threshold > measure[truth.first_frame - 1]


def test_low_texture_fades_the_surfaces_passed_during_the_segment():
    segment = make_segment("low_texture", contrast=0.1)
    degraded = DEGRADATIONS["low_texture"].apply(make_plan(), segment)
    np.testing.assert_allclose(degraded.contrast, [1, 1, 1, 1, 0.1, 0.1, 1, 1, 1, 1])
    assert degraded.motion is not None
    np.testing.assert_array_equal(degraded.exposure_s, make_plan().exposure_s)


def test_a_surface_that_is_never_seen_is_not_faded():
    plan = make_plan()
    segment = spec.LowTexture(kind="low_texture", start_s=0, duration_s=0.4, contrast=0.1)
    share = plan.view_share * (np.arange(10) != 7)
    unseen = replace(plan, view_share=share, moment_s=np.empty(0))
    assert DEGRADATIONS["low_texture"].apply(unseen, segment).contrast[7] == 1


def test_motion_blur_opens_the_shutter_for_the_frames_of_the_segment_only():
    segment = make_segment("motion_blur", exposure_s=0.1)
    exposure_s = DEGRADATIONS["motion_blur"].apply(make_plan(), segment).exposure_s
    np.testing.assert_array_equal(np.flatnonzero(exposure_s == 0.1), np.arange(120, 180))
    assert (exposure_s[[119, 180]] == 0.004).all()


def test_blur_below_the_threshold_acts_on_no_frame():
    plan, segment = make_plan(), make_segment("motion_blur", exposure_s=0.1)
    (truth,), _ = truths_of((segment,), plan, (), np.full(FRAMES, 0.5))
    assert (truth.first_frame, truth.last_frame) == (-1, -1)


@pytest.mark.parametrize(("axis", "index"), [("pitch", 0), ("yaw", 1), ("roll", 2)])
def test_fast_rotation_swings_out_and_back_about_its_axis_at_its_peak_rate(axis, index):
    segment = make_segment("fast_rotation", rate_degps=180.0, axis=axis)
    base = make_plan().motion
    motion = DEGRADATIONS["fast_rotation"].apply(make_plan(), segment).motion
    for outside_s in (3.9, 4.0, 6.0, 7.0):
        np.testing.assert_allclose(motion.T_world_cam(outside_s), base.T_world_cam(outside_s), atol=1e-9)
        np.testing.assert_allclose(motion.rate_radps(outside_s), base.rate_radps(outside_s), atol=1e-9)

    stamps_s = np.linspace(3.9, 6.1, 4001)
    swing = np.swapaxes(base.T_world_cam(stamps_s)[:, :3, :3], 1, 2) @ motion.T_world_cam(stamps_s)[:, :3, :3]
    angle = Rotation.from_matrix(swing).as_rotvec()
    assert np.abs(np.delete(angle, index, axis=1)).max() < 1e-9
    rate_degps = np.rad2deg(np.gradient(angle[:, index], stamps_s))
    assert np.abs(rate_degps).max() == pytest.approx(180, rel=1e-3)
    np.testing.assert_allclose(rate_degps, np.rad2deg(motion.swing_rate_radps(stamps_s)), atol=0.5)


def test_the_swung_rate_is_the_derivative_of_the_swung_pose():
    segment = make_segment("fast_rotation", rate_degps=250.0, axis="yaw")
    motion = DEGRADATIONS["fast_rotation"].apply(make_plan(), segment).motion
    stamps_s, step_s = np.linspace(3.8, 6.2, 200), 1e-4
    before, after = (motion.T_world_cam(stamps_s + d)[:, :3, :3] for d in (-step_s / 2, step_s / 2))
    rate = Rotation.from_matrix(np.swapaxes(before, 1, 2) @ after).as_rotvec() / step_s
    np.testing.assert_allclose(motion.rate_radps(stamps_s), rate, atol=1e-5)


@pytest.mark.parametrize(
    ("acts", "expected"),
    [
        ("0000000000", ()),
        ("0011110000", ((2, 5),)),
        ("0011101000", ((2, 4), (6, 6))),
        ("1100100011", ((4, 4),)),
        ("1111111111", ((0, 9),)),
    ],
)
def test_true_runs_are_the_runs_that_touch_the_segment(acts, expected):
    within = np.arange(10)
    assert true_runs(np.array([c == "1" for c in acts]), (within >= 4) & (within < 7)) == expected


def test_noise_has_its_sigma_no_bias_and_differs_between_frames():
    noise, gray = SensorNoise((480, 640), 3.0, 7), np.full((480, 640), 128, np.uint8)
    one, two = (noise.added(gray, frame).astype(float) - 128 for frame in (0, 1))
    assert one.std() == pytest.approx(3.0, rel=0.02)
    assert abs(one.mean()) < 0.02
    assert abs(np.corrcoef(one.ravel(), two.ravel())[0, 1]) < 0.01
    assert abs(np.corrcoef(one[:, 1:].ravel(), one[:, :-1].ravel())[0, 1]) < 0.01


def test_noise_is_fixed_by_seed_and_frame_and_saturates():
    gray = np.full((48, 64), 254, np.uint8)
    noisy = SensorNoise((48, 64), 5.0, 1).added(gray, 9)
    np.testing.assert_array_equal(noisy, SensorNoise((48, 64), 5.0, 1).added(gray, 9))
    assert not np.array_equal(noisy, SensorNoise((48, 64), 5.0, 2).added(gray, 9))
    assert (gray == 254).all()
    assert noisy.min() > 200


def test_no_noise_is_no_change():
    gray = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
    out = SensorNoise((48, 64), 0.0, 1).added(gray, 0)
    np.testing.assert_array_equal(out, gray)
    assert out is not gray
