"""A batch: what it makes, that it goes on after any end, and that what must be alone is alone."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import batch_fakes
import numpy as np
import pandas as pd
import pytest
from pool_fakes import open_local_pool, open_thread_pool
from slam_fakes import circle, fake_factory, make_sequence
from system_programs import write_program

from dslab.experiments.batch import run as batch_run
from dslab.experiments.batch.rows import COLUMNS, figures_of, typed
from dslab.experiments.batch.run import CSV_FILE, run_batch
from dslab.experiments.batch.spec import BatchSpec, read_batch
from dslab.experiments.batch.table import beside_first, pairs, sums
from dslab.experiments.evaluation.intact_map import judge_intact
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.jobs.ledger import LEDGER_FILE, sole_driver
from dslab.experiments.runs.execution import execute
from dslab.scenarios.errors import InputError
from dslab.sim.io.forms import load_sequence
from dslab.sim.io.tum import write_tum
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.results import MapTrajectory

ROOT = Path(__file__).parents[3]
EXAMPLE = f"{ROOT / 'examples' / 'own_slam.py'}:ConstantVelocity"
FRAMES = 60


@pytest.fixture
def folder(tmp_path):
    write_tum(make_sequence(FRAMES, segment=None), tmp_path / "drive")
    return tmp_path / "drive"


@pytest.fixture
def in_this_process(monkeypatch):
    monkeypatch.setattr(batch_run, "open_pool", open_local_pool)


def spec_of(**fields):
    return BatchSpec(**{"sequences": ("drive",), "systems": ("base",), "runs": 2, **fields})


def test_a_row_has_the_figures_of_its_run(folder, tmp_path, in_this_process):
    description = write_program(
        tmp_path / "systems", make_sequence(FRAMES, segment=None), keyframes="trajectory.txt"
    )
    spec = spec_of(systems=("copy", EXAMPLE), runs=1)
    rows = run_batch(spec, [str(folder)], tmp_path / "b", folders=[description.parent])
    assert set(COLUMNS) <= set(rows.columns) and rows.system.tolist() == ["copy", "ConstantVelocity"]
    own, copy = (rows[rows.system == name].iloc[0] for name in ("ConstantVelocity", "copy"))
    assert copy.ate_m == pytest.approx(0, abs=1e-6) and copy.keyframe_ate_m == pytest.approx(0, abs=1e-6)
    assert copy.rpe_m < 1e-5 and own.rpe_m > 0.1 and own.completeness == copy.completeness == 1.0
    assert own.intact and own.declares == "nothing" and own.stage_process > 0 and pd.isna(own.keyframe_ate_m)
    kept = pd.read_csv(tmp_path / "b" / CSV_FILE)
    assert len(kept) == 2 and kept.system.tolist() == rows.system.tolist()
    (place,) = (tmp_path / "b" / "runs").glob("*/copy/000")
    assert {"trajectory.txt", "summary.json", "log.txt"} <= {path.name for path in place.iterdir()}


def test_what_a_run_declares_is_counted_and_so_is_what_is_false_of_it():
    """Two maps that are fused, rightly or at twice the size: 8 + 0.01 ms per frame, 20 ms every tenth."""
    sequence = make_sequence()

    def row(seen, **script):
        build = fake_factory(sequence, breaks_at=160, **script)
        record = execute(seen, "dual", 0, build=build)
        about = {"source": "x", "system": "dual", "run": 0}
        return typed([about | figures_of(record, summarise(record))], ["dual"])

    (right,), (wrong,) = (row(sequence, new_map_scale=scale).to_dict("records") for scale in (1.0, 2.0))
    assert (right["declared_fusions"], right["false_fusions"], wrong["false_fusions"]) == (1, 0, 1)
    assert right["declared_loops"] == right["declared_joins"] == right["unjudged"] == 0
    assert right["scale_first_over_last"] == pytest.approx(1) and wrong["scale_first_over_last"] > 1.5
    keyframes = right["cpu_s"] * 1000 - sum(8 + 0.01 * f for f in range(300))
    assert keyframes == pytest.approx(20 * 27, abs=21)
    blind = row(replace(sequence, T_world_cam=None))
    assert blind.declared_fusions.isna().all() and sums(blind).declared[0] == 0


def test_frames_placed_afterwards_do_not_count_as_tracked_and_a_program_says_what_it_cost(
    folder, tmp_path, in_this_process
):
    """The program places the last 48 frames, of which it had 20 live, at 16 ms each."""
    edit = """
