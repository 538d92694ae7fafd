"""Known answers of the image-space kinds, and their oracles."""

from functools import partial

import cv2
import numpy as np
import pytest
from degradation_worlds import sharp_frame, small_backend, small_scenario

from dslab.scenarios.segments import SEGMENT_KINDS
from dslab.sim.degradations.base import streams_of
from dslab.sim.degradations.focus import disc
from dslab.sim.degradations.image import View
from dslab.sim.degradations.low_light import noise_table
from dslab.sim.degradations.registry import IMAGE_KINDS
from dslab.sim.degradations.rolling_shutter import row_maps
from dslab.sim.degradations.segment_link import ramp
from dslab.sim.frame_plan import camera_intrinsics, plan_frames, plan_path
from dslab.sim.imaging import rendered
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import DECODE, decode, encode, linear_to_srgb, srgb_to_linear

CAMERA = Intrinsics(160, 120, 120.0, 120.0, 79.5, 59.5, 30.0)


def texture(seed: int = 0) -> np.ndarray:
    coarse = np.random.default_rng(seed).uniform(20, 235, (15, 20)).astype(np.float32)
    return cv2.resize(coarse, (160, 120), interpolation=cv2.INTER_CUBIC).clip(0, 255).astype(np.uint8)


def make(kind: str, seed: int = 0, camera: Intrinsics = CAMERA, **parameters):
    segment = SEGMENT_KINDS[kind](kind=kind, start_s=1, duration_s=2, **parameters)
    return IMAGE_KINDS[kind].prepare(segment, camera, partial(streams_of, seed, segment))


def at(stamp_s: float = 1.0, strength: float = 1.0, frame: int = 0, depth_m=None, motion=None) -> View:
    return View(frame, stamp_s, strength, depth_m, motion)


def light_of(levels) -> np.ndarray:
    return srgb_to_linear(np.asarray(levels) / 255)


def test_light_survives_coding_and_saturates():
    levels = np.arange(256, dtype=np.uint8)[None]
    np.testing.assert_array_equal(encode(decode(levels)), levels)
    np.testing.assert_array_equal(encode(np.array([[-1.0, 2.0]], np.float32)), [[0, 255]])
    light = np.linspace(0, 1, 1000, dtype=np.float32)[None]
    assert np.abs(encode(light) - 255 * linear_to_srgb(light.astype(float))).max() < 0.6


def test_a_creeping_segment_rises_to_its_end():
    segment = SEGMENT_KINDS["jpeg"](kind="jpeg", start_s=1, duration_s=2, quality=5, ramp_s=2, fall_s=0)
    strength = ramp(segment, np.array([0.9, 1.0, 1.5, 2.0, 2.99, 3.0]))
    np.testing.assert_allclose(strength, [0, 0, 0.25, 0.5, 0.995, 0])


@pytest.mark.parametrize("ramp_s", [0.0, 0.5])
def test_the_ramp_is_straight_and_within_the_segment(ramp_s):
    segment = SEGMENT_KINDS["jpeg"](kind="jpeg", start_s=1, duration_s=2, quality=5, ramp_s=ramp_s)
    strength = ramp(segment, np.array([0.9, 1.0, 1.25, 2.0, 2.75, 3.0]))
    rising = 1.0 if ramp_s == 0 else 0.25 / ramp_s
    np.testing.assert_allclose(strength, [0, float(ramp_s == 0), rising, 1, rising, 0])


@pytest.mark.parametrize("transmission", [0.0, 0.1])
def test_a_cover_passes_its_share_of_the_light(transmission):
    image, (out, withheld) = texture(), make("covered_lens", transmission=transmission)(texture(), at())
    np.testing.assert_allclose(out, 255 * linear_to_srgb(transmission * light_of(image)), atol=0.51)
    assert withheld == pytest.approx(1 - transmission)


def test_a_stop_doubles_the_light_until_it_saturates():
    out, stops = make("over_exposure", stops=2)(texture(), at(strength=0.5))
    expected = 255 * linear_to_srgb(np.minimum(1, 2 * light_of(texture())))
    np.testing.assert_allclose(out, expected, atol=0.51)
    assert stops == 1


@pytest.mark.parametrize("stops", [3.0, -3.0])
def test_the_exposure_error_falls_by_e_in_each_time_constant(stops):
    lag = make("auto_exposure_lag", stops=stops, time_constant_s=0.4)
    measured = [lag(texture(), at(stamp_s))[1] for stamp_s in (1.0, 1.4, 1.8)]
    np.testing.assert_allclose(measured, 3 * np.exp([0, -1, -2]))
    brighter = lag(texture(), at())[0].mean() > texture().mean()
    assert brighter == (stops > 0)


