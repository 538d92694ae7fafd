"""A recording holds every part of its systems side by side and stays small."""

import dataclasses
import json
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from slam_fakes import CAMERA, FakeSystem, fake_factory, make_sequence, run_sequence

from dslab.experiments.evaluation.scene import lay_out
from dslab.experiments.recording import Recording, palette, stream
from dslab.experiments.recording.describe import describe_event
from dslab.experiments.runs.execution import execute
from dslab.scenarios.errors import InputError
from dslab.slam.core.events import Event, RelatingEvent, TrackingState
from dslab.slam.core.results import PhotometricView

PER_SYSTEM = (
    "/world/{}/camera", "/world/{}/map_0/path", "/world/{}/map_0/points", "/world/{}/map_0/keyframes",
    "/world/{}/lost", "/world/{}/recovered", "/world/{}/marks/labels",
    "/camera/{}/features", "/camera/{}/inliers", "/plots/inliers/{}", "/plots/ms/{}",
    "/slam/{}/tracking", "/events/{}",
)  # fmt: skip


class Content:
    """Content of a recording: rows, time lines and columns per entity."""

    def __init__(self, path: Path) -> None:
        self.rows: Counter = Counter()
        self.times: dict[str, set[str]] = defaultdict(set)
        self.columns: dict[str, dict[str, list]] = defaultdict(lambda: defaultdict(list))
        self._reader = RrdReader(path)
        self.fixed: dict[str, dict[str, list]] = defaultdict(dict)
        for chunk in self._reader.stream():
            if chunk.is_static:
                for name, values in chunk.to_record_batch().to_pydict().items():
                    self.fixed[chunk.entity_path][name.rsplit(":", 1)[-1]] = values
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
    for system in ("base", "dual_plus"):
        for entity in PER_SYSTEM:
            assert side_by_side.rows[entity.format(system)], entity.format(system)
    assert side_by_side.rows["/slam/dual_plus/recovery_thread_1"]
    assert side_by_side.rows["/slam/dual_plus/breakages"] == side_by_side.rows["/slam/base/breakages"] == 2
    assert side_by_side.rows["/slam/dual_plus/repairs"] and not side_by_side.rows["/slam/base/repairs"]
    assert all({"frame", "time"} == times for times in side_by_side.times.values() if times)


def test_data_common_to_the_systems_is_written_once(side_by_side):
    # 300 frames at 30 fps, 10 images a second, and those at which a state begins.
    assert 100 <= side_by_side.rows["/camera/image"] <= 106
    assert side_by_side.rows["/world/true_camera"] == 300
    assert side_by_side.rows["/injected/low_texture"] == 3


def test_the_last_sentence_is_what_the_audit_found(side_by_side):
    *_, (said,) = side_by_side.columns["/events/base"]["text"]
    assert "1 declared loss" in said and "no silent losses; no corrupted maps" in said
    assert side_by_side.columns["/events/base"]["frame"][-1] == 299


def test_no_name_needs_an_escape(side_by_side):
    assert side_by_side.rows and not [path for path in side_by_side.rows if "\\" in path]


def test_the_key_names_each_colour(side_by_side):
    ((labels,), (colors,)) = (side_by_side.fixed["/key"][name] for name in ("labels", "colors"))
    assert labels == list(palette.KEY) and len(set(colors)) == len(labels)
    assert {palette.rgba(c) for c in (palette.TRUTH, palette.LOST, palette.map_color(0))} <= set(colors)


def test_times_count_from_the_first_frame(tmp_path):
    sequence = make_sequence(60, segment=None)
    later = replace(sequence, stamps_s=sequence.stamps_s + 1305031102.25)
    content = Content(record(tmp_path, later, lambda *_: FakeSystem(sequence.T_world_cam)))
    times = content.columns["/plots/inliers/dual"]["time"]
    assert times[0].total_seconds() == 0 and times[-1].total_seconds() == pytest.approx(59 / 30, abs=1e-6)