rows = rows[12:]
(out / "frames.csv").write_text("stamp_s,cpu_ms\\n" + "".join(f"{s},16.0\\n" for s in stamps))
(out / "live.txt").write_text("".join(" ".join(row) + "\\n" for row in rows[:20]))
"""
    files = {"frames": "frames.csv", "live": "live.txt"}
    path = write_program(tmp_path / "systems", make_sequence(FRAMES, segment=None), edit, **files)
    spec = spec_of(systems=(EXAMPLE, "copy"), runs=1)
    rows = run_batch(spec, [str(folder)], tmp_path / "b", folders=[path.parent])
    copy = rows[rows.system == "copy"].iloc[0]
    assert (copy.share_tracked, copy.completeness) == pytest.approx((20 / 60, 48 / 60))
    assert (copy.cpu_ms_median, copy.frames_to_initialise) == (16.0, 13) and copy.cpu_s > 0
    (pair,) = pairs(rows, tmp_path / "b").to_dict("records")
    assert pair["cpu_ms_median"] == 16.0 and pair["first_cpu_ms_median"] > 0


def test_systems_stand_beside_the_first_one_on_the_frames_that_both_have_placed(
    folder, tmp_path, in_this_process
):
    """The first one's path is cut after 40 frames, then emptied."""
    sequence = make_sequence(FRAMES, segment=None)
    description = write_program(tmp_path / "systems", sequence)
    spec = spec_of(systems=(EXAMPLE, "copy"), runs=1)
    rows = run_batch(spec, [str(folder)], tmp_path / "b", folders=[description.parent])
    (place,) = (tmp_path / "b" / "runs").glob("*/ConstantVelocity/000/trajectory.txt")
    place.write_text("\n".join(place.read_text().splitlines()[:41]) + "\n")
    (row,) = pairs(rows, tmp_path / "b").to_dict("records")
    assert (row["system"], row["ate_poses"], row["common_poses"]) == ("copy", FRAMES, 40)
    assert row["first_ate_poses"] == 40
    assert row["common_ate_m"] == pytest.approx(0, abs=1e-6) and row["first_common_ate_m"] > 0.1
    place.write_text("# nothing\n")
    (row,) = pairs(rows, tmp_path / "b").to_dict("records")
    assert (row["first_ate_poses"], row["common_poses"], row["first_common_ate_m"]) == (0, 0, None)


def test_sequences_weigh_the_same_in_the_mean_over_the_first_system():
    """Twice the error in four runs of one, half of it in one run of another."""
    found = pd.DataFrame(
        {
            "source": ["a"] * 4 + ["b"] * 2, "dose": None, "system": "copy", "ate_poses": 10,
            "first_ate_poses": [10] * 5 + [20], "common_ate_m": [2.0] * 4 + [0.5, None],
            "first_common_ate_m": 1.0, "cpu_ms_median": 3.0, "first_cpu_ms_median": 1.0,
        }
    )  # fmt: skip
    frames, ate, cpu = beside_first(found).to_dict("records")
    assert (ate["runs"], ate["median"], ate["min"], ate["max"]) == (5, 2.0, 0.5, 2.0)
    assert (ate["mean"], ate["low"], ate["high"]) == pytest.approx((1.0, 0.5, 2.0))
    assert (cpu["mean"], cpu["low"], cpu["high"]) == pytest.approx((3.0, 3.0, 3.0))
    assert frames["mean"] == pytest.approx((1 + 0.75) / 2)