@pytest.mark.parametrize("diameter_px", [1.5, 9.3])
def test_a_disc_has_its_area_and_sends_a_point_where_it_lies(diameter_px):
    kernel = disc(diameter_px)
    assert kernel.sum() == pytest.approx(1, abs=1e-5)
    assert 1 / kernel.max() == pytest.approx(np.pi / 4 * diameter_px**2, rel=0.35 / diameter_px + 0.02)
    spread = np.arange(len(kernel)) - len(kernel) // 2
    # The variance of a disc along an axis is a quarter of its radius squared.
    assert (kernel.sum(axis=0) * spread**2).sum() == pytest.approx(diameter_px**2 / 16, rel=0.2, abs=0.1)


def test_defocus_keeps_the_light():
    out, measured = make("defocus", diameter_px=9)(texture(), at())
    assert light_of(out)[20:-20, 20:-20].mean() == pytest.approx(
        light_of(texture())[20:-20, 20:-20].mean(), rel=0.02
    )
    assert np.abs(np.diff(out.astype(int))).max() < np.abs(np.diff(texture().astype(int))).max()
    assert measured == 9


def test_low_light_has_the_mean_and_the_noise_of_its_electrons():
    level, illumination, full_well_e, read_e = 200, 0.1, 2000.0, 12.0
    gray = np.full((120, 160), level, np.uint8)
    dark = make("low_light", illumination=illumination, gain=8, full_well_e=full_well_e, read_noise_e=read_e)
    out, stops = dark(gray, at())
    electrons = illumination * full_well_e * light_of(level)
    light = light_of(out)
    assert stops == pytest.approx(-np.log2(illumination))
    assert light.mean() == pytest.approx(8 * electrons / full_well_e, rel=0.01)
    assert light.std() == pytest.approx(8 * np.sqrt(electrons + read_e**2) / full_well_e, rel=0.03)
    assert abs(np.corrcoef(light[:, 1:].ravel(), light[:, :-1].ravel())[0, 1]) < 0.03


def test_low_light_differs_from_frame_to_frame_and_seed_to_seed():
    outs = [
        make("low_light", seed, illumination=0.05)(texture(), at(frame=frame))[0]
        for seed, frame in ((0, 0), (0, 1), (1, 0), (0, 0))
    ]
    assert not np.array_equal(outs[0], outs[1]) and not np.array_equal(outs[0], outs[2])
    np.testing.assert_array_equal(outs[0], outs[3])


def test_the_noise_table_is_its_formula():
    table = noise_table(0.2, 3.0, 1000.0, 4.0)
    for level, code in ((0, 128), (200, 128), (90, 20), (255, 255)):
        electrons = 200 * float(DECODE[level])
        counted = electrons + np.sqrt(electrons + 16) * (code - 128) / 32
        expected = 255 * linear_to_srgb(np.clip(3 * counted / 1000, 0, 1))
        assert table[level, code] == pytest.approx(expected, abs=0.7)


def test_fog_follows_koschmieders_law():
    depth_m = np.full((120, 160), 3.0, np.float32)
    depth_m[:, 80:] = 0
    fog = make("fog", extinction_per_m=0.5, airlight_level=180)
    out, scattering = fog(texture(), at(depth_m=depth_m))
    for row, column in ((60, 79), (0, 0), (119, 10)):
        ray = np.linalg.norm([(column - 79.5) / 120, (row - 59.5) / 120, 1])
        passing = np.exp(-0.5 * 3 * ray)
        light = light_of(texture()[row, column]) * passing + light_of(180) * (1 - passing)
        assert out[row, column] == pytest.approx(255 * linear_to_srgb(light), abs=0.6)
    assert (out[:, 80:] == 180).all()
    assert 0.5 + 0.5 * (1 - np.exp(-1.5)) < scattering < 1


@pytest.mark.parametrize("share", [0.1, 0.9])
def test_dirt_covers_its_share_and_stays_in_place(share):
    dirty, image = make("lens_dirt", share=share), texture(3)
    out, measured = dirty(image, at())
    assert measured == pytest.approx(share, abs=0.05)
    np.testing.assert_array_equal(out, dirty(image, at(2.5, frame=9))[0])
    less = make("lens_dirt", share=share / 2)(image, at())[0]
    touched, less_touched = out != image, less != image
    assert touched.mean() > less_touched.mean()
    assert (touched | ~less_touched).mean() > 0.99


