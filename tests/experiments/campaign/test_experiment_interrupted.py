"""A driver that is ended during its run: finished units are kept, and the next driver resumes."""

import signal
import sqlite3
import subprocess
import sys
import time
from os import killpg
from pathlib import Path

import psutil
import pytest
from unit_fakes import MadeUp, made_up_record, planted_unit, rows_of

from dslab.experiments.campaign.boundary_schedule import BoundarySchedule
from dslab.experiments.campaign.folder import open_ledger
from dslab.experiments.eq1.boundary_plan import boundary_plan
from dslab.experiments.eq1.record_table import normalise
from dslab.experiments.eq1.records import decided
from dslab.experiments.eq1.spec import load_spec
from dslab.experiments.jobs.ledger import LEDGER_FILE
from dslab.scenarios.errors import InputError

# Programs that a shell starts in the background ignore interrupts.
HANDLES_INTERRUPTS = f"""
import signal, sys; sys.path.insert(0, {str(Path(__file__).parents[1])!r})
signal.signal(signal.SIGINT, signal.default_int_handler)
"""
DRIVER = """
from pathlib import Path
from functools import partial
from dslab.experiments.campaign.runner import run_experiment
from dslab.experiments.jobs.pool import PoolSettings, open_pool
from unit_fakes import MadeUp, made_up_unit
if __name__ == "__main__":
    plan, task = MadeUp({"slow-0.05": 40}), made_up_unit
    run_experiment(plan, Path(sys.argv[1]), lambda: open_pool(task, PoolSettings(2)))
"""
DSLAB = """
if __name__ == "__main__":
    import dslab.experiments.eq1.trial
    from dslab.experiments.cli import main
    from unit_fakes import slow_unit
    dslab.experiments.eq1.trial.run_unit = slow_unit
    main()
"""
BOUNDARY = DSLAB.replace("slow_unit", "slow_planted_unit")
pytestmark = pytest.mark.slow


@pytest.fixture
def command(tmp_path):
    """A function that writes a program and returns its command line."""

    def made(program, *arguments):
        script = tmp_path / "program.py"
        script.write_text(HANDLES_INTERRUPTS + program)
        return [sys.executable, str(script), *map(str, arguments)]

    return made


def rows_so_far(folder, plan):
    """Number of rows; 0 while the ledger is being created."""
    try:
        return len(rows_of(folder, plan))
    except InputError:
        return 0


def ended_midway(command, how, folder, plan):
    """End a driver after some units and return its exit code and errors; check that no process is left."""
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as driver:
        deadline_s = time.monotonic() + 120
        while rows_so_far(folder, plan) < 5:
            assert time.monotonic() < deadline_s and driver.poll() is None
            time.sleep(0.1)
        processes = psutil.Process(driver.pid).children(recursive=True)
        if how is signal.SIGKILL:
            driver.kill()
        else:
            killpg(driver.pid, how)  # as a terminal does
        _, said = driver.communicate(timeout=60)
    _, alive = psutil.wait_procs(processes, timeout=30)
    assert alive == []
    return driver.returncode, said


def test_a_driver_that_is_killed_loses_only_the_units_under_way(run_made_up, command, tmp_path):
    plan, folder = MadeUp({"slow-0.05": 40}), tmp_path / "x"
    ended_midway(command(DRIVER, folder), signal.SIGKILL, folder, plan)
    before = rows_of(folder, plan)
    assert 5 <= len(before) < 40
    tally = run_made_up(plan, folder=folder)
    assert tally.ended_here == 40 - len(before) and tally.retries == 0
    assert all(row in rows_of(folder, plan) for row in before)


def test_ctrl_c_on_the_command_is_two_lines_and_exit_130_and_the_same_command_resumes(command, tmp_path):
    spec, folder = load_spec("smoke").model_copy(update={"worlds": 7}), tmp_path / "x"
    run = command(DSLAB, "experiment", "run", "smoke", "--out", folder, "--worlds", 7, "--workers", 2)
    code, said = ended_midway(run, signal.SIGINT, folder, spec)
    assert code == 130
    assert said.splitlines() == [
        f"{folder} keeps the finished units: run the same command again to resume",
        "interrupted: nothing half-written is left",
    ]
    with sqlite3.connect(folder / LEDGER_FILE) as file:
        assert file.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    file.close()
    with open_ledger(folder, spec, read_only=True) as ledger:
        kept = ledger.rows()
    assert 5 <= len(kept) < 42
    for row in kept:
        assert decided(row) == decided(normalise(made_up_record(spec.unit(row["cell"], row["index"])), 2))
    again = subprocess.run(run, capture_output=True, text=True, timeout=300, check=True)
    assert "42 of 42 units" in again.stdout
    with open_ledger(folder, spec, read_only=True) as ledger:
        rows = ledger.rows()
    # Rows include times, hence none was run again.
    assert len(rows) == 42 and all(row in rows for row in kept)


def test_a_boundary_search_that_is_killed_ends_with_the_doses_of_one_that_is_not(command, tmp_path):
    plan, folder = (
        boundary_plan(load_spec("smoke"), "motion_blur", "breakage", 0.5, trials=32),
        tmp_path / "x",
    )
    whole = BoundarySchedule(plan)
    while (unit := whole.next()) is not None:
        whole.finish(planted_unit(unit))
    search = ["experiment", "boundary", "motion_blur", "--of", "breakage", "--fail", "0.5", "--spec", "smoke"]
    search += ["--trials", 32, "--out", folder]
    ended_midway(command(BOUNDARY, *search, "--workers", 2), signal.SIGKILL, folder, plan.spec)
    assert 5 <= len(rows_of(folder, plan.spec)) < 32
    subprocess.run(command(BOUNDARY, *search, "--workers", 1), timeout=300, check=True)
    rows = sorted(rows_of(folder, plan.spec), key=lambda row: row["index"])
    assert rows == [decided(dict(record)) for record in whole.records()]
    assert (folder / "boundary.png").is_file()
