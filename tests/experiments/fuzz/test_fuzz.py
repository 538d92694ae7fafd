"""Fuzzing: every fault of a run is reported, and the systems have none on random scenarios."""

import json
import os
import sys

import numpy as np
import pytest
from pool_fakes import open_local_pool
from slam_fakes import simulated_camera

from dslab.experiments import cli
from dslab.experiments.fuzz.fuzzing import (
    FuzzUnit,
    drawn_threads,
    empty_row,
    failed,
    fuzz_unit,
    replay_command,
    run_fuzz,
)
from dslab.scenarios.loading import load_scenario
from dslab.scenarios.random_scenarios import random_scenario
from dslab.sim.sequence import Sequence
from dslab.slam.factory import build_system
from dslab.slam.toy_sequence import CAMERA, toy_frames

UNIT = FuzzUnit(4, "base")


@pytest.fixture(scope="module")
def sequence():
    """A second of a synthetic sequence."""
    images, stamps_s, T_world_cam = zip(*toy_frames(30, step_m=0.05), strict=True)
    return Sequence(
        "toy", simulated_camera(CAMERA), np.array(stamps_s), np.array(images), np.array(T_world_cam),
        depths=None, segments=(), meta={},
    )  # fmt: skip


def spoilt(at, spoil):
    """A factory of systems with a fault at one frame."""

    def build(kind, camera, seed):
        system = build_system(kind, camera, seed)
        process = system.process

        def processed(image, stamp_s):
            if system.frames == at:
                spoil(system)
            return process(image, stamp_s)

        system.process = processed
        return system

    return build


def test_the_row_of_a_sound_run(sequence):
    row = fuzz_unit(FuzzUnit(4, "ldso"), sequence=sequence)
    assert row["outcome"] == "ok" and row["recovery"] == "" and row["frames"] == len(sequence)
    row = fuzz_unit(UNIT, sequence=sequence)
    assert (row["outcome"], row["message"], row["traceback"], row["stage"]) == ("ok", "", "", "")
    assert (row["frames"], row["maps"], row["breakages"], row["fusions"]) == (30, 1, 0, 0)
    assert 10 < row["tracked"] < 30 and len(row["digest"]) == 16
    again = fuzz_unit(UNIT, sequence=sequence)
    assert again["digest"] == row["digest"]


def test_an_exception_is_reported_with_its_frame_and_traceback(sequence):
    def spoil(system):
        raise ZeroDivisionError("told to")

    row = fuzz_unit(UNIT, spoilt(7, spoil), sequence)
    assert (row["outcome"], row["stage"]) == ("exception", "frame 7")
    assert row["message"] == "ZeroDivisionError: told to" and "in processed" in row["traceback"]
    assert row["frames"] is None and list(row) == list(empty_row(UNIT))


@pytest.mark.parametrize("at", [29, 12])
def test_a_broken_invariant_is_reported(sequence, at):
    def spoil(system):
        system.current_map.loop_edges.append((0, 10_000))

    row = fuzz_unit(UNIT, spoilt(at, spoil), sequence)
    assert row["outcome"] == "invariant_broken"
    assert "a loop edge of a keyframe that does not exist" in row["message"]


def test_a_failure_to_render_is_reported(monkeypatch):
    def broken(scenario):
        raise RuntimeError("no light")

    monkeypatch.setattr("dslab.experiments.fuzz.fuzzing.render_sequence", broken)
    row = fuzz_unit(UNIT)
    assert (row["system"], row["outcome"], row["stage"]) == ("base", "exception", "render")


def test_recovery_threads_are_drawn_by_seed_in_many_orders(monkeypatch, sequence):
    orders = [",".join(spec.kind for spec in drawn_threads(seed)) for seed in range(200)]
    assert {"direct", "orb,sift", "orb,direct,sift"} <= set(orders) and len(set(orders)) > 20
    assert sum("direct" in order for order in orders) > 60
    assert all(len(set(order.split(","))) == len(order.split(",")) for order in orders)
    seed = orders.index("orb,direct,sift")
    built = []

    def run(sequence, kind, seed, observer, at_end, build):
        built.append(build(kind, CAMERA, seed).dual.recovery_threads)
        raise ZeroDivisionError

    monkeypatch.setattr("dslab.experiments.fuzz.fuzzing.execute", run)
    row = fuzz_unit(FuzzUnit(seed, "dual"), sequence=sequence)
    assert built == [drawn_threads(seed)] and row["recovery"] == "orb,direct,sift"
    assert empty_row(UNIT)["recovery"] == "" == empty_row(FuzzUnit(4, "paper"))["recovery"]