@pytest.mark.parametrize("share", [0.1, 0.9])
def test_moving_objects_fill_their_share_and_move_at_their_rate(share):
    passing, flat = make("moving_objects", share=share, rate_degps=30), np.full((120, 160), 7, np.uint8)
    shares = [passing(flat, at(stamp_s))[1] for stamp_s in np.linspace(1, 3, 9)]
    assert np.mean(shares) == pytest.approx(share, abs=0.12)
    out, measured = passing(flat, at(1.3))
    assert ((out != 7).mean()) == pytest.approx(measured, abs=0.05)


def test_one_moving_object_moves_by_its_angle():
    passing, flat = make("moving_objects", seed=2, share=0.02, rate_degps=30), np.zeros((120, 160), np.uint8)
    first, second = (passing(flat, at(stamp_s))[0] for stamp_s in (1.0, 1.1))
    spectrum = np.fft.rfft2(first.astype(float)).conj() * np.fft.rfft2(second.astype(float))
    row, column = np.unravel_index(np.fft.irfft2(spectrum, first.shape).argmax(), first.shape)
    moved = np.hypot((row + 60) % 120 - 60, (column + 80) % 160 - 80)
    pxps = np.deg2rad(30) * 120
    assert 0.6 * pxps * 0.1 - 1 <= moved <= 1.4 * pxps * 0.1 + 1


def test_jpeg_is_the_encoder_of_its_quality():
    out, loss = make("jpeg", quality=10)(texture(), at())
    _, data = cv2.imencode(".jpg", texture(), [cv2.IMWRITE_JPEG_QUALITY, 10])
    np.testing.assert_array_equal(out, cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))
    assert loss == 90


@pytest.mark.parametrize("kind", IMAGE_KINDS)
def test_the_given_image_and_depth_stay_unchanged(kind):
    strong = IMAGE_KINDS[kind].sample(np.random.default_rng(1))
    motion = plan_path(small_scenario("room", seed=1), small_backend())
    image, depth_m = texture(), np.full((120, 160), 2.0, np.float32)
    image.setflags(write=False)
    before = depth_m.copy()
    filtered = make(kind, **strong)
    first, _ = filtered(image, at(depth_m=depth_m, motion=motion))
    second, _ = filtered(image, at(depth_m=depth_m, motion=motion))
    np.testing.assert_array_equal(image, texture())
    np.testing.assert_array_equal(depth_m, before)
    np.testing.assert_array_equal(first, second)
    assert (first.shape, first.dtype) == (image.shape, np.uint8)


def test_every_row_of_a_rolling_shutter_is_the_row_of_a_frame_at_its_own_time():
    scenario, backend = small_scenario("corridor", seed=4), small_backend()
    camera, readout_s, stamp_s = camera_intrinsics(scenario.camera), 0.25, 0.4
    plan, world = plan_frames(scenario, backend)
    rolling = make("rolling_shutter", camera=camera, readout_s=readout_s)
    with rendered(world, camera, backend) as links:
        middle, depth_m = sharp_frame(links, plan.motion.T_world_cam(stamp_s))
        out, shift_px = rolling(middle, at(stamp_s, depth_m=depth_m, motion=plan.motion))
        errors, without = [], []
        for row in range(4, camera.height_px, 12):
            row_s = stamp_s + readout_s * (row / (camera.height_px - 1) - 0.5)
            truth = sharp_frame(links, plan.motion.T_world_cam(row_s))[0][row, 20:-20].astype(int)
            errors.append(np.median(np.abs(out[row, 20:-20] - truth)))
            without.append(np.median(np.abs(middle[row, 20:-20] - truth)))
    assert shift_px > 4
    assert np.mean(errors) < 3
    assert np.mean(errors) < 0.35 * np.mean(without)


def test_row_maps_are_the_projection_through_each_rows_pose():
    """The kernel against NumPy, on a plane, where the depth in the second round is known."""
    k, depth_m = np.array([120, 120, 79.5, 59.5], np.float32), np.full((120, 160), 2.0, np.float32)
    T = np.tile(np.eye(4, dtype=np.float32)[:3], (120, 1, 1))
    T[:, 0, 3], T[:, 1, 3] = np.linspace(-0.1, 0.1, 120), 0.02
    map_x, map_y = row_maps(depth_m, k, T)
    columns, rows = np.meshgrid(np.arange(160), np.arange(120))
    np.testing.assert_allclose(map_x, columns + 120 * T[:, 0, 3][:, None] / 2, atol=1e-3)
    np.testing.assert_allclose(map_y, rows + 120 * 0.02 / 2, atol=1e-3)
