"""Turns, longer shutters and fading detail of recordings: geometry, light and what stays untouched."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from dslab.scenarios.errors import InputError
from dslab.scenarios.segment_text import parse_segment
from dslab.sim.degradations.recorded_kinds import check_recorded_sequence
from dslab.sim.degradations.recorded_sequences import degrade_sequence
from dslab.sim.degradations.retake import DETAIL_DEG, noise_level
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.distortion import project
from dslab.sim.sensors.tone import decode, encode
from dslab.sim.sequence import Sequence

WIDTH, HEIGHT, FPS = 200, 150, 20.0
PINHOLE = Intrinsics(WIDTH, HEIGHT, 150.0, 151.0, 101.5, 73.25, FPS)
CAMERAS = {
    "pinhole": PINHOLE,
    "radtan": replace(PINHOLE, distortion=(-0.28, 0.07, 0.0002, 0.0001, 0.0)),
    "equidistant": replace(PINHOLE, distortion=(-0.01, 0.02, 0.0, 0.0), model="equidistant"),
}


class Frames(list):
    """Frames in memory."""


def recording(images, camera=PINHOLE, **more) -> Sequence:
    count = len(images)
    empty = {"T_world_cam": None, "depths": None, "segments": (), "meta": {}}
    return Sequence("trial", camera, 1e3 + np.arange(count) / FPS, Frames(images), **{**empty, **more})


def degrade(sequence: Sequence, folder, *texts: str, seed: int = 0) -> Sequence:
    return degrade_sequence(sequence, [parse_segment(text) for text in texts], seed, folder)


def smooth_noise(size: tuple[int, int], scale_px: float, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(size).astype(np.float32)
    noise = cv2.GaussianBlur(noise, (0, 0), scale_px)
    return noise / noise.std()


# -- turns

POINTS = np.array([(x, y, 4 + 0.3 * k) for k, (x, y) in enumerate(np.ndindex(5, 4))]) - (2.0, 1.5, 0)
WALK = np.tile(np.eye(4), (20, 1, 1))
WALK[:, 0, 3] = np.linspace(0, 0.4, 20)


def pixels_of(T_world_cam: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """(P, 2) pixels of the points, NaN well outside of the frame."""
    at_cam = (POINTS - T_world_cam[:3, 3]) @ T_world_cam[:3, :3]
    xy = project(camera, at_cam[:, :2] / at_cam[:, 2:])
    size = np.array([camera.width_px, camera.height_px])
    return np.where(((xy > 9) & (xy < size - 10)).all(axis=1)[:, None], xy, np.nan)


def dots(T_world_cam: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """A frame with a bright dot at every point."""
    light = np.full((camera.height_px, camera.width_px), 0.02, np.float32)
    for px, py in pixels_of(T_world_cam, camera):
        if not np.isnan(px):
            rows, columns = slice(round(py) - 9, round(py) + 10), slice(round(px) - 9, round(px) + 10)
            y, x = np.mgrid[rows, columns]
            light[rows, columns] += 0.8 * np.exp(-((x - px) ** 2 + (y - py) ** 2) / 4)
    return encode(light)


def centre(image: np.ndarray, near: np.ndarray) -> np.ndarray:
    left, top = np.rint(near).astype(int) - 5
    light = decode(image[top : top + 11, left : left + 11]) - decode(np.array([[image.min()]], np.uint8))
    y, x = np.mgrid[top : top + 11, left : left + 11]
    return np.array([(light * x).sum(), (light * y).sum()]) / light.sum()


@pytest.mark.parametrize(
    ("lens", "axis"),
    [
        ("pinhole", "yaw"),
        ("pinhole", "pitch"),
        ("pinhole", "roll"),
        ("radtan", "yaw"),
        ("equidistant", "roll"),
    ],
)
def test_points_move_in_the_images_as_the_turned_truth_says(tmp_path, lens, axis):
    camera = CAMERAS[lens]
    sequence = recording([dots(T, camera) for T in WALK], camera, T_world_cam=WALK)
    turned = degrade(
        sequence, tmp_path, f"fast_rotation:start_s=0.2,duration_s=0.6,rate_degps=60,axis={axis}"
    )
    assert turned.T_world_cam is not None
    np.testing.assert_array_equal(turned.T_world_cam[:, :3, 3], WALK[:, :3, 3])
    angles = np.degrees(np.arccos(np.clip((np.trace(turned.T_world_cam[:, :3, :3], 0, 1, 2) - 1) / 2, -1, 1)))
    assert angles.max() == pytest.approx(0.245 * 60 * 0.6, rel=0.01)
    assert (angles[:5] == 0).all() and (angles[16:] == 0).all()
    errors = []
    for T, image in zip(turned.T_world_cam, turned.frames, strict=True):
        assert image.shape == (turned.camera.height_px, turned.camera.width_px)
        errors += [
            np.hypot(*(centre(image, xy) - xy)) for xy in pixels_of(T, turned.camera) if not np.isnan(xy[0])
        ]
    assert len(errors) > 100
    assert np.max(errors) < 0.15, f"{np.max(errors):.3f} px"


def test_frames_without_a_turn_are_cropped_and_not_a_bit_else(tmp_path):
    rng = np.random.default_rng(1)
    sequence = recording(list(rng.integers(0, 256, (20, HEIGHT, WIDTH), dtype=np.uint8)))
    turned = degrade(sequence, tmp_path, "fast_rotation:start_s=0.2,duration_s=0.6,rate_degps=80")
    window, place = turned.camera, turned.meta["degraded"]["window_px"]
    assert (window.cx + place["left"], window.cy + place["top"]) == (PINHOLE.cx, PINHOLE.cy)
    assert (window.fx, window.fy) == (PINHOLE.fx, PINHOLE.fy) and window.width_px < WIDTH
    rows = slice(place["top"], place["top"] + window.height_px)
    columns = slice(place["left"], place["left"] + window.width_px)
    for frame in (0, 3, 16, 19):
        np.testing.assert_array_equal(turned.frames[frame], sequence.frames[frame][rows, columns])
    (segment,) = turned.segments
    assert 4 < segment.first_frame < segment.last_frame < 16
    assert turned.frame_truth["swing_degps"].max() == pytest.approx(80, rel=0.1)


@pytest.mark.parametrize(("lens", "axis"), [("pinhole", "yaw"), ("radtan", "pitch"), ("pinhole", "roll")])
def test_nothing_is_filled_in_at_the_borders(tmp_path, lens, axis):
    framed = np.full((HEIGHT, WIDTH), 200, np.uint8)
    framed[[0, -1]] = framed[:, [0, -1]] = 0
    text = f"fast_rotation:start_s=0.2,duration_s=0.6,rate_degps=70,axis={axis}"
    turned = degrade(recording([framed] * 20, CAMERAS[lens]), tmp_path, text)
    # At the turning point a repeated or an invented border would be dark.
    assert (turned.frames[10] == 200).all()


def test_depth_turns_with_the_camera(tmp_path):
    wall = np.full((HEIGHT, WIDTH), 3.0, np.float32)
    frames = [np.zeros((HEIGHT, WIDTH), np.uint8)] * 20
    sequence = recording(frames, depths=Frames([wall] * 20), T_world_cam=WALK)
    turned = degrade(sequence, tmp_path, "fast_rotation:start_s=0.2,duration_s=0.6,rate_degps=80")
    assert turned.depths is not None and turned.T_world_cam is not None
    y, x = np.mgrid[: turned.camera.height_px, : turned.camera.width_px]
    rays = np.stack([x - turned.camera.cx, y - turned.camera.cy, np.full(x.shape, PINHOLE.fx)], -1)
    rays = rays / (PINHOLE.fx, PINHOLE.fy, PINHOLE.fx)
    for frame in (2, 10):
        ahead = rays @ turned.T_world_cam[frame][2, :3]
        np.testing.assert_allclose(turned.depths[frame], 3 / ahead, rtol=1e-4)


def test_a_turn_that_leaves_too_little_names_the_rate_that_fits():
    sequence = recording([np.zeros((HEIGHT, WIDTH), np.uint8)] * 20)
    text = "fast_rotation:start_s=0.2,duration_s=0.6,rate_degps={}"
    with pytest.raises(InputError, match="leaves less than half") as caught:
        check_recorded_sequence(sequence, [parse_segment(text.format(400))])
    fits = float(caught.value.remedy.split("rate_degps = ")[1].split(",")[0])
    assert 40 < fits < 400
    check_recorded_sequence(sequence, [parse_segment(text.format(fits))])


# -- longer shutters

PATTERN = (0.35 + 0.1 * smooth_noise((HEIGHT, 2 * WIDTH), 1.5)).clip(0, 1)


def shifted(px: float) -> np.ndarray:
    """(H, W) float32 light of the pattern, moved to the left."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    return cv2.remap(PATTERN, x + np.float32(20 + px), y, cv2.INTER_CUBIC)


