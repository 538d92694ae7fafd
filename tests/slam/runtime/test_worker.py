"""The background thread: order, waiting, and errors."""

import os
import sys
import threading

import pytest

from dslab.slam.runtime.worker import Worker


@pytest.fixture
def worker():
    w = Worker("test")
    yield w
    w.close()


def test_jobs_run_in_order_on_their_own_thread(worker):
    done = []
    for i in range(50):
        worker.submit(lambda i=i: done.append((i, threading.current_thread().name)))
    worker.drain()
    assert done == [(i, "test") for i in range(50)]
    assert worker.pending == 0


def test_pending_counts_waiting_and_running_jobs(worker):
    gate, started = threading.Event(), threading.Event()

    def held():
        started.set()
        gate.wait()

    worker.submit(held)
    worker.submit(lambda: None)
    started.wait()
    assert worker.pending == 2
    gate.set()
    worker.drain()
    assert worker.pending == 0


def test_an_error_is_raised_by_drain_and_submit(worker):
    def fail():
        raise ZeroDivisionError("in the job")

    worker.submit(fail)
    with pytest.raises(ZeroDivisionError, match="in the job"):
        worker.drain()
    with pytest.raises(ZeroDivisionError):
        worker.submit(lambda: None)


def test_closing_drops_waiting_jobs():
    w, done = Worker("test"), []
    gate, started = threading.Event(), threading.Event()

    def held():
        started.set()
        gate.wait()

    w.submit(held)
    w.submit(lambda: done.append(1))
    started.wait()
    threading.Timer(0.05, gate.set).start()
    w.close()
    assert done == []


def test_an_error_can_be_checked_without_waiting(worker):
    def fail():
        raise ZeroDivisionError("in a job")

    worker.check()
    worker.submit(fail)
    worker._thread.join(10)
    with pytest.raises(ZeroDivisionError, match="in a job"):
        worker.check()


@pytest.mark.skipif(sys.platform != "linux", reason="threads have no niceness of their own")
def test_a_worker_of_less_urgency_gives_way_and_the_others_do_not():
    found, worker = [], Worker("test", niceness=3)
    worker.submit(lambda: found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id())))
    worker.drain()
    worker.close()
    own = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    assert found == [min(own + 3, 19)]


@pytest.mark.parametrize(("before_s", "after_s"), [(0.005, 5e-4), (1e-4, 1e-4)])
def test_beside_a_worker_a_thread_that_computes_soon_gives_others_their_turn(monkeypatch, before_s, after_s):
    set_to = []
    monkeypatch.setattr(sys, "getswitchinterval", lambda: before_s)
    monkeypatch.setattr(sys, "setswitchinterval", set_to.append)
    Worker("test").close()
    assert set_to == [after_s]
