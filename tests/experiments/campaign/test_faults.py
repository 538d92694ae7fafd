"""A run ends with a row for every unit, whatever happens to its processes."""

import os
import signal
from collections import deque
from contextlib import nullcontext
from functools import partial
from types import SimpleNamespace

import pytest
from dask import config
from unit_fakes import MadeUp, imports_of_a_unit, made_up_record, made_up_unit, rendered_unit

from dslab.experiments.campaign import clusters, runner
from dslab.experiments.campaign import worker_pool as pool
from dslab.experiments.campaign.clusters import embedded_worker_pool
from dslab.experiments.campaign.ledger import Ledger
from dslab.experiments.campaign.unit_job import unit_record
from dslab.experiments.campaign.worker_pool import WorkerPoolSettings
from dslab.experiments.eq1.record_table import normalise
from dslab.experiments.eq1.records import decided
from dslab.scenarios.errors import MachineError

LOST = "distributed.deploy.lost-worker-timeout"
pytestmark = pytest.mark.usefixtures("shared_pool")


@pytest.fixture
def one_try(monkeypatch):
    monkeypatch.setattr(runner, "TRIES", 1)


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


def test_units_that_raise_or_return_bad_records_are_tried_again_and_kept_as_errors(run_made_up, tmp_path):
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
    plan = MadeUp({"a": 6, "b": 6, "c": 6})
    tally = run_made_up(plan)
    assert tally.breakages > 0 and tally.void > 0 and tally.retries == 0
    assert {(path.stat().st_size) for path in (tmp_path / "tries").iterdir()} == {1}


def test_a_unit_that_hangs_is_ended_and_reported_and_tried_again_and_harms_no_other(run_made_up, tmp_path):
    plan = MadeUp({"spin-1": 1, "slow-0.1": 4})
    tally = run_made_up(plan, timeout_s=2.0)
    rows, (error,) = outcomes(tmp_path / "x", plan)
    assert [r["attempts"] for r in rows] == [2, 1, 1, 1, 1] and tally.errors == 0
    assert error["message"] == "not done after 2 s: its process was ended"
    assert "in made_up_unit" in error["report"]


@pytest.mark.slow
def test_a_unit_that_crashes_is_reported_and_given_up_and_harms_no_other(run_made_up, tmp_path, one_try):
    plan = MadeUp({"crash": 1, "slow-0.2": 4})
    tally = run_made_up(plan)
    rows, (error,) = outcomes(tmp_path / "x", plan)
    assert rows[0]["outcome"] == "infrastructure_error" and (tally.done, tally.errors) == (5, 1)
    assert [r["attempts"] for r in rows] == [1] * 5
    assert "Segmentation fault" in error["message"] and "in made_up_unit" in error["report"]


@pytest.mark.slow
def test_a_unit_that_uses_too_much_memory_is_ended(run_made_up, tmp_path, one_try):
    plan = MadeUp({"memory": 1, "ok": 2})
    run_made_up(plan)
    rows, errors = outcomes(tmp_path / "x", plan)
    assert rows[0]["outcome"] == "infrastructure_error" and len(errors) == 1
    assert all("MiB of memory" in e["message"] for e in errors)


@pytest.mark.slow
def test_a_worker_that_does_not_answer_is_ended(run_made_up, tmp_path, one_try, monkeypatch):
    monkeypatch.setattr(pool, "_LATE_S", 1.0)
    plan = MadeUp({"stop": 1, "ok": 2})
    run_made_up(plan, timeout_s=2.0)
    rows, errors = outcomes(tmp_path / "x", plan)
    assert rows[0]["outcome"] == "infrastructure_error"
    assert [e["message"] for e in errors] == ["not done after 2 s: its process was ended"]