def test_blur_of_a_scene_at_rest_changes_nothing(tmp_path):
    still = encode(shifted(0))
    blurred = degrade(
        recording([still] * 20), tmp_path, "motion_blur:start_s=0.3,duration_s=0.3,exposure_s=0.2"
    )
    assert all(np.array_equal(frame, still) for frame in blurred.frames)
    assert blurred.segments[0].first_frame == -1


@pytest.mark.parametrize("intervals", [0.6, 3])
def test_blur_is_the_light_averaged_along_the_motion(tmp_path, intervals):
    speed_px, exposure_s = 5.0, intervals / FPS
    sequence = recording([encode(shifted(speed_px * k)) for k in range(20)])
    blurred = degrade(sequence, tmp_path, f"motion_blur:start_s=0.3,duration_s=0.3,exposure_s={exposure_s:g}")
    inside = np.s_[12:-12, 30:-30]
    for frame in (6, 8, 11):
        path_px = speed_px * (frame + intervals * (np.linspace(0, 1, 60) - 0.5))
        true = encode(np.mean([shifted(px) for px in path_px], axis=0))[inside].astype(int)
        error = np.abs(blurred.frames[frame][inside] - true)
        sharp = np.abs(sequence.frames[frame][inside] - true)
        assert error.mean() < 0.2 * sharp.mean()
        assert blurred.frame_truth["blur_px"][frame] == pytest.approx(intervals * speed_px, rel=0.05)
    for frame in (5, 12):
        np.testing.assert_array_equal(blurred.frames[frame], sequence.frames[frame])


