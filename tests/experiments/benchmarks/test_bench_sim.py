"""The bench of the simulator: processes that start together, rates, a small run of the whole bench."""

import json
import os
import re
import sys

import pytest
from bench_work import fail_in_one, start_time, which_process

from dslab.experiments import cli
from dslab.experiments.benchmarks import simulator as bench_sim
from dslab.experiments.benchmarks.simulator import Lap, rates, run_together


@pytest.mark.slow
def test_processes_start_together_and_set_up_is_not_measured():
    first, second = run_together(start_time, (), 2)
    assert abs(first.frames - second.frames) < 400
    assert all(0.2 <= lap.wall_s < 0.8 and lap.cpu_s < 0.1 for lap in (first, second))
    assert all(20 < lap.peak_rss_mb < 2000 for lap in (first, second))


@pytest.mark.slow
def test_each_work_has_a_process_of_its_own():
    pids = {lap.frames for lap in run_together(which_process, (), 2)}
    assert len(pids) == 2 and os.getpid() not in pids


@pytest.mark.slow
def test_a_process_that_fails_ends_the_others_and_is_reported():
    with pytest.raises(ValueError, match="the second one"):
        run_together(fail_in_one, (), 2)


def test_rates_cover_all_processes_until_the_last_ends():
    found = rates([Lap(100, 2.0, 1.0, 300.0), Lap(100, 4.0, 2.0, 500.0)])
    assert found["frames_per_s"] == 50
    assert found["cpu_ms"] == 15
    assert found["frames_per_s_alone"] == pytest.approx(2 / 0.015)
    assert found["peak_rss_mb"] == 500


@pytest.mark.slow
def test_a_small_run_of_the_whole_bench(monkeypatch, capsys):
    monkeypatch.setattr(bench_sim, "SCENES", {"corridor": bench_sim.SCENES["corridor"]})
    monkeypatch.setattr(bench_sim, "LARGE_CITY_M", 300)
    monkeypatch.setattr(sys, "argv", ["dslab", "bench", "sim", "--processes", "1", "--frames", "4", "--json"])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert not caught.value.code
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert set(figures["rendered"]) == set(bench_sim.SCENES)
    assert set(figures["degraded"]) == {"sharp", "blurred"}
    for row in (*figures["rendered"].values(), *figures["degraded"].values()):
        assert row["frames"] >= 4 and row["frames_per_s"] > 0
        assert row["peak_rss_mb"] < figures["asked"]["peak_rss_mb"]
    assert figures["build"]["surfaces"] > 100
    assert figures["build"]["peak_rss_mb"] < figures["asked"]["peak_rss_mb"]


def test_the_table_shows_targets_beside_measurements(monkeypatch, capsys):
    row = {
        "frames": 8,
        "frames_per_s": 61.5,
        "cpu_ms": 20.0,
        "frames_per_s_alone": 100.0,
        "peak_rss_mb": 700.0,
    }
    build = {
        "build_s": 3.5,
        "build_cpu_s": 3.25,
        "load_s": 2.0,
        "load_cpu_s": 1.5,
        "surfaces": 9,
        "peak_rss_mb": 8,
    }
    figures = {
        "processes": 2,
        "renderer": "mujoco",
        "size_px": [640, 480],
        "rendered": dict.fromkeys(bench_sim.SCENES, row),
        "degraded": {"sharp": row, "blurred": row},
        "build": build,
        "asked": bench_sim.TARGETS,
    }
    monkeypatch.setattr(bench_sim, "bench_sim", lambda processes, frames, show, renderer: figures)
    monkeypatch.setattr(sys, "argv", ["dslab", "bench", "sim"])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    shown = capsys.readouterr().out
    assert not caught.value.code
    rows = [re.split(r" {2,}", line) for line in map(str.rstrip, shown.splitlines())]
    for name, asked in (("rendered, city", "60"), ("degraded", "150"), ("degraded, blurred", "-")):
        assert [name, "61.5", asked, "20.0", "100.0", "700", "1536"] in rows
    for figure in ("3.5 s", "limit: 5 s"):
        assert figure in shown
