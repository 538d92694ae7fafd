"""The set of units run depends only on the spec and the records; cells of an index stay on one worker."""

import random

import pytest
from unit_fakes import MadeUp, made_up_record

from dslab.experiments.campaign.schedule import Schedule

PLAN = MadeUp({"a": 3, "b": 5})


def run(plan, done=(), workers=1, seed=0):
    """Run a schedule with units that end in random order; return the started units by worker."""
    rng = random.Random(seed)
    schedule = Schedule(plan, done)
    started, flying = [], {}
    while not schedule.complete:
        for worker in map(str, range(workers)):
            if worker not in flying and (unit := schedule.next(worker)) is not None:
                started.append((unit.cell, unit.index, worker))
                flying[worker] = unit
        assert flying, "nothing to wait for and not complete"
        schedule.finish(made_up_record(flying.pop(rng.choice(sorted(flying)))))
    assert schedule.next("0") is None and not flying
    return started, schedule


def test_units_come_by_index_over_all_cells():
    started, schedule = run(PLAN)
    assert [unit[:2] for unit in started] == [
        ("a", 0), ("b", 0), ("a", 1), ("b", 1), ("a", 2), ("b", 2), ("b", 3), ("b", 4),
    ]  # fmt: skip
    assert (schedule.done, schedule.total) == (8, 8)


def test_finished_units_are_not_run_again():
    done = [made_up_record(PLAN.unit(cell, index)) for cell, index in [("b", 0), ("b", 3), ("a", 1)]]
    started, schedule = run(PLAN, done)
    assert [unit[:2] for unit in started] == [("a", 0), ("b", 1), ("a", 2), ("b", 2), ("b", 4)]
    assert [(r["cell"], r["index"]) for r in schedule.records()] == [
        *(("a", i) for i in range(3)), *(("b", i) for i in range(5)),
    ]  # fmt: skip


def test_records_beyond_the_units_of_a_cell_do_not_count():
    done = [made_up_record(PLAN.unit("a", index)) for index in range(7)]
    assert (Schedule(PLAN, done).done, Schedule(PLAN, done).total) == (3, 8)


@pytest.mark.parametrize("workers", [2, 3, 7])
def test_cells_of_an_index_stay_on_one_worker_until_the_others_run_dry(workers):
    plan = MadeUp({f"c{k}": 30 for k in range(8)})
    started, _ = run(plan, workers=workers, seed=workers)
    assert sorted(unit[:2] for unit in started) == sorted(unit[:2] for unit in run(plan)[0])
    workers_of = {index: {w for _, i, w in started if i == index} for index in range(30)}
    assert all(len(workers_of[index]) == 1 for index in range(30 - workers))


@pytest.mark.parametrize("workers", [2, 3, 7])
def test_replicates_of_a_world_stay_on_one_worker_until_the_others_run_dry(workers):
    plan = MadeUp({"a": 60, "b": 60}, replicates_per_world=3)
    started, _ = run(plan, workers=workers, seed=workers)
    assert sorted(unit[:2] for unit in started) == sorted(unit[:2] for unit in run(plan)[0])
    workers_of = {world: {w for _, i, w in started if i // 3 == world} for world in range(20)}
    assert all(len(workers_of[world]) == 1 for world in range(20 - workers))
