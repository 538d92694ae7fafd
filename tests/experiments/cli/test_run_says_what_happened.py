"""`dslab run` says what happened: every breakage, its cause and end, the audit; of one system or several."""

import json
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from slam_fakes import fake_factory, make_sequence

from dslab.experiments.cli import console, run_tables
from dslab.experiments.cli.run_tables import breakage_table
from dslab.experiments.cli.view import view_command
from dslab.experiments.evaluation.audit_text import audit_text
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.runs import slam_settings, sources
from dslab.experiments.runs.execution import execute
from dslab.slam.core.events import Breakage


def summary_of(kind="dual", sequence=None, **script):
    sequence = sequence or make_sequence()
    return summarise(execute(sequence, kind, 0, build=fake_factory(sequence, **script)))


@pytest.fixture
def run_fake(dslab, monkeypatch, no_picture, tmp_path):
    """`dslab run` of the fake system over a synthetic sequence, into tmp_path / "r"."""

    def run(*words, columns=80, truth=True, **script):
        sequence = make_sequence()
        shown = sequence if truth else replace(sequence, T_world_cam=None)
        monkeypatch.setattr(sources, "open_sequence", lambda *_, **__: shown)
        monkeypatch.setattr(slam_settings, "factory_of", lambda _: fake_factory(sequence, **script))
        monkeypatch.setenv("COLUMNS", str(columns))
        return dslab("run", "x", "--out", tmp_path / "r", *words)

    return run


def cells(table) -> list[list[str]]:
    return list(map(list, zip(*(column._cells for column in table.columns), strict=True)))


def test_a_row_says_when_why_and_where_it_broke_and_by_which_thread_it_was_recovered():
    (row,) = cells(breakage_table({"dual": summary_of(breaks_at=160)}))
    declared, lost, during, cause, end = (" ".join(str(cell).split()) for cell in row)
    assert declared == lost == "5.33 s frame 160"
    assert during == "low texture 5-6 s" and "_" not in cause
    assert "thread 1 (orb)" in end and "6.00 s" in end and "right by the truth" in end


def test_what_was_relocalized_or_never_repaired_is_said():
    (found,) = cells(breakage_table({"": summary_of("base", breaks_at=160, relocalizes_after=30)}))
    assert found[-1].startswith("relocalized at 6.33 s, 1.00 s later")
    (never,) = cells(breakage_table({"": summary_of("base", breaks_at=160)}))
    assert never[-1].startswith("never repaired")
    (tried,) = cells(breakage_table({"": summary_of(breaks_at=160, recovers=False)}))
    assert "no common points" in tried[-1] and "new map from frame 180" in tried[-1]


def test_a_late_declaration_shows_when_the_pose_was_truly_lost():
    summary = summary_of("base", breaks_at=177, drift_from=155)
    (row,) = cells(breakage_table({"": summary}))
    frames = [int(cell.split()[-1]) for cell in row[:2]]
    assert frames[0] == 177 and 155 <= frames[1] <= 160
    assert f"{(177 - frames[1]) / 30:.2f} s after" in audit_text(summary)


def test_a_silent_loss_has_a_row_and_is_counted():
    summary = summary_of("base", drift_from=160)
    (row,) = cells(breakage_table({"": summary}))
    assert row[0] == "never" and "silent" in row[-1]
    assert "1 silent loss" in audit_text(summary)
    assert "no silent loss" in audit_text(summary_of("base"))


def test_a_false_repair_is_called_false():
    summary = summary_of(breaks_at=160, new_map_scale=1.4)
    ((*_, end),) = cells(breakage_table({"": summary}))
    assert "FALSE" in end and "scale +40 %" in end
    assert "1 false fusion of 1 (at 6.00 s)" in audit_text(summary)


def test_times_count_from_the_first_frame():
    sequence = make_sequence()
    late = replace(sequence, stamps_s=sequence.stamps_s + 1.4e9)
    (row,) = cells(breakage_table({"": summary_of(sequence=late, breaks_at=160)}))
    assert row[0].split()[0] == "5.33" and "6.00 s" in row[-1]


@pytest.mark.parametrize("columns", [80, 50])
@pytest.mark.parametrize("system", ["dual", "base,dual,dual+"])
def test_nothing_is_cut_or_wider_than_the_terminal(run_fake, system, columns):
    code, out, _ = run_fake("--system", system, columns=columns, breaks_at=160)
    tables = out[: out.index("picture  ")]
    assert code == 0 and "…" not in tables and "None" not in tables
    assert max(map(len, tables.splitlines())) <= columns


def test_what_never_starts_and_has_no_truth_is_said_without_none(run_fake):
    code, out, _ = run_fake(truth=False, starts_at=10_000)
    assert code == 0 and "None" not in out
    assert "never initialized" in out and "no ground truth" in out


def test_what_kept_a_system_from_starting_is_said_with_what_to_try(dslab, tmp_path):
    (tmp_path / "night").mkdir()
    for n in range(12):
        cv2.imwrite(str(tmp_path / "night" / f"{n}.png"), np.zeros((64, 96), np.uint8))
    (tmp_path / "camera.yaml").write_text(
        "{fx: 80, fy: 80, cx: 47.5, cy: 31.5, width: 96, height: 64, fps: 20}"
    )
    code, out, _ = dslab(
        "run", tmp_path / "night", "--camera", tmp_path / "camera.yaml", "--out", tmp_path / "o"
    )
    said = " ".join(out.split())
    assert code == 0 and "never initialized, too few keypoints in 12 of 12 frames" in said
    assert "try larger, brighter or sharper ones" in said


