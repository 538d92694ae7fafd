"""Every item of a pool ends, whatever becomes of its process, and no process outlives its owner."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from importlib import import_module
from multiprocessing import active_children, get_context

import psutil
import pytest

from dslab.experiments.jobs import pool as pools
from dslab.experiments.jobs.pool import MEMORY_FLOOR_MB, PoolSettings, ProcessPool, run_each
from dslab.experiments.runs.ending import EndKind
from dslab.scenarios.errors import InputError, MachineError, notice

KILLED = """
import os, signal
from dslab.experiments.jobs.pool import run_each
if __name__ == "__main__":
    for _, worker in run_each(eval, ["__import__('os').getpid()"], 1):
        print(worker, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
"""


def told_of_an_input(item):
    notice("walk", "has no times.txt")
    return item


def test_what_the_parent_has_said_of_an_input_no_worker_says_again(capfd):
    assert sorted(result for _, result in run_each(told_of_an_input, [1, 2], 2)) == [1, 2]
    assert capfd.readouterr().err == ""


def told(what):
    """Do as the item says; return the process."""
    if what == "raise":
        raise ValueError("told to")
    if what == "crash":
        signal.raise_signal(signal.SIGSEGV)
    if what == "leave":
        os._exit(7)
    if what == "spin":
        # Compiled code that holds the interpreter's lock: nothing in Python could end it.
        re.match(r"(a+)+$", "a" * 60 + "b")
    if what == "stop":
        os.kill(os.getpid(), signal.SIGSTOP)
    if what == "lock":
        return threading.Lock()
    if what == "memory":
        held = []
        for _ in range(4000):
            held.append(b"x" * 2**22)
            time.sleep(0.002)
    if what == "variables":
        cv2 = import_module("cv2").getNumThreads()
        return {name: os.environ.get(name) for name in pools.SINGLE_THREADED} | {"cv2": cv2}
    if what == "listening":
        return [c.laddr for c in psutil.Process().net_connections() if c.status == "LISTEN"]
    if what == "imports of a unit":
        return import_module("dslab.experiments.eq1.trial") is not None
    if isinstance(what, float):
        time.sleep(what)
    return os.getpid()


def ended(items, **settings):
    """The end of each item by the item."""
    with ProcessPool(told, PoolSettings(**settings)) as pool:
        return {end.item: end for end in pool.run(deque(items))}


def test_a_process_serves_one_item_after_another_and_ends_with_its_pool():
    with ProcessPool(told, PoolSettings()) as pool:
        values = [end.value for end in pool.run(deque([0.0, "listening", "variables", 0.0]))]
        assert psutil.pid_exists(values[0]) and not pool.busy
    assert values[0] == values[3] != os.getpid() and values[1] == []
    assert values[2] == dict.fromkeys(pools.SINGLE_THREADED, "1") | {"cv2": 1}
    assert not psutil.pid_exists(values[0])


def test_every_end_of_an_item_is_told_and_harms_no_other():
    items = ["raise", "crash", "leave", "lock", 0.0]
    found = ended(items, time_s=60.0)
    assert list(found) == items
    assert isinstance(found["raise"].error, ValueError) and found["raise"].message == "ValueError: told to"
    assert found["crash"].fault is found["leave"].fault is EndKind.CRASHED
    assert (
        found["crash"].message
        == "its process has died (exit code -11): Fatal Python error: Segmentation fault"
    )
    assert "in told" in found["crash"].report
    assert found["leave"].message == "its process has died (exit code 7)"
    assert "pickle" in found["lock"].message and found[0.0].value > 0
    with pytest.raises(ValueError, match="told to"):
        found["raise"].result()
    with pytest.raises(MachineError, match=r"has died \(exit code 7\)"):
        found["leave"].result()


def test_an_item_that_hangs_is_ended_with_its_stacks():
    found = ended(["spin", 0.0], time_s=1.0)
    assert found["spin"].fault is EndKind.TIMED_OUT and "in told" in found["spin"].report
    assert found["spin"].message == "not done after 1 s: its process was ended" and found[0.0].value


@pytest.mark.slow
def test_an_item_with_a_process_of_its_own_shares_it_with_none():
    found = ended([0.0, 0.01, 0.02], fresh=True)
    assert len({end.value for end in found.values()}) == 3


@pytest.mark.slow
def test_a_process_that_does_not_answer_is_ended(monkeypatch):
    monkeypatch.setattr(pools, "LATE_S", 0.5)
    found = ended(["stop"], time_s=1.0)
    assert found["stop"].fault is EndKind.TIMED_OUT


@pytest.mark.slow
def test_an_item_that_uses_too_much_memory_is_ended_and_the_floor_holds_what_a_unit_imports():
    found = ended(["memory", "imports of a unit"], memory_mb=MEMORY_FLOOR_MB)
    assert found["memory"].fault is EndKind.OUT_OF_MEMORY and "MiB of memory" in found["memory"].message
    assert found["imports of a unit"].value is True


@pytest.mark.slow
def test_a_worker_that_is_killed_is_replaced():
    with ProcessPool(told, PoolSettings()) as pool:
        (first,) = pool.run(deque([0.0]))
        os.kill(first.value, signal.SIGKILL)
        (second,) = pool.run(deque([0.0]))
    assert second.value != first.value


@pytest.mark.parametrize("settings", [{"memory_mb": 1}, {"time_s": 0.0}, {"time_s": 1e12}])
def test_limits_that_nothing_could_keep_are_one_line(settings):
    with pytest.raises(InputError, match=r"--(memory|timeout): "):
        PoolSettings(**settings)


def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    (tmp_path / "killed.py").write_text(KILLED)
    words = [sys.executable, str(tmp_path / "killed.py")]
    ended = subprocess.run(words, stdout=subprocess.PIPE, text=True, timeout=60, check=False)
    try:
        worker = psutil.Process(int(ended.stdout))
    except psutil.NoSuchProcess:
        return
    worker.wait(timeout=20)


def test_who_ends_early_waits_for_nothing_and_ends_no_process_of_others():
    bystander = get_context("spawn").Process(target=time.sleep, args=(60,), daemon=True)
    bystander.start()
    others, started_s = set(active_children()), time.monotonic()
    results = run_each(told, [0.0, 90.0, 91.0], 2)
    assert next(results)[0] == 0.0
    with pytest.raises(KeyboardInterrupt):
        results.throw(KeyboardInterrupt)
    assert time.monotonic() - started_s < 60 and set(active_children()) == others
    bystander.kill()
    bystander.join()