def test_the_start_varies_and_the_stress_lies_on_the_same_frames(folder, tmp_path, in_this_process):
    """The class notes the mean light of each frame."""
    (tmp_path / "light.py").write_text(
        f"class Light:\n    def __init__(self, camera, seed):\n        self.seed = seed\n"
        "    def process(self, image, stamp_s):\n"
        f"        with open({str(tmp_path / 'light')!r}, 'a') as file:\n"
        f"            file.write(f'{{stamp_s:.3f}} {{image.mean()}}\\n')\n"
    )
    spec = spec_of(
        systems=(f"{tmp_path / 'light.py'}:Light",), vary="start", skip_frames=7, first_s=1.5,
        stress=("covered_lens:start_s=1,duration_s=0.3,transmission=0",),
    )  # fmt: skip
    rows = run_batch(spec, [str(folder)], tmp_path / "b")
    assert rows.first_frame.tolist() == [0, 7] and rows.frames.tolist() == [45, 38]
    assert not rows.intact.any() and rows.intact_reason.tolist() == ["no map"] * 2
    light = np.loadtxt(tmp_path / "light")
    dark = light[light[:, 1] < 20, 0]
    assert dark.min() == pytest.approx(1.0, abs=0.04) and dark.max() == pytest.approx(1.27, abs=0.05)
    assert sorted(np.unique(dark, return_counts=True)[1].tolist()) == [2] * (len(dark) // 2)


def test_seeds_vary_by_default(tmp_path, folder, in_this_process):
    rows = run_batch(spec_of(seed=4), [str(folder)], tmp_path / "b", task=batch_fakes.made_up)
    assert rows.seed.tolist() == [4, 5] and rows.first_frame.tolist() == [0, 0]


@pytest.mark.slow
def test_scenes_vary_with_their_seeds_and_are_paired_by_run(tmp_path):
    """Two systems meet the same scene in each run, another one in the next. In processes, for OpenGL."""
    spec = spec_of(sequences=("small/room",), systems=("base", EXAMPLE), vary="scenes", seed=5, first_s=1)
    rows = run_batch(spec, ["small/room"], tmp_path / "b")
    assert set(rows.ended) == {"finished"}, rows.ended_message.tolist()
    truths = {
        (row.system, row.run): (tmp_path / "b" / row.folder / "groundtruth.txt").read_text()
        for row in rows.itertuples()
    }
    assert truths["base", 0] == truths["ConstantVelocity", 0] != truths["base", 1]
    assert sorted(rows.seed) == [5, 5, 6, 6]
    found = pairs(rows, tmp_path / "b")
    assert found.run.tolist() == [0, 1] and found.true_path_m.nunique() == 2


def test_more_runs_and_systems_may_be_added_but_not_other_settings(folder, tmp_path, in_this_process):
    def made():
        return (tmp_path / "made").read_text().split("\n")[:-1]

    run_batch(spec_of(), [str(folder)], tmp_path / "b", task=batch_fakes.made_up)
    rows = run_batch(
        spec_of(runs=3, systems=("base", "dual")), [str(folder)], tmp_path / "b", task=batch_fakes.made_up
    )
    assert len(rows) == 6 and len(made()) == len(set(made())) == 6
    with pytest.raises(InputError, match="rows of another setting of stress"):
        run_batch(spec_of(first_s=2.0), [str(folder)], tmp_path / "b", task=batch_fakes.made_up)


def test_a_system_that_was_changed_is_run_again(folder, tmp_path, in_this_process):
    path = write_program(tmp_path / "systems", make_sequence(FRAMES, segment=None))
    spec = spec_of(systems=("base", "copy"), runs=1)
    run_batch(spec, [str(folder)], tmp_path / "b", folders=[path.parent], task=batch_fakes.made_up)
    path.write_text(path.read_text() + "about: another\n")
    rows = run_batch(spec, [str(folder)], tmp_path / "b", folders=[path.parent], task=batch_fakes.made_up)
    assert len(rows) == 2 and sorted((tmp_path / "made").read_text().split()) == sorted(
        ["base", "0", "copy", "0", "copy", "0"]
    )


def rows_so_far(folder):
    """Number of rows in a ledger that is being written."""
    with (
        suppress(sqlite3.Error),
        closing(sqlite3.connect(f"file:{folder / LEDGER_FILE}?mode=ro", uri=True)) as file,
    ):
        return file.execute("SELECT count(*) FROM rows").fetchone()[0]
    return 0


@pytest.mark.slow
def test_a_batch_that_was_killed_goes_on_and_gives_the_same_table(folder, tmp_path, in_this_process):
    whole = run_batch(spec_of(), [str(folder)], tmp_path / "whole" / "b", task=batch_fakes.made_up)
    there = tmp_path / "killed"
    script = f"""
import sys; sys.path.insert(0, {str(Path(batch_fakes.__file__).parent)!r})
import batch_fakes
from pathlib import Path
from dslab.experiments.batch.run import run_batch
from dslab.experiments.batch.spec import BatchSpec
if __name__ == "__main__":
    spec = BatchSpec(sequences=("drive",), systems=("base",), runs=2)
    run_batch(spec, [{str(folder)!r}], Path({str(there / "b")!r}), task=batch_fakes.slow)
"""
    there.mkdir()
    (there / "batch.py").write_text(script)
    lab = subprocess.Popen(
        [sys.executable, there / "batch.py"], cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    until_s = time.monotonic() + 120
    while not ((there / "waits").exists() and rows_so_far(there / "b")) and time.monotonic() < until_s:
        time.sleep(0.05)
    os.kill(lab.pid, signal.SIGKILL)
    lab.wait()
    (there / "go").touch()
    resumed = run_batch(spec_of(), [str(folder)], there / "b", task=batch_fakes.slow)
    pd.testing.assert_frame_equal(resumed, whole)
    assert (there / "made").read_text().split("\n")[:-1] == ["base 0", "base 1"]


def test_every_end_of_a_run_is_a_row_and_what_could_not_be_made_is_made_again(
    folder, tmp_path, in_this_process
):
    spec = spec_of(runs=5)
    rows = run_batch(spec, [str(folder)], tmp_path / "b", workers=2, task=batch_fakes.going_wrong)
    assert rows.ended.tolist() == ["finished", "crashed", "timed_out", "error", "finished"]
    assert "exit code 7" in rows.ended_message[1] and rows.ended_message[3] == "OSError: no disk"
    (tmp_path / "mended").touch()
    rows = run_batch(spec, [str(folder)], tmp_path / "b", workers=2, task=batch_fakes.going_wrong)
    assert rows.ended.tolist() == ["finished", "crashed", "timed_out", "finished", "finished"]
    assert (tmp_path / "made").read_text().split("\n")[:-1].count("base 0") == 1
    (found,) = sums(rows).to_dict("records")
    assert (found["runs"], found["errors"], found["ended_badly"], found["intact"]) == (5, 0, 2, 2)
    assert found["ate_m"] == 4.0  # the median of 1, 4 and 5


def test_what_takes_frames_in_real_time_runs_alone_and_the_rest_side_by_side(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(batch_run, "open_pool", open_thread_pool)
    path = write_program(tmp_path / "systems", make_sequence(FRAMES, segment=None), pace="real_time")
    spec = spec_of(systems=("base", "copy"))
    rows = run_batch(
        spec, [str(folder)], tmp_path / "b", workers=2, folders=[path.parent], task=batch_fakes.meeting
    )
    assert rows[rows.system == "base"].ended_message.tolist() == ["met", "met"]
    assert rows[rows.system == "copy"].ended_message.tolist() == ["alone", "alone"]


# -- the verdict ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kept", "first_pose_s", "reason"),
    [
        (lambda t: t >= 30, 30.0, ""),  # a late start
        (lambda t: t >= 30, 2.0, "lacks 28.0 s at its start"),  # an earlier map is gone
        (lambda t: t < 50, 0.0, "lacks 10.1 s at its end"),
        (lambda t: (t < 20) | (t > 26), 0.0, "lacks 6.2 s within"),
        (lambda t: (t < 20) | (t > 24), 0.0, ""),
        (lambda t: t < 0, None, "no map"),
    ],
)
def test_an_intact_map_goes_from_the_first_pose_to_the_end(kept, first_pose_s, reason):
    stamps_s = np.arange(601) / 10
    frames = np.flatnonzero(kept(stamps_s))
    path = MapTrajectory(0, frames, stamps_s[frames], circle(601)[frames])
    verdict = judge_intact([path] if len(frames) else [], first_pose_s, 60.0)
    assert (verdict.intact, verdict.reason) == (not reason, reason)


# -- the command ---------------------------------------------------------------------------------------------


def test_the_command_prints_a_row_per_system(dslab, folder, tmp_path, monkeypatch, in_this_process):
    monkeypatch.chdir(tmp_path)
    write_tum(replace(load_sequence(folder), T_world_cam=None), tmp_path / "drives" / "blind")
    folder.rename(tmp_path / "drives" / "seen")
    (tmp_path / "drives" / "notes").mkdir()
    (tmp_path / "batch.yaml").write_text(f"sequences: [drives/*]\nsystems: ['{EXAMPLE}']\nruns: 1\n")
    code, out, _ = dslab("batch", "batch.yaml", "--out", "b")
    assert code == 0 and [w for w in out.split() if w in ("blind", "seen", "notes")] == ["blind", "seen"]
    assert out.count("1 of 1") == 2 and max(map(len, out.splitlines()[:12])) <= 80
    # Nothing ended badly, and nothing was declared: the name has their room.
    assert out.count("ConstantVelocity") == 2 and "badly" not in out
    code, out, _ = dslab("batch", "batch.yaml", "--out", "b", "--json")
    figures = json.loads(out)["rows"]
    assert code == 0 and figures[0]["ate_m"] is None and figures[1]["ate_m"] > 0.1


def test_the_command_prints_what_was_rescued(dslab, folder, tmp_path, monkeypatch, in_this_process):
    row = {"source": "a/b", "dose": None, "system": "dual", "cause": "motion_blur", "views": "shared"}
    row |= {"breakages": 3, "recovered": 2, "thread_1": 1, "false_fusion": 0, "to_fusion_s_median": 0.25}
    rescued = pd.DataFrame([row | {"to_fusion_s_p95": 0.5}])
    monkeypatch.setattr("dslab.experiments.batch.breakages.rescues", lambda found: rescued)
    (tmp_path / "batch.yaml").write_text(f"sequences: [{folder}]\nsystems: ['{EXAMPLE}']\nruns: 1\n")
    code, out, _ = dslab("batch", tmp_path / "batch.yaml", "--out", tmp_path / "b")
    (line,) = [line for line in out.splitlines() if "motion blur" in line]
    assert code == 0 and " ".join(line.split()) == "dual motion blur shared 3 2 1 0 0.250 0.500"
    code, out, _ = dslab("batch", tmp_path / "batch.yaml", "--out", tmp_path / "b", "--json")
    assert json.loads(out)["rescues"][0]["breakages"] == 3 and (tmp_path / "b" / "breakages.csv").exists()


def test_settings_are_those_of_our_systems():
    spec = spec_of(settings={"dual": {"buffer_s": 3.0, "place_merging": None}}, mode="threaded")
    system = spec.build("dual", PinholeCamera(640, 480, 500.0, 500.0, 320.0, 240.0, 30.0), 0)
    assert system.settings["dual"]["buffer_s"] == 3.0 and system.settings["dual"]["place_merging"] is None
    assert system.settings["mode"] == "threaded" and spec.row_key != spec_of(mode="threaded").row_key


def test_runs_that_could_not_be_made_are_said_after_the_table(
    dslab, folder, tmp_path, in_this_process, monkeypatch
):
    def torn(*_, **__):
        raise InputError(str(folder), "is gone", "put it back")

    monkeypatch.setattr(batch_run, "run_system", torn)
    (tmp_path / "batch.yaml").write_text(f"sequences: [{folder}]\nsystems: ['{EXAMPLE}']\nruns: 1\n")
    code, out, err = dslab("batch", tmp_path / "batch.yaml", "--out", tmp_path / "b")
    assert code == 1 and "0 of 0" in out and "1 of 1 runs could not be made: InputError" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("sequences: [no/such/folder]", "batch.yaml:1: sequences[0] (no/such/folder): "),
        ("sequences: ['none*']", "'none*' fits no sequence"),
        ("sequences: [clean-room, clean-room]", "clean-room is named twice"),
        ("systems: [bse]", "there is no system 'bse'; give base (did you mean that?)"),
        ("systems: [base, base]", "base is named twice"),
        (f"runs: 2\nseed: {2**63 - 1}", f"its last run has a seed beyond {2**63 - 1}; give a smaller"),
        ("runs: 0", "batch.yaml:3: runs: 0 is not valid"),
        ("stress: ['fog:start_s=1']", "batch.yaml:4: stress[0]: "),
        ("stress: ['darkness:start_s=1']", "unknown kind 'darkness'"),
        ("settings: {dual: {recovery_threads: [lidar]}}", "unknown recovery thread 'lidar'"),
        ("settings: {mode: threaded}", "batch.yaml:4: settings.mode: the batch has a mode of its own"),
        ("real_time: true", "the mode is lockstep; add mode: threaded"),
        ("sequence: [x]", "unknown key; use sequences (did you mean that?)"),
    ],
)
def test_a_batch_that_is_wrong_is_one_line(dslab, monkeypatch, tmp_path, line, says):
    monkeypatch.chdir(tmp_path)
    fields = {"sequences": "[clean-room]", "systems": "[base]", "runs": "1"}
    key, _, value = line.partition(": ")
    lines = {**fields, key: value}
    Path("batch.yaml").write_text("".join(f"{k}: {v}\n" for k, v in lines.items()))
    code, out, err = dslab("batch", "batch.yaml", "--out", "b")
    assert (code, out) == (2, "") and says in err and err.count("\n") == 1
    assert not (tmp_path / "b").exists()


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        run_batch(spec_of(), [], tmp_path / "file" / "b")


