"""A recording holds what one looks for, and stays small."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from slam_fakes import CAMERA, FakeSystem, fake_factory, make_sequence

from experiments.execution import execute
from experiments.recording import Recorder, describe_event
from experiments.run import run_sequence
from experiments.scene import lay_out

RERUN = str(Path(sys.executable).with_name("rerun"))


def record(tmp_path, sequence, **script) -> Path:
    build = fake_factory(sequence, **script) if sequence.T_world_cam is not None else script["build"]
    run_sequence(sequence, "dual", 0, tmp_path / "r", recording=True, build=build)
    return tmp_path / "r" / "recording.rrd"


def dump(path: Path) -> str:
    done = subprocess.run([RERUN, "rrd", "print", str(path)], capture_output=True, text=True, check=True)
    return done.stdout + done.stderr


def test_a_recording_has_every_part_on_both_timelines(tmp_path):
    text = dump(record(tmp_path, make_sequence(), breaks_at=160))
    for entity in (
        "/world/camera/image", "/world/camera/features", "/world/true_path", "/world/true_camera",
        "/world/map_0/path", "/world/map_0/points", "/world/map_0/keyframes", "/world/final_path/map_0",
        "/plots/inliers/inliers", "/plots/cpu_ms/tracking", "/plots/cpu_ms/mapping",
        "/lanes/state", "/lanes/segment", "/lanes/map", "/events",
    ):  # fmt: skip
        assert entity in text, entity
    assert "frame" in text and "time" in text and "log_tick" not in text


def test_without_truth_there_is_no_true_path(tmp_path):
    sequence = make_sequence(100, truth=True, segment=None)
    blind = replace(sequence, T_world_cam=None)
    text = dump(record(tmp_path, blind, build=lambda *_: FakeSystem(sequence.T_world_cam)))
    assert "/world/map_0/path" in text and "/world/true_path" not in text


def test_a_minute_of_video_stays_under_60_mb(tmp_path):
    rng = np.random.default_rng(0)
    # Two seconds stand for the minute; blurred noise packs no better than a richly textured world.
    noise = rng.integers(0, 256, (480, 640), dtype=np.uint8)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX)
    frames = [np.roll(texture, 7 * i, axis=1) for i in range(60)]
    sequence = make_sequence(60, segment=None)
    camera = replace(CAMERA, width_px=640, height_px=480)
    path = record(tmp_path, replace(sequence, frames=frames, camera=camera))
    assert 30 * path.stat().st_size < 60e6


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_recording_that_cannot_be_written_raises():
    sequence = make_sequence(30, segment=None)

    def work():
        with Recorder(Path("/dev/full"), sequence, "base") as recorder:
            recorder.finish(execute(sequence, "base", 0, recorder, build=fake_factory(sequence)))

    with pytest.raises(OSError, match="/dev/full"):
        work()


def test_the_estimate_is_laid_on_the_truth_for_display():
    sequence = make_sequence()
    run = execute(sequence, "dual", 0, build=fake_factory(sequence, breaks_at=160, recovers=False))
    scene = lay_out(run)
    assert set(scene.final) == {0, 1}
    for trajectory in scene.final.values():
        truth = sequence.T_world_cam[trajectory.frames]
        np.testing.assert_allclose(trajectory.T_map_cam, truth, atol=1e-9)
    assert scene.up.tolist() == [0, 0, 1]


@pytest.mark.parametrize(("breaks_at", "level"), [(None, "INFO"), (160, "ERROR")])
def test_events_read_as_sentences(breaks_at, level):
    sequence = make_sequence()
    run = execute(sequence, "base", 0, build=fake_factory(sequence, breaks_at=breaks_at))
    text, found = describe_event(run.events[-1])
    assert found == level
    assert text.startswith("0.17 s  frame 5" if breaks_at is None else "5.33 s  frame 160  breakage: ")
