"""Whatever happens to the processes of a run, it ends with every unit accounted for."""

import os
import signal
from contextlib import nullcontext

import pytest
from dask import config
from unit_fakes import MadeUp, made_up_record, made_up_unit, rendered_unit

from experiments.campaign import runner
from experiments.campaign import worker_pool as pool
from experiments.campaign.ledger import Ledger
from experiments.campaign.worker_pool import WorkerPoolSettings, embedded_worker_pool
from experiments.eq1.record_table import normalise
from experiments.eq1.records import decided
from scenarios.errors import InputError

LOST = "distributed.deploy.lost-worker-timeout"
pytestmark = pytest.mark.usefixtures("shared_pool")


@pytest.fixture
def one_try(monkeypatch):
    monkeypatch.setattr(runner, "TRIES", 1)


@pytest.fixture
def two_tries(monkeypatch):
    monkeypatch.setattr(runner, "TRIES", 2)


def outcomes(folder, plan):
    """Outcome and attempts by cell, and the errors by cell."""
    with Ledger.open(folder, plan, read_only=True) as ledger:
        rows, errors = ledger.rows(), ledger.errors()
    assert [(r["cell"], r["index"]) for r in rows] == [
        (cell, index) for cell, budget in plan.cells.items() for index in range(budget)
    ]
    for row in rows:
        if row["outcome"] != "infrastructure_error":
            wanted = normalise(made_up_record(plan.unit(row["cell"], row["index"])), 2)
            assert decided(row) == decided(wanted)
    return rows, errors


def test_units_that_raise_or_give_nonsense_are_tried_again_and_kept_apart(run_made_up, tmp_path):
    plan = MadeUp({"ok": 6, "raise-2": 1, "error": 1, "wrong": 1})
    tally = run_made_up(plan)
    rows, errors = outcomes(tmp_path / "x", plan)
    by_cell = {r["cell"]: r for r in rows}
    assert by_cell["raise-2"]["outcome"] in ("completed", "void") and by_cell["raise-2"]["attempts"] == 3
    for cell, said in (("error", "no GL here"), ("wrong", "missing or unknown columns")):
        assert by_cell[cell]["outcome"] == "infrastructure_error" and by_cell[cell]["attempts"] == 4
        assert said in by_cell[cell]["message"]
        assert [e["attempt"] for e in errors if e["cell"] == cell] == [1, 2, 3, 4]
    raised = [e["message"] for e in errors if e["cell"] == "raise-2"]
    assert len(raised) == 2 and all("ValueError: told to (unit_fakes.py:" in message for message in raised)
    assert (tally.done, tally.total, tally.errors, tally.retries) == (9, 9, 2, 2 + 4 + 4)


def test_slam_failures_are_never_tried_again(run_made_up, tmp_path):
    plan = MadeUp({"ok": 40})
    tally = run_made_up(plan)
    assert tally.breakages > 0 and tally.void > 0 and tally.retries == 0
    assert {(path.stat().st_size) for path in (tmp_path / "tries").iterdir()} == {1}


def test_a_unit_that_dies_is_tried_again_and_harms_no_other(run_made_up, tmp_path, two_tries):
    plan = MadeUp({"crash": 1, "crash-1": 1, "slow-0.2": 8})
    run_made_up(plan)
    rows, errors = outcomes(tmp_path / "x", plan)
    assert [r["attempts"] for r in rows] == [2, 2] + [1] * 8 and rows[1]["outcome"] != "infrastructure_error"
    assert rows[0]["outcome"] == "infrastructure_error"
    assert len(errors) == 3
    for error in errors:
        assert "Segmentation fault" in error["message"] and "in made_up_unit" in error["report"]


def test_a_unit_that_hangs_is_ended_and_says_where(run_made_up, tmp_path, one_try):
    plan = MadeUp({"hang": 1, "ok": 4})
    run_made_up(plan, timeout_s=1.0)
    rows, errors = outcomes(tmp_path / "x", plan)
    assert rows[0]["outcome"] == "infrastructure_error" and rows[0]["attempts"] == 1
    assert {e["message"] for e in errors} == {"not done after 1 s: its process was ended"}
    assert all("in made_up_unit" in e["report"] for e in errors)


@pytest.mark.slow
def test_a_unit_that_eats_memory_is_ended(run_made_up, tmp_path, one_try):
    plan = MadeUp({"memory": 1, "ok": 4})
    run_made_up(plan)
    rows, errors = outcomes(tmp_path / "x", plan)
    assert rows[0]["outcome"] == "infrastructure_error" and len(errors) == 1
    assert all("MiB of memory" in e["message"] for e in errors)


@pytest.mark.slow
def test_a_worker_that_answers_no_more_is_ended(run_made_up, tmp_path, one_try, monkeypatch):
    monkeypatch.setattr(pool, "_LATE_S", 2.0)
    plan = MadeUp({"stop": 1, "ok": 4})
    run_made_up(plan, timeout_s=2.0)
    rows, errors = outcomes(tmp_path / "x", plan)
    assert rows[0]["outcome"] == "infrastructure_error"
    assert [e["message"] for e in errors] == ["not done after 2 s: its process was ended"]


@pytest.mark.slow
def test_workers_that_their_nanny_does_not_bring_back_are_replaced(tmp_path):
    plan = MadeUp({"crash-1": 1, "ok": 2})
    (tmp_path / "tries").mkdir()
    settings = WorkerPoolSettings(workers=1, cache_dir=tmp_path / "tries")
    with embedded_worker_pool(settings, made_up_unit) as alone, config.set({LOST: "100ms"}):
        tally = runner.run_experiment(plan, tmp_path / "x", lambda: nullcontext(alone))
    # The next unit may have been given to the worker that is gone.
    assert (tally.done, tally.errors) == (3, 0) and tally.retries in (1, 2)


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
        [decided(r) for r in Ledger.open(tmp_path / name, plan, read_only=True).rows()]
        for name in ("before", "after")
    )
    assert before == after and len({r["void_reason"] for r in after}) == 2


@pytest.mark.slow
def test_workers_that_are_killed_are_replaced(run_made_up, shared_pool, tmp_path):
    plan = MadeUp({"slow-0.3": 8})
    killed = []

    def kill_one(tally):
        if tally.workers and len(killed) < 2 and tally.ended_here >= 2 * len(killed):
            victim = next(iter(shared_pool._client.run(os.getpid).values()))
            killed.append(victim)
            os.kill(victim, signal.SIGKILL)

    tally = run_made_up(plan, show=kill_one)
    rows, errors = outcomes(tmp_path / "x", plan)
    assert len(killed) == 2 and tally.done == tally.total == 8 and tally.errors == 0
    assert 1 <= len(errors) <= 2 and sum(r["attempts"] for r in rows) == 8 + len(errors)
    assert all(e["message"] == "its process has died" for e in errors)


def test_workers_that_do_not_come_up_are_told_of():
    class Nobody:
        def wait_for_workers(self, workers, timeout):
            raise TimeoutError

    with pytest.raises(InputError, match=r"this machine: has had fewer than 3 workers for 120 s; wait"):
        pool._await(Nobody(), 3, "this machine", "wait")