def test_one_batch_at_a_time_works_in_a_folder(tmp_path):
    (tmp_path / "b").mkdir()
    with sole_driver(tmp_path / "b"), pytest.raises(InputError, match="another run is at work"):
        run_batch(spec_of(), [], tmp_path / "b")


def test_a_file_can_be_read_with_its_patterns(tmp_path, folder):
    (tmp_path / "batch.yaml").write_text(f"sequences: ['{tmp_path}/dr*', clean-room]\nsystems: [base]\n")
    spec, sources = read_batch(tmp_path / "batch.yaml")
    assert sources == [str(folder), "clean-room"] and spec.runs == 10


def test_a_folder_may_be_called_as_a_pattern_but_a_name_is_text(tmp_path, folder):
    (tmp_path / "batch.yaml").write_text(f"sequences: ['{tmp_path}/[x]']\nsystems: [base]\nruns: 1\n")
    folder.rename(tmp_path / "[x]")
    assert read_batch(tmp_path / "batch.yaml")[1] == [f"{tmp_path}/[x]"]
    os.rename(tmp_path / "[x]", os.fsencode(tmp_path) + b"/drive\xff")
    (tmp_path / "batch.yaml").write_text(f"sequences: ['{tmp_path}/dr*']\nsystems: [base]\nruns: 1\n")
    with pytest.raises(InputError, match="not UTF-8; rename"):
        read_batch(tmp_path / "batch.yaml")
