"""Worker processes end with the process that started them."""

import os
import subprocess
import sys
import threading
import time
from multiprocessing import active_children, get_context

import psutil
import pytest

from dslab.experiments.runs.processes import call_in_process, process_pool, side_by_side

KILLED = """
import os, signal
from dslab.experiments.runs.processes import process_pool
if __name__ == "__main__":
    with process_pool(1) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
"""


def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    (tmp_path / "killed.py").write_text(KILLED)
    words = [sys.executable, str(tmp_path / "killed.py")]
    ended = subprocess.run(words, stdout=subprocess.PIPE, text=True, timeout=60, check=False)
    try:
        worker = psutil.Process(int(ended.stdout))
    except psutil.NoSuchProcess:
        return
    worker.wait(timeout=20)


def test_workers_are_killed_if_the_block_raises():
    def work():
        with process_pool(1) as pool:
            pids.append(pool.submit(os.getpid).result())
            raise KeyboardInterrupt

    pids: list[int] = []
    bystander = get_context("spawn").Process(target=time.sleep, args=(60,), daemon=True)
    bystander.start()
    with pytest.raises(KeyboardInterrupt):
        work()
    assert not psutil.pid_exists(pids[0])
    assert bystander.is_alive(), "another's process"
    bystander.kill()
    bystander.join()


def test_a_call_has_a_process_of_its_own_whose_every_end_is_told():
    others = set(active_children())
    assert call_in_process(os.getpid, (), 120) != os.getpid()
    with pytest.raises(ValueError, match="'x'"):
        call_in_process(int, ("x",), 120)
    with pytest.raises(ChildProcessError, match="exit code 7"):
        call_in_process(os._exit, (7,), 120)
    with pytest.raises(TimeoutError):
        call_in_process(time.sleep, (300,), 1)
    with pytest.raises(RuntimeError, match="pickle"):
        call_in_process(threading.Lock, (), 120)
    assert set(active_children()) <= others


def test_calls_side_by_side_end_with_the_caller():
    others = set(active_children())
    calls = [(time.sleep, (seconds,), 300) for seconds in (0, 90, 90)]
    started_s = time.monotonic()
    for _ in side_by_side(2, call_in_process, calls):
        break
    assert time.monotonic() - started_s < 60 and set(active_children()) <= others


def test_who_ends_early_waits_for_no_call_that_was_not_begun():
    begun = []

    def call(seconds: float) -> float:
        begun.append(seconds)
        call_in_process(time.sleep, (seconds,), 60.0)
        return seconds

    results = side_by_side(1, call, [(0.01,), (50.0,), (50.0,), (50.0,)])
    assert next(results) == 0.01
    started_s = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        results.throw(KeyboardInterrupt)
    assert time.monotonic() - started_s < 30 and len(begun) < 4