# -- many units ----------------------------------------------------------------------------------------------


def scripted(unit):
    """A quick unit; one system fails with seed 2, and one ends the process with seed 3."""
    row = empty_row(unit) | {"outcome": "ok", "frames": 150}
    if (unit.seed, unit.system) == (2, "dual"):
        said = {"message": "KeyError: 3", "traceback": "in here", "stage": "frame 9"}
        row |= {"outcome": "exception", **said}
    if (unit.seed, unit.system) == (3, "base"):
        os._exit(4)
    return row


UNITS = [FuzzUnit(seed, kind) for seed in range(5) for kind in ("base", "dual")]


def scripted_in_this_process(unit):
    """The same, but the end of the process is an exception."""
    if (unit.seed, unit.system) == (3, "base"):
        raise ChildProcessError("its process has died")
    return scripted(unit)


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    """Rows and folder of a run without processes."""
    folder = tmp_path_factory.mktemp("fuzz") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dslab.experiments.fuzz.fuzzing.open_pool", open_local_pool)
        return run_fuzz(UNITS, folder, job=scripted_in_this_process), folder


def test_every_run_has_a_row_in_order_and_only_the_run_that_ends_its_process_dies(output):
    rows, folder = output
    assert [(r["seed"], r["system"]) for r in rows] == [(s, k) for s in range(5) for k in ("base", "dual")]
    bad = {(r["seed"], r["system"]): (r["outcome"], r["message"]) for r in failed(rows)}
    assert bad == {
        (2, "dual"): ("exception", "KeyError: 3"),
        (3, "base"): ("process_died", "its process has died"),
    }
    written = [json.loads(line) for line in (folder / "units.jsonl").read_text().splitlines()]
    assert [(r["seed"], r["outcome"]) for r in written] == [(r["seed"], r["outcome"]) for r in rows]


def test_the_scenarios_of_failed_runs_are_kept(output):
    rows, folder = output
    assert sorted(p.name for p in (folder / "failed").iterdir()) == ["2.yaml", "3.yaml"]
    assert load_scenario(folder / "failed" / "2.yaml") == random_scenario(2)
    command = replay_command(failed(rows)[0])
    assert command.startswith("dslab experiment fuzz --start 2 --units 1 --system dual ")


@pytest.mark.slow
def test_the_table_does_not_depend_on_the_number_of_processes(output, tmp_path):
    run_fuzz(UNITS, tmp_path / "out", 2, job=scripted)
    lines = [
        [json.loads(line) for line in (folder / "units.jsonl").read_text().splitlines()]
        for folder in (output[1], tmp_path / "out")
    ]
    for row in lines[1]:
        if row["outcome"] == "process_died":
            assert row["message"] == "its process has died (exit code 4)"
            row["message"] = row["traceback"] = "its process has died"
    assert lines[0] == lines[1]


def dslab(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["dslab", "experiment", "fuzz", *arguments])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    captured = capsys.readouterr()
    return caught.value.code or 0, captured.out, captured.err


@pytest.mark.slow
def test_the_command_fails_if_a_run_fails(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("dslab.experiments.fuzz.fuzzing.fuzz_unit", scripted)
    code, out, _ = dslab(monkeypatch, capsys, "--units", "2", "--out", str(tmp_path / "a"))
    assert code == 0 and "4 runs" in out and "replay" not in out
    code, out, _ = dslab(
        monkeypatch, capsys, "--start", "2", "--units", "1", "--system", "dual", "--out", str(tmp_path / "b")
    )
    assert code == 1
    assert "seed 2, dual: exception at frame 9: KeyError: 3" in out and "in here" in out
    assert "again: dslab experiment fuzz --start 2 --units 1 --system dual --mode lockstep" in out
    assert (tmp_path / "b" / "units.jsonl").is_file()


@pytest.mark.parametrize("systems", ["bass", "base,base", ""])
def test_unknown_systems_are_refused(monkeypatch, capsys, tmp_path, systems):
    code, _, err = dslab(monkeypatch, capsys, "--system", systems, "--out", str(tmp_path / "a"))
    assert code == 2 and "base,dual" in err and not (tmp_path / "a").exists()


# -- the systems -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_systems_come_through_random_scenarios(tmp_path):
    # Dual-SLAM includes the base. `dslab experiment fuzz` runs any number.
    rows = run_fuzz([FuzzUnit(0, "base"), FuzzUnit(0, "dual"), FuzzUnit(2, "dual")], tmp_path / "out")
    assert len(rows) == 3 and failed(rows) == []
    assert sum(row["breakages"] for row in rows) > 1
