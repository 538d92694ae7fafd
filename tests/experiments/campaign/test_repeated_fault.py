"""A fault that repeats on every unit stops the run before it uses up the tries of the rest."""

from contextlib import nullcontext

import pytest
from pool_fakes import LocalPool
from unit_fakes import MadeUp, made_up_record, rows_of

from dslab.experiments.campaign.folder import open_ledger
from dslab.experiments.campaign.runner import run_experiment
from dslab.scenarios.errors import MachineError

PLAN = MadeUp(dict.fromkeys("abc", 8))


@pytest.fixture
def run(tmp_path):
    """A function that runs a plan; units for which `fails` is true raise."""

    def run_with(fails, plan=PLAN):
        def job(unit, **options):
            if fails(unit):
                raise OSError(28, "No space left on device", f"/cache/{unit.unit_id}-{unit.index}")
            return made_up_record(unit)

        return run_experiment(plan, tmp_path / "x", lambda: nullcontext(LocalPool(job)))

    return run_with


def attempts(folder):
    with open_ledger(folder, PLAN, read_only=True) as ledger:
        return len(ledger.errors())


def test_a_fault_of_every_unit_stops_the_run_with_its_cause_and_the_run_resumes(run, tmp_path):
    with pytest.raises(
        MachineError, match=r"the last 3 units ended in the same error: OSError.*No space left"
    ):
        run(lambda unit: True)
    assert rows_of(tmp_path / "x", PLAN) == [] and attempts(tmp_path / "x") == 3
    tally = run(lambda unit: False)
    assert (tally.done, tally.errors, tally.ended_here) == (24, 0, 24)


def test_a_disk_that_fills_during_a_run_stops_it_and_keeps_the_rows(run, tmp_path):
    with pytest.raises(MachineError, match="No space left"):
        run(lambda unit: unit.index >= 3)
    before = rows_of(tmp_path / "x", PLAN)
    assert len(before) == 9 and attempts(tmp_path / "x") == 3
    with pytest.raises(MachineError, match="No space left"):
        run(lambda unit: True)
    assert rows_of(tmp_path / "x", PLAN) == before
    tally = run(lambda unit: False)
    assert (tally.done, tally.errors, tally.ended_here) == (24, 0, 15)


@pytest.mark.parametrize("broken", ["ab", "c"])
def test_cells_whose_units_always_fail_are_given_up_and_the_others_run(run, broken):
    tally = run(lambda unit: unit.cell in broken)
    assert tally.done == 24 and tally.errors == 8 * len(broken) and tally.retries == 4 * tally.errors
    assert "No space left" in tally.cause


def test_errors_that_differ_or_pass_do_not_stop_a_run(run):
    tried = set()

    def first_time(unit):
        new = unit.unit_id not in tried and unit.index % 2 == 0
        tried.add(unit.unit_id)
        return new and unit.cell == "a"

    tally = run(first_time)
    assert (tally.done, tally.errors, tally.retries) == (24, 0, 4)
