"""A run ends with a row for every unit, whatever happens to its processes."""

import os
import signal
from multiprocessing import active_children

import pytest
from unit_fakes import MadeUp, made_up_record, rendered_unit

from dslab.experiments.campaign.folder import open_ledger
from dslab.experiments.eq1.record_table import normalise
from dslab.experiments.eq1.records import decided
from dslab.experiments.jobs.pool import PoolSettings


def outcomes(folder, plan):
    """Outcome and attempts by cell, and the errors by cell."""
    with open_ledger(folder, plan, read_only=True) as ledger:
        rows, errors = ledger.rows(), ledger.errors()
    assert [(r["cell"], r["index"]) for r in rows] == [
        (cell, index) for cell, budget in plan.cells.items() for index in range(budget)
    ]
    for row in rows:
        if row["outcome"] != "infrastructure_error":
            wanted = normalise(made_up_record(plan.unit(row["cell"], row["index"])), 2)
            assert decided(row) == decided(wanted)
    return rows, errors


def test_units_that_raise_or_return_bad_records_are_tried_again_and_kept_as_errors(run_made_up, tmp_path):
    plan = MadeUp({"ok": 6, "raise-2": 1, "error": 1, "wrong": 1, "odd": 1})
    tally = run_made_up(plan)
    rows, errors = outcomes(tmp_path / "x", plan)
    by_cell = {r["cell"]: r for r in rows}
    assert by_cell["raise-2"]["outcome"] in ("completed", "void") and by_cell["raise-2"]["attempts"] == 3
    faults = {"error": "no GL here", "wrong": "missing or unknown columns", "odd": "outcome is 'maybe'"}
    for cell, said in faults.items():
        assert by_cell[cell]["outcome"] == "infrastructure_error" and by_cell[cell]["attempts"] == 4
        assert said in by_cell[cell]["message"]
        assert [e["attempt"] for e in errors if e["cell"] == cell] == [1, 2, 3, 4]
    raised = [e["message"] for e in errors if e["cell"] == "raise-2"]
    assert raised == ["ValueError: told to"] * 2
    assert (tally.done, tally.total, tally.errors, tally.retries) == (10, 10, 3, 2 + 4 + 4 + 4)


def test_slam_failures_are_never_tried_again(run_made_up, tmp_path):
    plan = MadeUp({"a": 6, "b": 6, "c": 6})
    tally = run_made_up(plan)
    assert tally.systems[0].breakages > 0 and tally.void > 0 and tally.retries == 0
    assert {(path.stat().st_size) for path in (tmp_path / "tries").iterdir()} == {1}


@pytest.mark.slow
def test_a_unit_that_hangs_or_crashes_is_reported_and_tried_again_and_harms_no_other(run_made_up, tmp_path):
    plan = MadeUp({"spin-1": 1, "crash-1": 1, "slow-0.1": 4})
    tally = run_made_up(plan, workers=PoolSettings(2, time_s=2.0))
    rows, (hung, crashed) = outcomes(tmp_path / "x", plan)
    assert [r["attempts"] for r in rows] == [2, 2, 1, 1, 1, 1] and tally.errors == 0
    assert hung["message"] == "not done after 2 s: its process was ended"
    assert "Segmentation fault" in crashed["message"]
    assert all("in made_up_unit" in error["report"] for error in (hung, crashed))


@pytest.mark.slow
def test_a_corrupt_cached_sequence_is_rendered_again(run_made_up, tmp_path):
    plan = MadeUp({"ok": 2})
    run_made_up(plan, job=rendered_unit, folder=tmp_path / "before")
    for damaged in (tmp_path / "tries").glob("*/gray.npy"):
        content = bytearray(damaged.read_bytes())
        content[-1000:] = bytes(1000)
        damaged.write_bytes(content)
    tally = run_made_up(plan, job=rendered_unit, folder=tmp_path / "after")
    assert tally.retries == 0
    before, after = (
        [decided(r) for r in open_ledger(tmp_path / name, plan, read_only=True).rows()]
        for name in ("before", "after")
    )
    assert before == after and len({r["void_reason"] for r in after}) == 2


@pytest.mark.slow
def test_workers_that_are_killed_are_replaced(run_made_up, tmp_path):
    plan = MadeUp({"slow-0.3": 4})
    killed = []

    def kill_one(tally):
        if tally.workers and not killed:
            killed.append(active_children()[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    tally = run_made_up(plan, workers=PoolSettings(2), show=kill_one)
    rows, (error,) = outcomes(tmp_path / "x", plan)
    assert tally.done == tally.total == 4 and tally.errors == 0 and sum(r["attempts"] for r in rows) == 5
    assert error["message"] == "its process has died (exit code -9)"
