"""A run's result folder: its content, its correctness, and failing runs."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from slam_fakes import FakeSystem, fake_factory, make_sequence, run_sequence

from dslab.experiments.comparison.left_runs import read_run
from dslab.experiments.runs.execution import execute
from dslab.experiments.runs.files import plain, write_frames_csv
from dslab.scenarios.errors import InputError
from dslab.slam.core.events import TrackingState
from dslab.slam.core.results import RelativePose, TrackingResult

REQUIRED = [
    "frames", "tracked", "first_tracked_frame", "maps", "keyframes", "breakages", "recoveries", "ate_m",
    "path_m", "ms_median", "cpu_ms_median", "cpu_ms_p95", "mapping_cpu_ms_median", "mapping_cpu_ms_p95",
    "peak_rss_mb", "seed", "commit", "share_tracked",
]  # fmt: skip


pytestmark = pytest.mark.usefixtures("no_picture")


@pytest.fixture(scope="module")
def sequence():
    return make_sequence()


def run(sequence, out, **script):
    return run_sequence(sequence, "dual", 3, out, build=fake_factory(sequence, **script))


def test_the_folder_holds_every_file_and_the_summary_every_figure(sequence, tmp_path):
    summary = run(sequence, tmp_path / "r", breaks_at=160, recovers=False)
    names = {p.name for p in (tmp_path / "r").iterdir()}
    assert names == {
        "trajectory.txt", "trajectory_map1.txt", "keyframes.txt", "groundtruth.txt", "frames.csv",
        "events.jsonl", "summary.json", "trajectory.png",
    }  # fmt: skip
    assert set(REQUIRED) <= set(summary)
    assert json.loads((tmp_path / "r" / "summary.json").read_text()) == summary


def test_the_deviations_of_a_pose_are_in_its_row_and_empty_where_none_are_told(tmp_path):
    nothing = np.empty(0)
    fixed = TrackingState.TRACKING, np.eye(4), 0, 40, 60, "", False, nothing, nothing
    covariance = np.diag([0.01, 0.04, 0.01, 1e-4, 1e-4, 4e-4])
    told = TrackingResult(0, 0.0, *fixed, relative=RelativePose(7, np.eye(4), covariance))
    write_frames_csv(tmp_path / "frames.csv", [told, TrackingResult(1, 0.1, *fixed)])
    first, second = csv.DictReader((tmp_path / "frames.csv").open())
    assert first["relative_to"] == "7" and float(first["position_sd"]) == pytest.approx(0.2)
    assert float(first["direction_sd_deg"]) == pytest.approx(np.rad2deg(0.02), rel=1e-4)
    assert second["relative_to"] == second["position_sd"] == second["direction_sd_deg"] == ""


def test_the_counts_of_the_summary_are_those_of_the_run(sequence, tmp_path):
    summary = run(sequence, tmp_path / "r", breaks_at=160)
    assert summary["frames"] == 300
    assert summary["first_tracked_frame"] == 5
    assert summary["tracked"] == 300 - 5 - 20
    assert (summary["breakages"], summary["recoveries"], summary["maps"]) == (1, 1, 1)
    assert summary["ate_m"] < 1e-9
    assert summary["mapping_cpu_ms_median"] == 20.0
    # CPU of the fake: 8 ms + 0.01 ms per frame.
    assert summary["cpu_ms_median"] == pytest.approx(8 + 0.01 * 149.5)
    (segment,) = summary["segments"]
    assert (segment["frames"], segment["tracked"], segment["recoveries"]) == (31, 31 - 20, 1)
    assert segment["ate_poses"] == 11
    assert summary["breakage_list"][0]["segment"] == "low_texture"


def test_one_csv_row_per_frame_with_its_times(sequence, tmp_path):
    run(sequence, tmp_path / "r", breaks_at=160)
    with (tmp_path / "r" / "frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(r["frame"]) for r in rows] == list(range(300))
    assert float(rows[7]["stamp_s"]) == pytest.approx(7 / 30)
    assert rows[10]["state"] == "tracking" and rows[10]["keyframe"] == "1"
    assert rows[165]["state"] == "not_initialized" and rows[165]["reason"] == "parallax"
    assert float(rows[100]["cpu_ms"]) == pytest.approx(9.0)
    assert float(rows[100]["cpu_ms"]) == float(rows[100]["cpu_ms_extract"]) + float(rows[100]["cpu_ms_track"])


def test_events_are_one_json_object_per_line(sequence, tmp_path):
    run(sequence, tmp_path / "r", breaks_at=160)
    events = [json.loads(line) for line in (tmp_path / "r" / "events.jsonl").read_text().splitlines()]
    assert [e["event"] for e in events] == [
        "initialized",
        "breakage",
        "reinit_done",
        "recovery_end",
        "fusion",
    ]
    assert events[1]["frame"] == 160 and events[1]["reason"] == "few_inliers"


def test_evo_reads_the_trajectory_and_finds_the_same_error(sequence, tmp_path):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    metrics = pytest.importorskip("evo.core.metrics")
    trajectory = pytest.importorskip("evo.core.trajectory")
    summary = run(sequence, tmp_path / "r", noise_m=0.02)
    estimate = file_interface.read_tum_trajectory_file(str(tmp_path / "r" / "trajectory.txt"))
    frames = np.round(estimate.timestamps * 30).astype(int)
    reference = trajectory.PoseTrajectory3D(
        poses_se3=list(sequence.T_world_cam[frames]), timestamps=sequence.stamps_s[frames]
    )
    estimate.align(reference, correct_scale=True)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, estimate))
    assert ape.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(summary["ate_m"], rel=1e-5)


def test_the_system_is_given_no_truth(sequence, tmp_path):
    seen = []

    def build(kind, camera, seed):
        seen.append((kind, camera, seed))
        return fake_factory(sequence)(kind, camera, seed)

    run_sequence(sequence, "base", 7, tmp_path / "r", build=build)
    ((kind, camera, seed),) = seen
    assert (kind, seed) == ("base", 7)
    assert type(camera).__module__ == "dslab.slam.core.camera" and camera.fx == sequence.camera.fx


def test_without_truth_the_accuracy_is_null(sequence, tmp_path):
    blind = replace(sequence, T_world_cam=None)
    summary = run_sequence(blind, "base", 0, tmp_path / "r", build=fake_factory(sequence, breaks_at=160))
    for field in ("ate_m", "path_m", "rpe_m", "audit", "path_share"):
        assert summary[field] is None
    assert summary["ate_reason"] == "no ground truth"
    assert summary["segments"][0]["ate_m"] is None
    assert summary["tracked"] == 155


def test_a_run_that_never_initialises_has_a_summary_too(sequence, tmp_path):
    summary = run(sequence, tmp_path / "r", starts_at=10_000)
    assert (summary["tracked"], summary["maps"], summary["first_tracked_frame"]) == (0, 0, None)
    assert summary["ate_m"] is None and summary["ate_reason"] == "no map"
    lines = (tmp_path / "r" / "trajectory.txt").read_text().splitlines()
    assert len(lines) == 1 and lines[0].startswith("#")


def test_poses_too_far_away_to_be_read_again_are_left_out_and_said(sequence, tmp_path):
    class Far(FakeSystem):
        def trajectories(self):
            (path,) = super().trajectories()
            path.T_map_cam[7, 0, 3] = -2e9
            return [path]

    summary = run_sequence(sequence, "base", 0, tmp_path / "run", build=lambda *_: Far(sequence.T_world_cam))
    assert (summary["ended"], summary["posed"]) == ("not_finite", len(sequence) - 5 - 1)
    assert len(read_run(tmp_path / "run").pairs) == summary["posed"]


def test_a_run_that_fails_leaves_no_folder(sequence, tmp_path):
    with pytest.raises(RuntimeError, match="told to fail"):
        run(sequence, tmp_path / "r", fails_at=100)
    assert list(tmp_path.iterdir()) == []


def test_an_unreadable_frame_is_bad_input_and_leaves_no_folder(sequence, tmp_path):
    class Broken:
        def __len__(self):
            return 300

        def __getitem__(self, index):
            raise InputError(f"rgb/{index}.png", "cannot be decoded", "replace it")

    with pytest.raises(InputError, match=r"rgb/0\.png"):
        run_sequence(
            replace(sequence, frames=Broken()), "base", 0, tmp_path / "r", build=fake_factory(sequence)
        )
    assert list(tmp_path.iterdir()) == []


def test_progress_counts_every_frame(sequence):
    told = []
    execute(sequence, "base", 0, progress=lambda *p: told.append(p), build=fake_factory(sequence))
    assert told == [(i + 1, 300) for i in range(300)]


def test_plain_values_are_strict_json():
    value = {"a": np.float64("nan"), "b": np.arange(2), "c": (1, float("inf")), 3: np.bool_(True)}
    assert plain(value) == {"a": None, "b": [0, 1], "c": [1, None], "3": True}
