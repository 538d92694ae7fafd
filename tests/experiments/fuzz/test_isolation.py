"""Jobs that hang or die take nothing with them, and say where they were."""

import os
import re
import signal
import time

import pytest

from experiments.fuzz.isolation import run_isolated


def act(item):
    """Do what an item says and yield it, word by word."""
    for word in item.split():
        if word == "sleep":
            time.sleep(1000)
        elif word == "spin":
            # In C and without giving the interpreter up: nothing in Python could end it.
            re.match(r"(a+)+$", "a" * 60 + "b")
        elif word == "exit":
            os._exit(3)
        elif word == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        elif word == "raise":
            raise ValueError("told to")
        yield word, os.getpid()


def run(items, workers=1, timeout_s=60.0, left=lambda death: None):
    deaths = []

    def after_death(death):
        deaths.append(death)
        return [("dead", 0)], left(death)

    rows = list(run_isolated(act, items, workers, timeout_s, after_death))
    return rows, deaths


def test_every_item_is_run_in_one_process_that_is_not_this_one():
    rows, deaths = run(["a b", "c", "", "d"])
    assert [word for word, _ in rows] == ["a", "b", "c", "d"] and deaths == []
    processes = {process for _, process in rows}
    assert len(processes) == 1 and os.getpid() not in processes


def test_two_processes_share_the_items():
    rows, _ = run([f"w{k}" for k in range(6)], workers=2)
    assert sorted(word for word, _ in rows) == [f"w{k}" for k in range(6)]
    assert 1 <= len({process for _, process in rows}) <= 2


@pytest.mark.parametrize(("how", "said"), [("sleep", "in act"), ("spin", "in act")])
def test_a_job_that_hangs_is_ended_and_says_where(how, said):
    rows, (death,) = run([f"a {how} b", "c"], timeout_s=3.0)
    assert [word for word, _ in rows] == ["a", "dead", "c"]
    assert death.timed_out and death.rows == 1 and death.item == f"a {how} b"
    assert said in death.report


@pytest.mark.parametrize(
    ("how", "said"),
    [("exit", "exit code 3"), ("crash", "Segmentation fault"), ("raise", "exit code 1")],
)
def test_a_process_that_dies_is_reported_and_replaced(how, said):
    rows, (death,) = run([f"a {how} b", "c"])
    assert [word for word, _ in rows] == ["a", "dead", "c"]
    assert not death.timed_out and said in death.report


def test_what_is_left_of_an_item_is_done_in_another_process():
    rows, deaths = run(["a exit b", "c"], left=lambda death: "b")
    assert [word for word, _ in rows] == ["a", "dead", "b", "c"] and len(deaths) == 1
    assert rows[0][1] != rows[2][1]


def test_who_stops_listening_ends_the_processes():
    rows = run_isolated(act, ["a sleep"], 1, 60.0, lambda death: ([], None))
    _, process = next(rows)
    rows.close()
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