def test_the_true_path_is_red_where_no_pose_is_known(side_by_side):
    lost = {system: lines(side_by_side, f"/world/{system}/lost") for system in ("base", "dual_plus")}
    assert lost["base"][159] == 0
    assert 19 <= lost["base"][180] < lost["base"][299] and 139 <= lost["base"][299] <= 141
    # Frames up to the new map are lost too, later ones are not.
    assert lost["dual_plus"][180] == lost["dual_plus"][299] <= 22


def lines(content: Content, entity: str) -> dict[int, int]:
    """Points drawn of an entity's lines, from frame to frame."""
    columns, drawn = content.columns[entity], {}
    for frame, strips in zip(columns["frame"], columns["strips"], strict=True):
        drawn[frame] = sum(len(s) for s in strips or [])
    return {f: drawn[max(g for g in drawn if g <= f)] for f in range(300)}


def test_the_blueprint_shows_each_system_and_opens_at_the_breakage(side_by_side):
    text = side_by_side.blueprint()
    for title in (
        "base: camera",
        "dual+: camera",
        "base: path",
        "dual+: path",
        "injected",
        "colours",
        "events",
    ):
        assert title in text, title
    # Three seconds about the breakage, 160 / 30 s, in nanoseconds: of lanes, two plots and the selection.
    assert text.count("2333333333") == text.count("8333333333") == 4


def test_the_viewer_opens_at_the_breakage_as_counted_from_the_first_frame(dslab, monkeypatch, tmp_path):
    opened = []
    monkeypatch.setattr("dslab.experiments.recording.open_viewer", lambda path, at: opened.append(at))
    (tmp_path / "recording.rrd").touch()
    breakage = {"stamp_s": 1305031106.75, "time_s": 4.5}
    (tmp_path / "summary.json").write_text(json.dumps({"breakage_list": [breakage]}))
    assert dslab("view", tmp_path)[0] == 0 and opened == [4.5]


def test_a_recording_alone_is_opened_at_its_breakage_and_a_damaged_one_at_the_start(
    dslab, monkeypatch, tmp_path
):
    opened, sequence = [], make_sequence()
    monkeypatch.setattr("dslab.experiments.recording.open_viewer", lambda path, at: opened.append(at))
    with Recording(tmp_path / "unit.rrd", sequence, ["base"]) as recording:
        build = fake_factory(sequence, breaks_at=160)
        recording.finish([execute(sequence, "base", 0, recording.watch("base"), build=build)])
    (tmp_path / "damaged.rrd").write_bytes(b"RRF")
    assert [dslab("view", tmp_path / f"{name}.rrd")[0] for name in ("unit", "damaged")] == [0, 0]
    assert opened == [pytest.approx(160 / 30), 0.0]


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


