"""Calls side by side, each in a process of its own."""

import time

import pytest

from experiments.runs.processes import call_in_process, side_by_side


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
