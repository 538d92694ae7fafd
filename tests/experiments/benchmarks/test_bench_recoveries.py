"""The table of what recoveries rescue: which breakages count, what each thread came to, resumed."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from slam_fakes import fake_factory, make_sequence
from typer.testing import CliRunner

from dslab.experiments.benchmarks import kept_rows, recoveries
from dslab.experiments.cli.commands import app
from dslab.experiments.evaluation.view_overlap import BestOverlap
from dslab.experiments.runs.execution import execute
from dslab.scenarios.errors import InputError
from dslab.slam.core.events import RecoveryStart


def record(**script):
    sequence = make_sequence()
    return execute(sequence, "dual", 0, build=fake_factory(sequence, breaks_at=160, **script))


def test_a_breakage_has_a_row_with_the_state_of_its_map_and_the_end_of_each_thread():
    run = record()
    fused = next(e for e in run.events if e.kind == "fusion")
    start = RecoveryStart(
        frame=170, stamp_s=fused.stamp_s - 0.25, map_id=fused.new_map_id, thread=1, method="orb",
        old_map_id=fused.old_map_id, buffered_frames=9,
    )  # fmt: skip
    waited = replace(start, stamp_s=fused.stamp_s, thread=2)  # for the first thread's end
    (row,) = recoveries.breakage_rows(replace(run, events=(*run.events, start, waited)))
    assert row["breakage"] == 1 and row["frame"] == 160 and row["rescued"]
    assert row["healthy"] and row["error_m"] < 1e-6 and row["bound_m"] >= 0.1
    assert row["false_fusion"] is False
    assert row["to_fusion_s"] == pytest.approx(0.25)
    assert row["thread_1"] is True and row["thread_1_reason"] == ""
    (lost,) = recoveries.breakage_rows(record(recovers=False))
    assert lost["healthy"] and not lost["rescued"] and lost["false_fusion"] is None


def test_a_map_that_went_wrong_before_it_broke_is_not_healthy():
    right = record()
    live = dict(right.live)
    bent = live[0].T_map_cam.copy()
    last = np.flatnonzero(live[0].frames < 160)[-60:]
    bent[last, :3, 3] += np.sin(np.linspace(0, 9, 60))[:, None] * (0.0, 3.0, 3.0)
    live[0] = replace(live[0], T_map_cam=bent)
    (row,) = recoveries.breakage_rows(replace(right, live=live))
    assert row["healthy"] is False and row["error_m"] > row["bound_m"]


def test_sums_are_of_healthy_maps_by_cause():
    row = {
        "scenario": "a",
        "seed": 1,
        "threads": "orb,sift",
        "cause": "fog",
        "healthy": True,
        "thread_2": None,
    }
    rows = pd.DataFrame(
        [
            row | {"rescued": True, "thread_1": True, "false_fusion": True, "to_fusion_s": 0.4},
            row | {"rescued": False, "thread_1": False, "false_fusion": None, "to_fusion_s": None},
            row
            | {"rescued": True, "thread_1": True, "healthy": False, "false_fusion": False, "to_fusion_s": 2},
            row
            | {"rescued": None, "thread_1": None, "healthy": None, "false_fusion": None, "to_fusion_s": None},
        ]
    )
    (found,) = recoveries.recovery_sums(rows).to_dict("records")
    assert found == {
        "scenario": "a", "cause": "fog", "views": "unknown", "breakages": 2, "rescued": 1, "thread_1": 1,
        "thread_2": 0,
        "false_fusion": 1, "to_fusion_s_median": 0.4, "to_fusion_s_p95": 0.4,
    }  # fmt: skip


def test_overlap_is_of_frames_without_stress_that_a_recovery_has(monkeypatch):
    """The stress of frames 150 to 180 broke the map at 160; a buffer of 2 s holds 60 frames."""
    asked = []

    def of(scenario, T_world_cam, before, after):
        asked.append((scenario, before.tolist(), after.tolist()))
        return BestOverlap(0.1, None)

    monkeypatch.setattr(recoveries, "best_overlap", of)
    run = record(recovers=False)
    (row,) = recoveries.breakage_rows(run, "its scenario", buffer_s=2.0)
    assert asked == [("its scenario", list(range(90, 150)), list(range(181, 300)))]
    assert row["view_overlap"] == 0.1 and recoveries.breakage_rows(run)[0]["view_overlap"] is None
    rows = pd.DataFrame([{"scenario": "a"} | row | {"view_overlap": share} for share in (0.1, 0.3, 0.5)])
    sums = recoveries.recovery_sums(rows)
    assert dict(zip(sums.views, sums.breakages, strict=True)) == {"hopeless": 1, "shared": 2}


def test_sums_of_one_breakage_without_a_fusion_and_of_none():
    (lost,) = recoveries.breakage_rows(record(recovers=False))
    (sums,) = recoveries.recovery_sums(pd.DataFrame([{"scenario": "a"} | lost])).to_dict("records")
    assert (sums["breakages"], sums["rescued"]) == (1, 0) and np.isnan(sums["to_fusion_s_median"])
    none = recoveries.breakage_rows(execute(make_sequence(), "dual", 0, build=fake_factory(make_sequence())))
    assert recoveries.recovery_sums(pd.DataFrame([{"scenario": "a"} | row for row in none])).empty


def test_sequences_that_the_file_has_are_not_run_again(tmp_path, monkeypatch):
    table = tmp_path / "rows"
    first = recoveries.measure_recoveries(["small"], [7], "orb", table)
    assert first.breakage.tolist() == [0]
    pd.testing.assert_frame_equal(first, recoveries.measure_recoveries(["small"], [7], "orb", table))
    monkeypatch.setattr(kept_rows, "code_hash", lambda: "another")
    with pytest.raises(InputError, match="rows of another version of the code"):
        recoveries.measure_recoveries(["small"], [7], "orb", table)


def test_the_command_prints_sums_and_refuses_unknown_threads(tmp_path, monkeypatch):
    given = ["bench", "recoveries", "small", "--out", str(tmp_path / "t")]
    refused = CliRunner().invoke(app, [*given, "--threads", "orb,lidar"])
    assert refused.exit_code == 2 and "lidar" in refused.output
    row = {"scenario": "a", "cause": "fog", "healthy": True, "rescued": True, "thread_1": True}
    monkeypatch.setattr(
        recoveries,
        "measure_recoveries",
        lambda *_: pd.DataFrame([row | {"false_fusion": False, "to_fusion_s": 0.2}] * 3),
    )
    (printed,) = json.loads(CliRunner().invoke(app, [*given, "--json"]).stdout)
    assert printed["breakages"] == printed["rescued"] == 3
    assert "fog" in CliRunner().invoke(app, given).stdout
