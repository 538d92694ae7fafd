"""A moment of a run is drawn from its result folder: frame and features of the recording, path so far."""

import json
import shutil

import cv2
import numpy as np
import pytest
from slam_fakes import fake_factory, make_sequence

from dslab.experiments.pictures.moment_picture import frame_at
from dslab.experiments.recording.recorded_frame import recorded_frame
from dslab.experiments.result_folder import run_systems
from dslab.experiments.runs.execution import execute
from dslab.experiments.runs.read_back import read_record, until


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a run of two systems that break at frame 160, and the first one's record."""
    sequence, folder = make_sequence(), tmp_path_factory.mktemp("moment")
    build = fake_factory(sequence, breaks_at=160)
    run_systems(sequence, ["dual", "base"], 0, folder, recording=True, build=build)
    return folder, execute(sequence, "dual", 0, build=build)


def test_a_result_folder_says_again_what_the_run_was(made):
    folder, record = made
    read = read_record(folder / "dual")
    assert [(r.state, r.inliers, r.reason) for r in read.results] == (
        [(r.state, r.inliers, r.reason) for r in record.results]
    )
    assert [(e.kind, e.frame) for e in read.events] == [(e.kind, e.frame) for e in record.events]
    (path,), (own,) = read.trajectories, record.trajectories
    np.testing.assert_array_equal(path.frames, own.frames)
    np.testing.assert_allclose(path.T_map_cam, own.T_map_cam, atol=1e-8)
    np.testing.assert_allclose(read.sequence.T_world_cam, record.sequence.T_world_cam, atol=1e-8)
    assert [s.first_frame for s in read.sequence.segments] == [150]


def test_what_comes_later_is_left_out(made):
    early = until(read_record(made[0] / "dual"), 160)
    assert len(early.results) == 161 and early.trajectories[0].frames.max() <= 160
    assert {e.frame for e in early.events if e.frame > 155} == {160}


def test_the_frame_is_the_recorded_one_with_its_features(made):
    shown = recorded_frame(made[0] / "recording.rrd", ["dual", "base"], 160)
    assert shown.frame == 160 and shown.image.ndim == 2 and set(shown.features) == {"dual", "base"}
    early = recorded_frame(made[0] / "recording.rrd", ["dual"], 100)
    assert abs(early.frame - 100) <= 2 and len(early.inliers["dual"]) > 0


@pytest.mark.parametrize("at", ["fusion", "3.2"])
def test_a_moment_is_a_png_without_a_display(dslab, made, tmp_path, monkeypatch, at):
    monkeypatch.delenv("DISPLAY", raising=False)
    code, out, _ = dslab("picture", made[0], "--at", at, "--out", tmp_path / "m.png")
    assert code == 0 and "frame " in out
    assert cv2.imread(str(tmp_path / "m.png")).std() > 10


def test_without_a_moment_it_is_the_first_breakage_or_the_end(dslab, made, tmp_path):
    shutil.copytree(made[0] / "base", tmp_path / "whole")
    (tmp_path / "whole" / "events.jsonl").write_text("")
    for folder, said in ((made[0], "frame 160"), (tmp_path / "whole", "frame 299")):
        code, out, _ = dslab("picture", folder, "--out", tmp_path / "m.png")
        assert code == 0 and said in out


def test_a_run_without_a_recording_is_drawn_without_a_frame(dslab, made, tmp_path):
    shutil.copytree(made[0] / "base", tmp_path / "base")
    (tmp_path / "base" / "groundtruth.txt").unlink()
    code, _, err = dslab("picture", tmp_path / "base", "--at", "9", "--out", tmp_path / "m.png")
    assert code == 0 and "run with --rerun" in err and (tmp_path / "m.png").is_file()


def test_systems_that_dropped_frames_of_their_own_are_drawn_at_one_time(dslab, tmp_path):
    """One had every third frame: the moment is beyond its last number, and at another one."""
    sequence = make_sequence(120, segment=None)
    for name, system in (("all", "base"), ("few", "dual")):
        kept = sequence.only(np.arange(0, len(sequence), 1 if name == "all" else 3))
        (tmp_path / "run" / name).mkdir(parents=True)
        run_systems(kept, [system], 0, tmp_path / "run" / name, build=fake_factory(kept, breaks_at=30))
    records = {name: read_record(tmp_path / "run" / name) for name in ("all", "few")}
    stamp_s = records["all"].sequence.stamps_s[96]
    assert [frame_at(record, stamp_s) for record in records.values()] == [96, 32]
    code, _, err = dslab("picture", tmp_path / "run", "--at", "3.2", "--out", tmp_path / "m.png")
    assert code == 0, err


def test_runs_over_several_sequences_are_no_moment(dslab, made, tmp_path):
    for name in ("one", "two"):
        shutil.copytree(made[0] / "base", tmp_path / name)
    summary = tmp_path / "two" / "summary.json"
    summary.write_text(json.dumps(json.loads(summary.read_text()) | {"sequence": "other"}))
    code, _, err = dslab("picture", tmp_path, "--out", tmp_path / "m.png")
    assert code == 2 and "several sequences" in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--at", "fusion"], "there is no fusion in this run"),
        (["--at", "soon"], "give breakage, fusion or seconds"),
        (["--at", "99"], "s long"),
        (["--out", "m.jpg"], "ends in .png"),
    ],
)
def test_a_moment_that_is_none_is_one_line(dslab, made, tmp_path, words, said):
    code, _, err = dslab("picture", made[0] / "base", "--out", tmp_path / "m.png", *words)
    assert code == 2 and said in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("summary.json", '{"segments": [{"kind": 3}]}'),
        ("summary.json", "[]"),
        ("frames.csv", "frame,stamp_s\n"),
        ("frames.csv", "frame,stamp_s,state,map_id,inliers,matches,keyframe,reason\n0,0,x,0,0,0,0,\n"),
        ("events.jsonl", "{}"),
        ("trajectory.txt", "0 0 0"),
    ],
)
def test_a_damaged_folder_is_one_line(dslab, made, tmp_path, file, text):
    shutil.copytree(made[0] / "dual", tmp_path / "run")
    (tmp_path / "run" / file).write_text(text)
    code, _, err = dslab("picture", tmp_path / "run", "--out", tmp_path / "m.png")
    assert code == 2 and err.count("\n") == 1 and str(tmp_path / "run") in err