class Direct(FakeSystem):
    """A fake system that compares intensities: in its window are keyframes of the last second."""

    def photometric_view(self, image):
        if self.process_state is not TrackingState.TRACKING:
            return None
        keyframes = tuple(range(self._frame // 10 * 10, max(-1, self._frame - 30), -10))[::-1]
        pixels = np.tile(np.array([[3.0, 4.0]], np.float32), (4, 1))
        return PhotometricView(keyframes, pixels, np.array([0, -10, 40, -40], np.float32))

    def process(self, image, stamp_s):
        result = super().process(image, stamp_s)
        self.process_state = result.state
        return result


def test_a_direct_system_shows_residuals_and_the_window(tmp_path):
    sequence = make_sequence()
    build = lambda kind, *_: Direct(sequence.T_world_cam, kind=kind, breaks_at=160)  # noqa: E731
    content = Content(record(tmp_path, sequence, build))
    rows = content.columns["/camera/dual/residuals"]
    colors = dict(zip(rows["frame"], rows["colors"], strict=True))
    green, yellow, red = (
        palette.rgba(c) for c in (palette.INLIER, palette.DIRECT_KEY["residual 10 of 255"], palette.LOST)
    )
    assert colors[60] == [green, yellow, red, red] and not colors[162]
    windows = content.columns["/world/dual/window"]
    shown = dict(zip(windows["frame"], windows["positions"], strict=True))
    newest = max(frame for frame in shown if frame < 160) // 10 * 10
    keyframes = [newest - 20, newest - 10, newest]
    np.testing.assert_allclose(
        shown[max(f for f in shown if f < 160)], sequence.T_world_cam[keyframes, :3, 3], atol=1e-5
    )
    assert not shown[160]
    curve = content.columns["/plots/residual/dual"]
    values = dict(zip(curve["frame"], np.ravel(curve["scalars"]), strict=True))
    assert values[63] == pytest.approx(np.sqrt(np.mean([0, 100, 1600, 1600]))) and np.isnan(values[162])
    assert 60 not in values  # a keyframe
    ((labels,),) = (content.fixed["/key"]["labels"],)
    assert labels == [*palette.KEY, *palette.DIRECT_KEY]
    assert "residuals" in content.blueprint() and not content.rows["/camera/dual/inliers"]


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


def test_a_writer_that_has_ended_without_a_word_is_not_waited_for(tmp_path, monkeypatch):
    class Stuck:
        inner = object()

        def flush(self, timeout_sec):
            raise RuntimeError("Flush timed out - not all log messages were sent")

        def disconnect(self):
            raise AssertionError("would wait for ever")

    left = []
    monkeypatch.setattr(stream.atexit, "unregister", left.append)
    opened = stream.Stream(tmp_path / "x.rrd", "x", np.arange(3.0))
    opened._rec.disconnect()
    opened._rec = Stuck()
    with pytest.raises(OSError, match="rrd"):
        opened.close(failed=False)
    assert left == [rr.rerun_shutdown]


def test_the_estimate_is_aligned_to_the_truth_for_display():
    sequence = make_sequence()
    run = execute(sequence, "dual", 0, build=fake_factory(sequence, breaks_at=160, recovers=False))
    scene = lay_out(run)
    assert set(scene.final) == {0, 1}
    for trajectory in scene.final.values():
        truth = sequence.T_world_cam[trajectory.frames]
        np.testing.assert_allclose(trajectory.T_map_cam, truth, atol=1e-9)
    assert scene.up.tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    ("breaks_at", "begin", "color"), [(None, "map 0 init", palette.PLAIN), (160, "breakage", palette.LOST)]
)
def test_events_read_as_sentences(breaks_at, begin, color):
    sequence = make_sequence()
    run = execute(sequence, "base", 0, build=fake_factory(sequence, breaks_at=breaks_at))
    text, found = describe_event(run.events[-1])
    assert found == color and text.startswith(begin) and "_" not in text


def test_every_kind_of_event_is_a_short_line_without_names_of_fields():
    given = {str: "too_few_inliers", int: 7, float: 0.5, bool: True}
    for kind in [*Event.__subclasses__(), *RelatingEvent.__subclasses__()]:
        if "kind" not in vars(kind):
            continue
        fields = {
            field.name: given.get(field.type, None if "None" in str(field.type) else ())
            for field in dataclasses.fields(kind)
        }
        for judged in (True, False):
            values = {name: judged if value is True else value for name, value in fields.items()}
            text, _ = describe_event(kind(**values))
            assert " " in text and len(text) < 80 and not {"_", "{", "None"} & set(text.split() + list(text))


@pytest.mark.filterwarnings("ignore:.*left out")
def test_frames_after_an_unreadable_one_have_their_own_times(tmp_path):
    sequence = make_sequence()

    class Damaged:
        def __len__(self):
            return len(sequence)

        def __getitem__(self, index):
            if index == 50:
                raise InputError("rgb/50.png", "cannot be decoded", "replace it")
            return sequence.frames[index]

    content = Content(record(tmp_path, replace(sequence, frames=Damaged()), fake_factory(sequence)))
    times_s = (sequence.stamps_s - sequence.stamps_s[0])[np.arange(len(sequence)) != 50]
    for entity in ("/camera/dual/features", "/plots/inliers/dual"):
        frames, of_frames = (content.columns[entity][line] for line in ("frame", "time"))
        assert max(frames) > 60
        for frame, time in zip(frames, of_frames, strict=True):
            assert time.total_seconds() == pytest.approx(times_s[frame], abs=1e-5)
