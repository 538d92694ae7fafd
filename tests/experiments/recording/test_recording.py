"""A recording holds every part of its systems side by side and stays small."""

from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader
from slam_fakes import CAMERA, FakeSystem, fake_factory, make_sequence

from experiments.evaluation.scene import lay_out
from experiments.recording import Recording
from experiments.recording.describe import describe_event
from experiments.result_folder import run_sequence
from experiments.runs.execution import execute
from slam.core.events import PlacedKeyframe, RecoveryEnd

PER_SYSTEM = (
    "/world/{}/camera", "/world/{}/map_0/path", "/world/{}/map_0/points", "/world/{}/map_0/keyframes",
    "/world/{}/lost", "/world/{}/recovered", "/world/{}/marks", "/camera/{}/features", "/camera/{}/inliers",
    "/plots/inliers/{}", "/plots/ms/{}", "/lanes/{}/state", "/lanes/{}/events", "/lanes/{}/outcome",
    "/events/{}",
)  # fmt: skip


class Content:
    """Content of a recording: rows, time lines and columns per entity."""

    def __init__(self, path: Path) -> None:
        self.rows: Counter = Counter()
        self.times: dict[str, set[str]] = defaultdict(set)
        self.columns: dict[str, dict[str, list]] = defaultdict(lambda: defaultdict(list))
        self._reader = RrdReader(path)
        for chunk in self._reader.stream():
            if chunk.is_static:
                continue
            self.rows[chunk.entity_path] += chunk.num_rows
            self.times[chunk.entity_path] |= set(chunk.timeline_names)
            for name, values in chunk.to_record_batch().to_pydict().items():
                self.columns[chunk.entity_path][name.rsplit(":", 1)[-1]] += values

    def blueprint(self) -> str:
        """The blueprint as text."""
        (store,) = self._reader.blueprints()
        batches = [chunk.to_record_batch().to_pydict() for chunk in self._reader.stream(store=store)]
        return str(batches)


def record(tmp_path, sequence, build) -> Path:
    run_sequence(sequence, "dual", 0, tmp_path / "r", recording=True, build=build)
    return tmp_path / "r" / "recording.rrd"


@pytest.fixture(scope="module")
def side_by_side(tmp_path_factory):
    """Base and dual+ over one sequence with a breakage that only dual+ recovers from."""
    path, sequence = tmp_path_factory.mktemp("recording") / "two.rrd", make_sequence()
    build = fake_factory(sequence, breaks_at=160)
    with Recording(path, sequence, ["base", "dual+"]) as recording:
        runs = [execute(sequence, kind, 0, recording.watch(kind), build=build) for kind in ("base", "dual+")]
        recording.finish(runs)
    return Content(path)


def test_every_system_has_every_part_on_both_time_lines(side_by_side):
    for system in ("base", r"dual\+"):
        for entity in PER_SYSTEM:
            assert side_by_side.rows[entity.format(system)], entity.format(system)
    assert side_by_side.rows[r"/lanes/dual\+/recovery_1"] and not side_by_side.rows["/lanes/base/recovery_1"]
    assert all({"frame", "time"} == times for times in side_by_side.times.values() if times)


def test_data_common_to_the_systems_is_written_once(side_by_side):
    # 300 frames at 30 fps, 10 images a second, and those at which a state begins.
    assert 100 <= side_by_side.rows["/camera/image"] <= 106
    assert side_by_side.rows["/world/true_camera"] == 300
    assert side_by_side.rows["/lanes/segment"] == 3


def test_the_true_path_is_red_where_no_pose_is_known(side_by_side):
    lost = {system: lines(side_by_side, f"/world/{system}/lost") for system in ("base", r"dual\+")}
    assert lost["base"][159] == 0
    assert 19 <= lost["base"][180] < lost["base"][299] and 139 <= lost["base"][299] <= 141
    # Frames up to the new map are lost too, later ones are not.
    assert lost[r"dual\+"][180] == lost[r"dual\+"][299] <= 22


def lines(content: Content, entity: str) -> dict[int, int]:
    """Points drawn of an entity's lines, from frame to frame."""
    columns, drawn = content.columns[entity], {}
    for frame, strips in zip(columns["frame"], columns["strips"], strict=True):
        drawn[frame] = sum(len(s) for s in strips or [])
    return {f: drawn[max(g for g in drawn if g <= f)] for f in range(300)}


def test_the_blueprint_shows_each_system_and_opens_at_the_breakage(side_by_side):
    text = side_by_side.blueprint()
    for title in ("base: camera", "dual+: camera", "base: map", "dual+: map", "states", "inliers", "events"):
        assert title in text, title
    # From a second before the breakage, 160 / 30 s, in nanoseconds.
    assert "4333333333" in text


def test_without_truth_there_is_no_true_path(tmp_path):
    sequence = make_sequence(100, truth=True, segment=None)
    blind = replace(sequence, T_world_cam=None)
    content = Content(record(tmp_path, blind, lambda *_: FakeSystem(sequence.T_world_cam)))
    assert content.rows["/world/dual/map_0/path"] and not content.rows["/world/true_camera"]


def test_a_minute_of_video_with_two_systems_stays_under_60_mb(tmp_path):
    rng = np.random.default_rng(0)
    # Two seconds stand for the minute; blurred noise compresses no better than a textured world.
    noise = rng.integers(0, 256, (480, 640), dtype=np.uint8)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX)
    frames = [np.roll(texture, 7 * i, axis=1) for i in range(60)]
    sequence = make_sequence(60, segment=None)
    sequence = replace(sequence, frames=frames, camera=replace(CAMERA, width_px=640, height_px=480))
    path, build = tmp_path / "r.rrd", Rich.factory(sequence)
    with Recording(path, sequence, ["base", "dual"]) as recording:
        kinds = ("base", "dual")
        recording.finish([execute(sequence, k, 0, recording.watch(k), build=build) for k in kinds])
    assert 30 * path.stat().st_size < 60e6


class Rich(FakeSystem):
    """A fake system with as many features and map points as a real one."""

    @staticmethod
    def factory(sequence):
        return lambda kind, *_: Rich(sequence.T_world_cam, kind=kind)

    def process(self, image, stamp_s):
        pixels = self._rng.uniform(0, 470, (1000, 2)).astype(np.float32)
        inlier = np.arange(1000) % 3 == 0
        return replace(super().process(image, stamp_s), keypoints_px=pixels, inlier_mask=inlier)

    def map_points(self, map_id):
        return self._rng.normal(0, 3, (8000, 3))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_recording_that_cannot_be_written_raises():
    sequence = make_sequence(30, segment=None)

    def work():
        with Recording(Path("/dev/full"), sequence, ["base"]) as recording:
            watcher = recording.watch("base")
            recording.finish([execute(sequence, "base", 0, watcher, build=fake_factory(sequence))])

    with pytest.raises(OSError, match="/dev/full"):
        work()


def test_the_estimate_is_aligned_to_the_truth_for_display():
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


def test_an_event_with_a_list_is_one_short_line():
    pose = tuple(map(tuple, np.eye(4).tolist()))
    end = RecoveryEnd(
        frame=9, stamp_s=0.3, map_id=1, thread=1, method="orb", old_map_id=0, success=True, stage="",
        reason="", frames_covered=7, frames_passed_over=0, inliers=50, cpu_ms=3.0,
        placed=tuple(PlacedKeyframe(i, i / 30, pose) for i in range(5)),
    )  # fmt: skip
    text, _ = describe_event(end)
    assert "placed 5" in text and len(text) < 200
    assert "placed" not in describe_event(replace(end, success=False, placed=()))[0]
