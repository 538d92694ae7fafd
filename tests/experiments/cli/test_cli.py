"""The command line: help, exit codes, one line per error, JSON on the last line."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib import metadata
from typing import Any

import pytest
from slam_fakes import fake_factory, make_sequence
from typer.main import get_command

from dslab.experiments.cli.commands import app
from dslab.experiments.runs import execution, slam_settings, sources
from dslab.scenarios.errors import InputError


@pytest.fixture
def synthetic(monkeypatch, no_picture):
    """`dslab run` of any source runs the fake system over a synthetic sequence."""
    sequence = make_sequence()
    monkeypatch.setattr(sources, "open_sequence", lambda source, seed, show, **options: sequence)
    fake = fake_factory(sequence, breaks_at=160)
    monkeypatch.setattr(execution, "system_factory", lambda mode="lockstep", dual=None: fake)
    monkeypatch.setattr(slam_settings, "factory_of", lambda settings: fake)
    return sequence


def leaf_commands(group, name: str) -> Iterator[tuple[str, Any]]:
    for part, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from leaf_commands(command, f"{name} {part}")
        else:
            yield f"{name} {part}", command


def test_every_command_has_help_with_an_example():
    found = dict(leaf_commands(get_command(app), "dslab"))
    assert len(found) > 20
    assert [name for name, command in found.items() if name not in (command.help or "")] == []


def test_version_is_one_line(dslab):
    assert dslab("--version") == (0, f"dual-slam-lab {metadata.version('dual-slam-lab')}\n", "")


def test_help_loads_nothing_heavy():
    script = "import sys, dslab.experiments.cli; print(*sorted(m.split('.')[0] for m in sys.modules))"
    started = time.process_time()
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert time.process_time() - started < 1
    heavy = {"numpy", "scipy", "cv2", "numba", "mujoco", "rerun", "pyarrow", "matplotlib", "pydantic"}
    assert not heavy & set(loaded.stdout.split())


def test_linear_algebra_has_one_thread():
    """Sums have other bits with other numbers of threads, and BLAS reads its number when it is loaded."""
    script = (
        "import os, sys; from dslab.experiments.cli import main; early = 'numpy' in sys.modules\n"
        "try: sys.argv = ['dslab', '--version']; main()\n"
        "finally: print(early, os.environ['OPENBLAS_NUM_THREADS'])"
    )
    unset = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=unset, check=True
    )
    assert ended.stdout.split()[-2:] == ["False", "1"]


def test_run_prints_the_summary_as_the_last_line(dslab, synthetic, tmp_path):
    code, out, _ = dslab("run", "x", "--out", str(tmp_path / "r"), "--json", "--seed", "4")
    assert code == 0
    summary = json.loads(out.splitlines()[-1])
    assert summary == json.loads((tmp_path / "r" / "summary.json").read_text())
    assert summary["seed"] == 4 and summary["breakages"] == 1


def test_run_prints_a_table_for_people(dslab, synthetic, tmp_path):
    code, out, _ = dslab("run", "x", "--out", str(tmp_path / "r"), "--system", "dual")
    assert code == 0
    assert "1 / 1" in out and "91.7 %" in out


def test_a_folder_with_files_is_one_line_and_exit_2(dslab, synthetic, tmp_path):
    (tmp_path / "x").write_text("")
    code, out, err = dslab("run", "x", "--out", str(tmp_path))
    assert (code, out) == (2, "")
    assert err.startswith(f"error: {tmp_path}: already holds files; ") and err.count("\n") == 1


def test_an_unknown_source_is_one_line_and_exit_2(dslab, tmp_path):
    code, _, err = dslab("run", "no-such-scenario", "--out", str(tmp_path / "r"))
    assert code == 2
    assert err.startswith("error: no-such-scenario: ") and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_is_one_line_and_exit_130(dslab, monkeypatch, synthetic, tmp_path):
    def interrupted(*_, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(sources, "open_sequence", interrupted)
    code, _, err = dslab("run", "x", "--out", str(tmp_path / "r"))
    assert code == 130
    assert err.strip().splitlines() == ["interrupted: nothing half-written is left"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("run x --out y --seed soon", "dslab run: invalid value for '--seed': "),
        ("bench slam x --system none", "dslab bench slam: invalid value for '--system': "),
        ("run x", "dslab run: missing option '--out'; see dslab run -h"),
        ("run x --out", "dslab: option '--out' requires an argument; see dslab -h"),
        ("scenarios list [/]", "dslab scenarios list: got unexpected extra argument"),
        ("rnu", "dslab: no such command 'rnu'"),
    ],
)
def test_a_word_that_does_not_fit_is_one_line_and_exit_2(dslab, words, line):
    code, out, err = dslab(*words.split())
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"error: {line}") and "; see dslab" in err


def test_a_group_without_a_command_prints_its_help(dslab):
    code, out, err = dslab("scenarios")
    assert code == 2 and "validate" in out and err == ""


def test_a_missing_recording_is_one_line_and_exit_2(dslab, tmp_path):
    code, _, err = dslab("view", str(tmp_path))
    assert code == 2 and "recording.rrd: no such file" in err


def test_doctor_without_gl_reports_the_rest_and_exits_2(dslab, monkeypatch):
    def none() -> dict:
        raise InputError("GL", "no headless OpenGL here", "install libegl1")

    monkeypatch.setattr("dslab.sim.rendering.gl_context.gl_info", none)
    code, out, err = dslab("doctor")
    assert code == 2 and "numpy" in out and "cores" in out
    assert err.startswith("error: GL: ") and err.count("\n") == 1


def test_bench_pools_the_frames_of_all_runs(dslab, monkeypatch, synthetic):
    monkeypatch.setattr("dslab.slam.warmup.warm_up", lambda progress: None)
    code, out, _ = dslab("bench", "x", "--runs", "2", "--json")
    figures = json.loads(out.splitlines()[-1])
    assert code == 0
    assert figures["stages"]["extract"]["frames"] == 600
    assert figures["mapping_cpu_ms_median"] == 20.0
    code, out, _ = dslab("bench", "x")
    assert code == 0 and "loop closing, per keyframe" in out and "MiB" in out


@pytest.mark.parametrize("arguments", [["x"], ["slam", "x"], ["--seed", "3", "x"]], ids=" ".join)
def test_bench_without_a_command_measures_the_tracker(dslab, monkeypatch, synthetic, arguments):
    monkeypatch.setattr("dslab.slam.warmup.warm_up", lambda progress: None)
    code, out, _ = dslab("bench", *arguments, "--json")
    assert code == 0
    assert json.loads(out.splitlines()[-1])["system"] == "base"


@pytest.mark.parametrize("threads", ["0", "-1", "many"])
def test_a_number_of_threads_that_is_none_is_one_line(dslab, monkeypatch, threads):
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    code, out, err = dslab("doctor")
    assert (code, out, err.count("\n")) == (
        2,
        "",
        1,
    ) and f"NUMBA_NUM_THREADS: '{threads}' is no number" in err
