"""Degradations of recorded footage act on its colours; what is tracked is made gray of the result."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from io_sequences import PINHOLE, make_sequence

from dslab.scenarios.segment_text import parse_segment
from dslab.sim.degradations.recorded_sequences import degrade_sequence
from dslab.sim.io.forms import Form, load_sequence, write_sequence
from dslab.sim.sequence import InColour, Sequence, colour_frame

COUNT, SIDE = 6, (48, 64)
BRIGHTER = "over_exposure:start_s=0.05,duration_s=0.1,stops=2"
KINDS = [
    BRIGHTER,
    "motion_blur:start_s=0.05,duration_s=0.05,exposure_s=0.06",
    "low_texture:start_s=0.05,duration_s=0.1,contrast=0.3",
    "fast_rotation:start_s=0.05,duration_s=0.1,rate_degps=30",
    "low_light:start_s=0.05,duration_s=0.1,illumination=0.1,gain=4",
    "jpeg:start_s=0.05,duration_s=0.1,quality=10",
    "bandwidth_loss:start_s=0.05,duration_s=0.1,share=0.9",
]


def scene(colour: bool) -> list[np.ndarray]:
    """A patterned wall that moves; in colour its blue is dark and its red is bright."""
    rng = np.random.default_rng(0)
    wall = cv2.GaussianBlur(rng.integers(0, 256, (80, 120), np.uint8), (0, 0), 2)
    wall = cv2.normalize(wall, None, 40, 120, cv2.NORM_MINMAX)
    shown = [wall[10 : 10 + SIDE[0], 3 * n : 3 * n + SIDE[1]] for n in range(COUNT)]
    tint = (0.3, 0.8, 2.0) if colour else (1, 1, 1)
    return [np.dstack([np.clip(image * share, 0, 255).astype(np.uint8) for share in tint]) for image in shown]


def recorded(folder, images, suffix=".png") -> Sequence:
    """A folder in TUM form with these images."""
    written = replace(make_sequence(), camera=PINHOLE, depths=None, segments=(), frame_truth={}, meta={})
    write_sequence(written, folder, Form.TUM)
    listed = (folder / "rgb.txt").read_text()
    (folder / "rgb.txt").write_text(listed.replace(".png", suffix))
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / f"rgb/{number:06d}{suffix}"), image)
    return load_sequence(folder)


@pytest.fixture
def degraded(tmp_path):
    """Degrade a scene in colour, or gray in three channels or one."""

    def degrade(text: str, images, **options) -> tuple[Sequence, Sequence]:
        number = len(list(tmp_path.iterdir()))
        source = recorded(tmp_path / f"source{number}", images, options.pop("suffix", ".png"))
        scratch = tmp_path / f"scratch{number}"
        scratch.mkdir()
        return source, degrade_sequence(source, [parse_segment(text)], 0, scratch, **options)

    return degrade


def test_a_channel_saturates_by_itself_before_the_frame_is_made_gray(degraded):
    _, colour = degraded(BRIGHTER, scene(colour=True))
    shown = colour_frame(colour.frames, 3)
    assert shown.shape == (*SIDE, 3) and (shown[..., 2] == 255).mean() > 0.3
    assert shown[..., 0].max() < 255
    _, gray = degraded(BRIGHTER, [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in scene(colour=True)])
    # Of gray frames, red and blue get four times as bright together: here red cannot.
    assert gray.frames[3].mean() - colour.frames[3].mean() > 5


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_frames_before_the_stress_keep_their_gray_levels(degraded, suffix):
    source, colour = degraded(BRIGHTER, scene(colour=True), suffix=suffix)
    for frame in (0, 1, 5):
        np.testing.assert_array_equal(colour.frames[frame], source.frames[frame])
        np.testing.assert_array_equal(colour_frame(colour.frames, frame), colour_frame(source.frames, frame))


@pytest.mark.parametrize("text", KINDS)
def test_gray_in_three_channels_is_degraded_as_gray_bit_for_bit(degraded, text):
    images = scene(colour=False)
    _, one = degraded(text, [image[..., 0] for image in images])
    _, three = degraded(text, images)
    for frame in range(COUNT):
        np.testing.assert_array_equal(one.frames[frame], three.frames[frame])


@pytest.mark.parametrize("text", KINDS)
def test_a_degraded_folder_keeps_its_colour_and_is_read_as_what_was_degraded(degraded, tmp_path, text):
    source, colour = degraded(text, scene(colour=True))
    write_sequence(colour, tmp_path / "out", Form.TUM)
    read = load_sequence(tmp_path / "out")
    for frame in range(COUNT):
        np.testing.assert_array_equal(read.frames[frame], colour.frames[frame])
        np.testing.assert_array_equal(colour_frame(read.frames, frame), colour_frame(colour.frames, frame))
    assert InColour(read.frames).is_coloured
    whole = source.frames[2].shape == colour.frames[2].shape
    assert not whole or not np.array_equal(source.frames[2], colour.frames[2])


def test_the_channels_of_a_noisy_frame_have_noise_of_their_own(degraded):
    even = [np.full((*SIDE, 3), (60, 60, 61), np.uint8)] * COUNT
    _, dark = degraded("low_light:start_s=0.05,duration_s=0.1,illumination=0.1,gain=4", even)
    blue, green, _ = np.moveaxis(colour_frame(dark.frames, 3).astype(float), -1, 0)
    assert blue.std() > 1 and abs(np.corrcoef(blue.ravel(), green.ravel())[0, 1]) < 0.1


def test_frames_in_colour_are_kept_only_if_asked_for(degraded):
    _, kept = degraded(BRIGHTER, scene(colour=True))
    _, gray = degraded(BRIGHTER, scene(colour=True), colour=False)
    np.testing.assert_array_equal(gray.frames[3], kept.frames[3])
    assert InColour(kept.frames).is_coloured and not InColour(gray.frames).is_coloured


def test_kitti_has_frames_in_colour_under_their_own_name(tmp_path):
    source = recorded(tmp_path / "source", scene(colour=True))
    write_sequence(replace(source, T_world_cam=None), tmp_path / "kitti", Form.KITTI)
    read = load_sequence(tmp_path / "kitti")
    assert (tmp_path / "kitti/image_2/000000.png").is_file() and read.camera.K.tolist() == PINHOLE.K.tolist()
    np.testing.assert_array_equal(colour_frame(read.frames, 1), colour_frame(source.frames, 1))
    np.testing.assert_array_equal(read.frames[1], source.frames[1])


def test_a_video_is_degraded_in_colour(tmp_path):
    path, fps = tmp_path / "walk.avi", 30.0
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, SIDE[::-1])
    for image in scene(colour=True):
        video.write(image)
    video.release()
    (tmp_path / "camera.yaml").write_text("fx: 50\nfy: 50\ncx: 30\ncy: 20\nwidth: 64\nheight: 48\nfps: 30\n")
    source = load_sequence(path, tmp_path / "camera.yaml")
    assert [colour_frame(source.frames, n)[..., 2].mean() > 100 for n in (0, 5, 1)] == [True] * 3
    np.testing.assert_array_equal(
        cv2.cvtColor(colour_frame(source.frames, 4), cv2.COLOR_BGR2GRAY), source.frames[4]
    )
    blurred = degrade_sequence(source, [parse_segment(BRIGHTER)], 0, tmp_path)
    assert (colour_frame(blurred.frames, 3)[..., 2] == 255).mean() > 0.3
    np.testing.assert_array_equal(blurred.frames[0], source.frames[0])


def test_a_long_exposure_decodes_a_video_in_order(tmp_path, monkeypatch):
    """From the beginning for the look at its colours, for the noise level and for the frames, no more."""
    path = tmp_path / "walk.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, SIDE[::-1])
    for image in scene(colour=True) * 5:
        video.write(image)
    video.release()
    (tmp_path / "camera.yaml").write_text("fx: 50\nfy: 50\ncx: 30\ncy: 20\nwidth: 64\nheight: 48\nfps: 30\n")
    source, opened = load_sequence(path, tmp_path / "camera.yaml"), []
    capture = cv2.VideoCapture
    monkeypatch.setattr(cv2, "VideoCapture", lambda *given: opened.append(1) or capture(*given))
    text = "motion_blur:start_s=0.3,duration_s=0.4,exposure_s=0.4"
    degrade_sequence(source, [parse_segment(text)], 0, tmp_path)
    assert len(opened) <= 4
