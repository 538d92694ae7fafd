"""Recovery runs side by side: who gets a worker, and when a run counts as ended."""

import threading
import time
from types import SimpleNamespace

import pytest

from dslab.slam.dual.recovery.interface import Cancellation, RecoveryCost, RecoveryResult, ReusedTime
from dslab.slam.dual.recovery.scheduler import RecoveryRun, build_scheduler
from dslab.slam.runtime.backend import ExecutionMode

PATIENCE_S = 30.0


class Thread:
    """A recovery thread that takes a given time and knows whether it was run."""

    needs_images = False

    def __init__(self, name, seconds, gate=None):
        self.name, self.gate, self.runs = name, gate, 0
        self.cost = RecoveryCost(1e3 * seconds, 0.0, 0.0)

    def run(self, task):
        self.runs += 1
        assert self.gate is None or self.gate.wait(PATIENCE_S)
        return RecoveryResult(None, frames_covered=1)


def run(thread, number=1, at_s=0.0):
    return RecoveryRun(
        number, thread, SimpleNamespace(cancellation=Cancellation(), reused=ReusedTime()), at_s
    )


def names(runs):
    return [r.thread.name for r in runs]


def test_as_many_run_as_there_are_workers_the_lowest_number_first():
    scheduler = build_scheduler(ExecutionMode.LOCKSTEP, 2)
    runs = {n: run(Thread(n, s), k) for n, s, k in [("a1", 4, 1), ("a2", 9, 2), ("b1", 2, 1), ("b2", 1, 2)]}
    for one in runs.values():
        scheduler.submit(one)
    assert names(scheduler.start(0.0)) == ["a1", "b1"], "the first threads of both recoveries"
    assert scheduler.start(1.9) == []
    assert names(scheduler.start(2.0)) == ["a2"] and runs["a2"].started_s == 2.0
    assert scheduler.has_ended(runs["b1"], 2.0) and not scheduler.has_ended(runs["a1"], 3.9)
    assert names(scheduler.start(5.0)) == ["b2"] and runs["b2"].started_s == 4.0, "when a1 had ended"
    assert scheduler.has_ended(runs["b2"], 5.0) and not scheduler.has_ended(runs["a2"], 10.9)
    assert scheduler.has_ended(runs["a2"], 11.0)


def test_a_cancelled_run_frees_its_worker_and_is_never_computed():
    scheduler = build_scheduler(ExecutionMode.LOCKSTEP, 2)
    first, second, third = (run(Thread(n, 5), k) for n, k in (("1", 1), ("2", 2), ("3", 3)))
    for one in (first, second):
        scheduler.submit(one)
    scheduler.start(0.0)
    scheduler.cancel(second, 1.0)
    scheduler.submit(third)
    assert names(scheduler.start(1.0)) == ["3"] and third.started_s == 1.0
    assert scheduler.has_ended(third, 6.0)
    assert (first.thread.runs, second.thread.runs, third.thread.runs) == (0, 0, 1)
    scheduler.submit(waiting := run(Thread("4", 5), 4, 6.0))
    scheduler.cancel(waiting, 6.0)
    assert scheduler.start(100.0) == []


def test_worker_threads_run_side_by_side_and_are_asked_to_end():
    gate = threading.Event()
    scheduler = build_scheduler(ExecutionMode.THREADED, 2)
    runs = [run(Thread(str(n), 0, None if n == 2 else gate), n) for n in (1, 2, 3)]
    for one in runs:
        scheduler.submit(one)
    try:
        assert names(scheduler.start(0.0)) == ["1", "2"]
        give_up_s = time.monotonic() + PATIENCE_S
        while not (started := scheduler.start(0.0)) and time.monotonic() < give_up_s:
            time.sleep(0.01)
        assert names(started) == ["3"] and scheduler.has_ended(runs[1], 0.0), (
            "beside the first, still running"
        )
        assert not scheduler.has_ended(runs[0], 0.0)
        scheduler.cancel(runs[0], 0.0)
        assert runs[0].task.cancellation.requested and not runs[2].task.cancellation.requested
        gate.set()
        scheduler.wait()
        assert scheduler.has_ended(runs[2], 0.0)
    finally:
        gate.set()
        scheduler.close()


def test_an_exception_reaches_the_caller():
    scheduler = build_scheduler(ExecutionMode.THREADED, 1)
    broken = run(Thread("broken", 0))
    broken.thread.run = lambda task: 1 / 0
    scheduler.submit(broken)
    scheduler.start(0.0)
    with pytest.raises(ZeroDivisionError):
        scheduler.wait()
    with pytest.raises(ZeroDivisionError):
        scheduler.has_ended(broken, 0.0)
    scheduler.close()