@pytest.mark.slow
def test_workers_that_their_nanny_does_not_restart_are_replaced(tmp_path):
    plan = MadeUp({"crash-1": 1, "ok": 2})
    (tmp_path / "tries").mkdir()
    task = partial(unit_record, made_up_unit, cache_dir=tmp_path / "tries")
    with embedded_worker_pool(WorkerPoolSettings(), task) as alone, config.set({LOST: "100ms"}):
        tally = runner.run_experiment(plan, tmp_path / "x", lambda: nullcontext(alone))
    # The next unit may have been given to the lost worker.
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
    plan = MadeUp({"slow-0.3": 4})
    killed = []

    def kill_one(tally):
        if tally.workers and not killed:
            victim = next(iter(shared_pool._client.run(os.getpid).values()))
            killed.append(victim)
            os.kill(victim, signal.SIGKILL)

    tally = run_made_up(plan, show=kill_one)
    rows, errors = outcomes(tmp_path / "x", plan)
    assert len(killed) == 1 and tally.done == tally.total == 4 and tally.errors == 0
    # The victim may just have been without a unit.
    assert len(errors) <= 1 and sum(r["attempts"] for r in rows) == 4 + len(errors)
    assert all(e["message"] == "its process has died" for e in errors)


def test_workers_that_do_not_start_are_reported(monkeypatch):
    class Nobody:
        def wait_for_workers(self, workers, timeout):
            raise TimeoutError

    monkeypatch.setattr(clusters, "_START_S", 0.0)
    with pytest.raises(MachineError, match=r"this machine: has had fewer than 3 workers for 0 s; wait"):
        clusters._await(Nobody(), 3, "this machine", "wait")


class Mortal:
    """A cluster each of whose processes has ended when it is next looked at."""

    def __init__(self):
        self.pid = 0

    @property
    def workers(self):
        self.pid += 2
        return {0: SimpleNamespace(pid=self.pid), 1: SimpleNamespace(pid=self.pid + 1)}

    def scale(self, number):
        pass


def test_worker_after_worker_that_ends_before_its_first_unit_ends_the_run():
    keeper = clusters.EmbeddedWorkers(Mortal(), 2)
    for _ in range(5):
        keeper.keep_up(1)
    with pytest.raises(MachineError, match=r"10 of its processes in a row have ended before .*--memory"):
        keeper.keep_up(1)


def test_workers_that_end_with_their_units_are_replaced_without_end():
    keeper = clusters.EmbeddedWorkers(Mortal(), 2)
    for _ in range(30):
        keeper.keep_up(1)
        keeper.item_ended()


def test_a_result_whose_worker_has_gone_is_given_up():
    class Lost:
        key, status = "item", "finished"

        def add_done_callback(self, call):
            call(self)

        def result(self, timeout):
            raise TimeoutError

    client = SimpleNamespace(
        submit=lambda *_, **__: Lost(), cancel=lambda *_, **__: None, get_events=lambda _: [], nthreads=dict
    )
    workers = pool.WorkerPool(client, made_up_unit, WorkerPoolSettings())
    workers.start("unit", "gone")
    (ended,) = workers.wait(1.0)
    assert (ended.item, ended.result, ended.message) == ("unit", None, "its process has died")


@pytest.mark.slow
def test_a_memory_limit_below_that_of_a_fresh_worker_ends_the_run(monkeypatch, tmp_path):
    monkeypatch.setattr(pool, "MEMORY_FLOOR_MB", 1)
    monkeypatch.setattr(clusters, "_STARTS_PER_WORKER", 2)
    settings, plan = WorkerPoolSettings(memory_mb=1), MadeUp({"ok": 9})
    with pytest.raises(MachineError, match=r"ended before their first unit|ended in the same error"):
        runner.run_experiment(plan, tmp_path / "x", lambda: clusters.open_worker_pool(settings, made_up_unit))


@pytest.mark.slow
def test_a_worker_at_the_memory_floor_holds_all_that_a_unit_imports():
    with embedded_worker_pool(WorkerPoolSettings(memory_mb=pool.MEMORY_FLOOR_MB), imports_of_a_unit) as one:
        (ended,) = one.run(deque([None]))
    assert ended.result, ended.message
