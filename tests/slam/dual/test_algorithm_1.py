"""Algorithm 1 of the paper: thread 1, else thread 2, else failure."""

from types import SimpleNamespace

import pytest

from dslab.slam.dual.fusion.merge_recovered import Recovered
from dslab.slam.dual.recovery.interface import RecoveryResult
from dslab.slam.dual.recovery_jobs import RecoveryFailure, RecoveryJob, algorithm_1

FAILS, RUNS = "fails", "runs"


def outcome(*threads):
    """What the algorithm returns of threads that run still, have failed, or returned a map of this name."""
    runs = []
    for told in threads:
        found = SimpleNamespace(old_map_id=0) if told not in (FAILS, RUNS) else None
        result = RecoveryResult(told, found is not None, "" if found else "propagation", alignment=found)
        runs.append(SimpleNamespace(is_over=told != RUNS, execute=lambda result=result: result))
    new = SimpleNamespace(map=SimpleNamespace(map_id=3), since=50)
    return algorithm_1(RecoveryJob(new, (), (), 5, 400, runs=runs))


@pytest.mark.parametrize("threads", [(RUNS, RUNS), (RUNS, "second"), (FAILS, RUNS), (RUNS, FAILS)])
def test_it_waits_for_the_threads_before_one_that_ends(threads):
    assert outcome(*threads) is None


@pytest.mark.parametrize("threads", [("map", RUNS), ("map", "second"), (FAILS, "map"), (FAILS, "map", FAILS)])
def test_it_returns_the_map_of_the_first_thread_that_succeeds(threads):
    found = outcome(*threads)
    assert isinstance(found, Recovered)
    assert (found.extended, found.new_id, found.keyframes, found.since) == ("map", 3, 5, 50)


def test_it_returns_failure_when_every_thread_has_failed():
    assert outcome(FAILS, FAILS) == RecoveryFailure(3, 50, (("propagation", ""),) * 2)