def test_a_turn_under_an_open_shutter_smears(tmp_path):
    sequence = recording([encode(shifted(0))] * 20)
    turn = "fast_rotation:start_s=0.2,duration_s=0.6,rate_degps=80"
    both = degrade(sequence, tmp_path, turn, "motion_blur:start_s=0.2,duration_s=0.6,exposure_s=0.02")
    blur_px = both.frame_truth["blur_px"]
    fastest = int(both.frame_truth["swing_degps"].argmax())
    expected_px = np.radians(both.frame_truth["swing_degps"][fastest]) * 0.02 * PINHOLE.fx
    assert expected_px < blur_px[fastest] < 1.3 * expected_px
    assert blur_px[10] < 0.3 * blur_px[fastest]


@pytest.mark.parametrize(
    ("times", "gap", "says"),
    [
        ("start_s=0.05,duration_s=0.3,exposure_s=0.2", 0, ["before the first frame", "start it at 0.1 s"]),
        ("start_s=0.5,duration_s=0.5,exposure_s=0.2", 0, ["after the last frame", "end it by 0.85 s"]),
        ("start_s=0.3,duration_s=0.3,exposure_s=1", 0, ["longer than the sequence", "less than 0.95"]),
        ("start_s=0.3,duration_s=0.3,exposure_s=0.1", 0.4, ["no frames from 0.450 to 0.900 s"]),
    ],
)
def test_a_shutter_that_is_open_without_frames_is_refused(times, gap, says):
    sequence = recording([np.zeros((HEIGHT, WIDTH), np.uint8)] * 20)
    stamps_s = sequence.stamps_s + gap * (np.arange(20) >= 10)
    with pytest.raises(InputError) as caught:
        check_recorded_sequence(replace(sequence, stamps_s=stamps_s), [parse_segment(f"motion_blur:{times}")])
    assert all(word in str(caught.value) for word in says), str(caught.value)


