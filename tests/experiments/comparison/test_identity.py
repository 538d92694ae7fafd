"""Only runs of one content are repeats: other doses, seeds, folders, truths and settings stand apart."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
from slam_fakes import FakeSystem, make_sequence

from dslab.experiments.comparison.dose_groups import _doses
from dslab.experiments.comparison.figures import comparison_content
from dslab.experiments.comparison.identity import told_apart
from dslab.experiments.comparison.left_runs import LeftRun, find_runs
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.result_folder import write_run
from dslab.experiments.runs.inputs import hashed, input_digests
from dslab.experiments.runs.sources import open_sequence
from dslab.experiments.runs.systems.registry import OwnSystem
from dslab.experiments.runs.systems.run import run_system
from dslab.scenarios.segment_text import parse_segment
from dslab.sim.degradations.recorded_sequences import degrade_sequence
from dslab.sim.io.tum import write_tum

FRAMES = 30


def run_into(folder, sequence, seed=0, **fields):
    """A run of a fake over a sequence, into a folder."""
    folder.mkdir(parents=True)
    truth = sequence.T_world_cam
    build = lambda *_: FakeSystem(truth, "base", starts_at=0)  # noqa: E731
    record = run_system(OwnSystem("base"), sequence, seed, build)
    write_run(folder, record, summarise(record) | fields, picture=False)


def names(folder):
    """Groups and their systems with the number of runs."""
    content = comparison_content(find_runs([folder]))
    return {s["name"]: {of["name"]: of["runs"] for of in s["systems"]} for s in content["sequences"]}


def test_doses_of_a_stress_stand_apart_and_their_seeds_are_repeats(tmp_path):
    write_tum(make_sequence(FRAMES, segment=None), tmp_path / "drive")
    sequence = open_sequence(str(tmp_path / "drive"))
    for dose in (0.02, 0.1):
        segment = parse_segment(f"motion_blur:start_s=0.3,duration_s=0.3,exposure_s={dose}")
        stressed = degrade_sequence(sequence, [segment], 0, tmp_path)
        for seed in range(2):
            run_into(tmp_path / "runs" / f"{dose}-{seed}", stressed, seed)
    label = "made-up, degraded: motion blur 0.3-0.6 s, exposure "
    assert names(tmp_path / "runs") == {f"{label}{dose} s": {"base": 2} for dose in (0.02, 0.1)}


def test_folders_of_one_name_and_other_truths_stand_apart_and_copies_do_not(tmp_path):
    for place, seed in (("easy", 0), ("hard", 1)):
        sequence = make_sequence(FRAMES, segment=None)
        turned = [np.roll(sequence.frames[k], 7 * seed) for k in range(FRAMES)]
        write_tum(replace(sequence, frames=turned), tmp_path / place / "P000")
    shutil.copytree(tmp_path / "easy", tmp_path / "copy")
    for place in ("easy", "copy", "hard"):
        run_into(tmp_path / "runs" / place, open_sequence(str(tmp_path / place / "P000")))
    easy, hard = (f"made-up, {tmp_path / place / 'P000'}" for place in ("copy", "hard"))
    assert names(tmp_path / "runs") == {easy: {"base": 2}, hard: {"base": 1}}
    other = open_sequence(str(tmp_path / "easy" / "P000"))
    bent = other.T_world_cam * np.where(np.eye(4)[3] > 0, 1.1, 1)
    run_into(tmp_path / "truths" / "a", other)
    run_into(tmp_path / "truths" / "b", replace(other, T_world_cam=bent))
    assert [name[:15] for name in names(tmp_path / "truths")] == ["made-up, truth "] * 2


def test_seeds_of_a_scenario_stand_apart_and_so_do_settings(tmp_path):
    sequence = make_sequence(FRAMES, segment=None)
    for seed in (3, 4):
        scene = replace(sequence, stamps_s=sequence.stamps_s + seed, meta={"seed": seed}, source="small/room")
        run_into(tmp_path / "runs" / str(seed), scene)
    name = sequence.name
    assert list(names(tmp_path / "runs")) == [f"{name}, seed 3", f"{name}, seed 4"]
    for buffer_s in (1.0, 2.0):
        run_into(tmp_path / "set" / f"{buffer_s}", sequence, config={"dual": {"buffer_s": buffer_s}})
    assert names(tmp_path / "set") == {name: {"base, dual.buffer_s 1.0": 1, "base, dual.buffer_s 2.0": 1}}


def test_names_that_differ_stay_as_they_are():
    assert told_apart(["a", "b", "a"], [{"x": "1", "y": "p"}, {}, {"x": "1", "y": "q"}]) == [
        "a, p",
        "b",
        "a, q",
    ]


def test_no_two_names_are_one():
    """Neither where facts do not suffice, nor where a name is what another became."""
    assert told_apart(["a", "a (2)", "a"], [{"x": "1"}] * 3) == ["a", "a (2)", "a (3)"]
    assert len(set(told_apart(["a", "a", "a, 1"], [{"x": "1"}, {"x": "2"}, {}]))) == 3


def test_what_is_on_or_off_is_no_dose():
    segment = {"kind": "x", "severity": {"flipped": True, "share": 0.5}}
    run = LeftRun(Path(), "", "", None, None, None, {"segments": [segment]})
    assert _doses(run) == {(0, "x", "share"): 0.5}


def test_an_input_is_every_frame_even_those_that_nobody_read():
    sequence = make_sequence(FRAMES, segment=None)
    read = hashed(sequence)
    read.frames[3]
    assert input_digests(read) == input_digests(sequence)
    frames = [sequence.frames[k].copy() for k in range(FRAMES)]
    frames[-1][0, 0] ^= 1
    other = input_digests(replace(sequence, frames=frames))
    assert {part for part, digest in other.items() if digest != input_digests(sequence)[part]} == {"images"}


def test_a_run_that_does_not_say_its_input_is_one_line(tmp_path, dslab):
    run_into(tmp_path / "old", make_sequence(FRAMES, segment=None), input=None)
    code, _, err = dslab("compare", str(tmp_path / "old"), "--out", str(tmp_path / "page"))
    assert code == 2 and "does not say what the run was given; run it again" in err and err.count("\n") == 1
