"""The set of units run depends only on the spec and the records, not on the order in which they end."""

import random

import pytest
from unit_fakes import MadeUp, made_up_record

from experiments.campaign.schedule import Schedule
from experiments.campaign.stopping import NarrowEnough, event_column, stopping_rule
from experiments.eq1.spec import Stopping

PLAN = MadeUp({"a": 3, "b": 5})


def run(plan, rule=None, done=(), in_flight=1, seed=0):
    """Run a schedule with units that end in random order; return the started units and the schedule."""
    rng = random.Random(seed)
    schedule = Schedule(plan, done, rule)
    started, flying = [], []
    while not schedule.complete:
        while len(flying) < in_flight and (unit := schedule.next()) is not None:
            started.append((unit.cell, unit.index))
            flying.append(unit)
        assert flying, "nothing to wait for and not complete"
        unit = flying.pop(rng.randrange(len(flying)))
        schedule.finish(made_up_record(unit))
    assert schedule.next() is None and not flying
    return started, schedule


def test_units_come_by_index_over_all_cells():
    started, schedule = run(PLAN)
    assert started == [
        ("a", 0), ("b", 0), ("a", 1), ("b", 1), ("a", 2), ("b", 2), ("b", 3), ("b", 4),
    ]  # fmt: skip
    assert (schedule.done, schedule.total, schedule.stopped_cells()) == (8, 8, {})


def test_finished_units_are_not_run_again():
    done = [made_up_record(PLAN.unit(cell, index)) for cell, index in [("b", 0), ("b", 3), ("a", 1)]]
    started, schedule = run(PLAN, done=done)
    assert started == [("a", 0), ("b", 1), ("a", 2), ("b", 2), ("b", 4)]
    assert [(r["cell"], r["index"]) for r in schedule.records()] == [
        *(("a", i) for i in range(3)), *(("b", i) for i in range(5)),
    ]  # fmt: skip


class After:
    """Stops a cell once its first units have two breakages; evaluated at 2, 4, 6 …"""

    def __init__(self):
        self.evaluated = []

    def checkpoints(self, budget):
        return range(2, budget, 2)

    def is_met(self, records):
        self.evaluated.append([r["index"] for r in records])
        return sum(bool(r["breakage"]) for r in records) >= 2


@pytest.mark.parametrize("in_flight", [1, 2, 7])
def test_a_rule_gives_the_same_units_for_any_number_of_workers(in_flight):
    plan = MadeUp({f"c{k}": 30 for k in range(8)})
    wanted, one = run(plan, After())
    rule = After()
    started, schedule = run(plan, rule, in_flight=in_flight, seed=in_flight)
    assert sorted(started) == sorted(wanted) and schedule.stopped_cells() == one.stopped_cells()
    assert all(
        evaluated == list(range(len(evaluated))) and len(evaluated) % 2 == 0 for evaluated in rule.evaluated
    )
    assert 0 < schedule.total == len(started) < 8 * 30
    assert len(set(schedule.stopped_cells().values())) > 1


def test_a_resumed_run_stops_at_the_same_units_as_an_uninterrupted_one():
    plan = MadeUp({"a": 40, "b": 40})
    wanted, whole = run(plan, After(), in_flight=3)
    for cut in (1, 5, len(wanted)):
        done = [made_up_record(plan.unit(cell, index)) for cell, index in wanted[:cut]]
        started, schedule = run(plan, After(), done)
        assert sorted(started) == sorted(wanted[cut:]) and schedule.stopped_cells() == whole.stopped_cells()


def test_a_rule_that_is_never_met_runs_the_budget():
    class Never(After):
        def is_met(self, records):
            return False

    started, schedule = run(PLAN, Never(), in_flight=2)
    assert len(started) == 8 and schedule.stopped_cells() == {}


def test_the_rule_of_a_spec_requires_valid_units_and_a_narrow_interval():
    rule = NarrowEnough(Stopping(quantity="p0", half_width=0.2, min_units=20))
    assert list(rule.checkpoints(45)) == [20, 30, 40]
    good = {"outcome": "completed", "breakage": False}
    void = {"outcome": "void", "breakage": None}
    assert rule.is_met([good] * 20)
    assert not rule.is_met([good] * 19 + [void])
    assert not rule.is_met([good, good | {"breakage": True}] * 10)
    assert rule.is_met([good, good | {"breakage": True}] * 40)
    assert stopping_rule(None) is None


def test_each_quantity_has_its_column():
    assert [event_column(q) for q in ("p0", "pr2", "d1")] == ["breakage", "cross_r2_failed", "d1"]