def test_a_damaged_image_in_the_middle_is_left_out_and_counted(dslab, tmp_path):
    (tmp_path / "walk").mkdir()
    for n in range(12):
        cv2.imwrite(str(tmp_path / "walk" / f"{n:02d}.png"), np.zeros((64, 96), np.uint8))
    (tmp_path / "walk" / "06.png").write_bytes((tmp_path / "walk" / "06.png").read_bytes()[:-20])
    camera = tmp_path / "camera.yaml"
    camera.write_text("{fx: 80, fy: 80, cx: 47.5, cy: 31.5, width: 96, height: 64, fps: 20}")
    code, out, err = dslab("run", tmp_path / "walk", "--camera", camera, "--out", tmp_path / "o")
    assert code == 0 and "06.png: is cut short or damaged; 1 frames that cannot be read are left out" in err
    assert "frames left out, unreadable 1" in " ".join(out.split())
    summary = json.loads((tmp_path / "o" / "summary.json").read_text())
    assert (summary["frames"], summary["unreadable_frames"], summary["dropped_frames"]) == (11, 1, 0)


def test_several_systems_have_a_folder_each_and_one_picture_table_and_recording(
    run_fake, tmp_path, monkeypatch
):
    code, out, _ = run_fake("--system", "base, dual", "--rerun", breaks_at=160)
    folder = tmp_path / "r"
    assert code == 0
    assert {p.name for p in folder.iterdir()} == {"base", "dual", "trajectory.png", "recording.rrd"}
    for kind in ("base", "dual"):
        own = {p.name for p in (folder / kind).iterdir()}
        assert {"summary.json", "trajectory.txt", "trajectory.png"} <= own
        assert sum(line.startswith(f"{kind} ") for line in out.splitlines()) >= 2
    opened = []
    monkeypatch.setattr("dslab.experiments.recording.open_viewer", lambda path, at: opened.append((path, at)))
    view_command(folder)
    assert opened == [(folder / "recording.rrd", pytest.approx(160 / 30))]


def test_of_several_systems_a_line_of_json_each(run_fake, tmp_path):
    _, out, _ = run_fake("--system", "dual,base", "--json", breaks_at=160)
    printed = [json.loads(line) for line in out.splitlines()]
    assert [summary["system"] for summary in printed] == ["dual", "base"]
    assert printed[1] == json.loads((tmp_path / "r" / "base" / "summary.json").read_text())


@pytest.mark.parametrize("names", ["none", "", "base,", "base,dual,base", "dual;base"])
def test_a_wrong_list_of_systems_is_one_line_and_leaves_nothing(run_fake, tmp_path, names):
    code, out, err = run_fake("--system", names)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("error: --system: ") and list(tmp_path.iterdir()) == []


def test_a_setting_of_recovery_fits_if_any_system_has_recovery(run_fake, tmp_path):
    assert run_fake("--system", "base", "--recovery", "orb")[0] == 2
    assert run_fake("--system", "base,dual", "--recovery", "orb")[0] == 0


def test_a_breakage_counts_in_one_of_overlapping_segments():
    sequence = make_sequence()
    wide = replace(sequence.segments[0], kind="rain", first_frame=100, last_frame=250)
    sequence = replace(sequence, segments=(wide, *sequence.segments))
    record = execute(sequence, "dual", 0, build=fake_factory(sequence, breaks_at=160))
    more = Breakage(frame=240, stamp_s=8.0, map_id=0, reason="few_inliers", inliers=1)
    summary = summarise(replace(record, events=(*record.events, more)))
    assert [segment["breakages"] for segment in summary["segments"]] == [1, 1]
    assert [segment["recoveries"] for segment in summary["segments"]] == [0, 1]
    table = cells(breakage_table({"": summary}))
    assert [row[2].split("\n")[0] for row in table] == ["low texture", "rain"]


def test_a_degraded_sequence_goes_by_its_source_and_says_the_stress():
    sequence = make_sequence()
    assert summarise(execute(sequence, "base", 0, build=fake_factory(sequence)))["sequence"] == "made-up"
    degraded = replace(sequence, meta={"degraded": {"seed": 0}})
    summary = summarise(execute(degraded, "base", 0, build=fake_factory(degraded)))
    assert summary["sequence"] == "made-up, degraded: low texture 5-6 s"
    assert summary["sequence"] in run_tables.summary_table(summary).title


def test_without_a_terminal_a_line_now_and_then_tells_that_it_goes_on(monkeypatch, capsys):
    monkeypatch.setattr(console.err, "_width", None)
    told = ["under way, 0 min", "rendering: 2 of 3, 0 min, about 1 min left"]
    for every_s, said in ((60.0, []), (0.03, told)):
        monkeypatch.setattr(console, "LOG_EVERY_S", every_s)
        with console.progress_bars(kernels=False) as show:
            time.sleep(0.1)
            show("rendering", 1, 3)
            time.sleep(0.002)
            show("rendering", 2, 3)
            time.sleep(0.1)  # a step that takes long
        lines = capsys.readouterr().err.splitlines()
        assert lines[:1] + lines[-1:] == said  # a busy machine may tell of the step between