# -- fading detail


def detail(image: np.ndarray, of: np.ndarray) -> np.ndarray:
    """Light of an image relative to the local mean of another."""
    width_px = np.tan(np.radians(DETAIL_DEG)) * PINHOLE.fx
    return decode(image) - cv2.GaussianBlur(decode(of), (0, 0), width_px)


@pytest.mark.parametrize("contrast", [0.5, 0.1])
def test_the_contrast_that_remains_is_the_one_asked_for(tmp_path, contrast):
    light = 0.3 + 0.06 * smooth_noise((HEIGHT, WIDTH), 6)
    sequence = recording([encode(light)] * 20)
    faded = degrade(sequence, tmp_path, f"low_texture:start_s=0.3,duration_s=0.3,contrast={contrast}")
    before, after = (detail(of.frames[8], sequence.frames[8]) for of in (sequence, faded))
    assert (before * after).sum() / (before**2).sum() == pytest.approx(contrast, rel=0.01)
    # The rest is noise and rounding.
    assert 255 * (after - contrast * before).std() < 1
    assert decode(faded.frames[8]).mean() == pytest.approx(light.mean(), rel=0.01)
    assert [(s.first_frame, s.last_frame) for s in faded.segments] == [(6, 11)]
    for frame in (5, 12):
        np.testing.assert_array_equal(faded.frames[frame], sequence.frames[frame])


def test_noise_stays_where_detail_fades(tmp_path):
    rng, light = np.random.default_rng(2), 0.3 + 0.05 * smooth_noise((HEIGHT, WIDTH), 8)
    frames = [
        np.clip(np.rint(encode(light) + 2 * rng.standard_normal(light.shape)), 0, 255).astype(np.uint8)
        for _ in range(20)
    ]
    faded = degrade(recording(frames), tmp_path, "low_texture:start_s=0.3,duration_s=0.3,contrast=0")
    assert noise_level(frames[8]) == pytest.approx(2, rel=0.1)
    assert noise_level(faded.frames[8]) == pytest.approx(noise_level(frames[8]), rel=0.1)
    assert not np.array_equal(faded.frames[8], faded.frames[9])


# -- all of them

ALL = (
    "fast_rotation:start_s=0.2,duration_s=0.4,rate_degps=60",
    "motion_blur:start_s=0.3,duration_s=0.2,exposure_s=0.08",
    "low_texture:start_s=0.4,duration_s=0.3,contrast=0.2",
    "frame_drops:start_s=0.5,duration_s=0.3,share=0.5",
)


def test_the_same_bits_for_the_same_seed_whatever_the_threads(tmp_path):
    sequence = recording([encode(shifted(3.0 * k)) for k in range(20)], T_world_cam=WALK)
    threads, found = cv2.getNumThreads(), []
    try:
        for run, (count, seed) in enumerate(((1, 5), (4, 5), (1, 6))):
            cv2.setNumThreads(count)
            (tmp_path / str(run)).mkdir()
            found.append(degrade(sequence, tmp_path / str(run), *ALL, seed=seed))
    finally:
        cv2.setNumThreads(threads)
    one, same, other = ([frame.tobytes() for frame in run.frames] for run in found)
    assert one == same != other
    assert len({len(run.stamps_s) for run in found} | {len(found[0].T_world_cam)}) == 1
    assert found[0].segments == found[1].segments
