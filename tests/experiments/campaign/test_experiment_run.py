"""Runs of synthetic units in real processes: the same rows for any number of workers and runs."""

import subprocess
from dataclasses import replace

import pytest
from unit_fakes import MadeUp, made_up_record, rows_of

from dslab.experiments.campaign.folder import SPEC_FILE, claim_folder
from dslab.experiments.campaign.runner import run_experiment
from dslab.experiments.eq1.records import decided
from dslab.experiments.jobs.ledger import LEDGER_FILE, LOCK_FILE, sole_driver
from dslab.experiments.jobs.pool import PoolSettings
from dslab.scenarios.errors import InputError

PLAN = MadeUp({"ok": 25, "slow-0.01": 25})


def test_an_emptied_ledger_is_refused_and_one_that_was_never_begun_is_not(run_made_up, tmp_path):
    folder = tmp_path / "x"
    folder.mkdir()
    (folder / LEDGER_FILE).touch()
    plan = MadeUp({"ok": 2})
    assert run_made_up(plan).ended_here == 2
    (folder / LEDGER_FILE).write_bytes(b"")
    with pytest.raises(InputError, match=r"ledger.sqlite: is empty: its rows are lost; put a copy back"):
        run_made_up(plan)
    assert (folder / LEDGER_FILE).read_bytes() == b""


def test_any_number_of_workers_gives_the_same_rows(run_made_up, tmp_path):
    for name, workers in (("none", None), ("two", PoolSettings(2))):
        tally = run_made_up(PLAN, tmp_path / name, workers)
        assert tally.done == tally.total == 50
    none, two = (rows_of(tmp_path / name, PLAN) for name in ("none", "two"))
    assert none == two
    assert all(row == decided(made_up_record(PLAN.unit(row["cell"], row["index"]))) for row in two)


def test_a_run_resumes_and_opens_no_workers_when_all_is_done(run_made_up, tmp_path):
    folder = tmp_path / "x"

    def interrupt(tally):
        if tally.ended_here >= 5:
            raise KeyboardInterrupt

    plan = MadeUp({"ok": 10})
    with pytest.raises(KeyboardInterrupt):
        run_made_up(plan, show=interrupt)
    before = rows_of(folder, plan)
    assert 5 <= len(before) < 10
    assert run_made_up(plan).ended_here == 10 - len(before)
    assert len(rows_of(folder, plan)) == 10 and all(row in rows_of(folder, plan) for row in before)

    def nobody():
        raise AssertionError("no workers are needed")

    assert run_experiment(plan, folder, nobody).done == 10
    assert run_experiment(replace(plan, cells={"ok": 7}), folder, nobody).total == 7


def test_errors_given_up_are_tried_again_on_request_only(run_made_up, tmp_path):
    plan = MadeUp({"error-5": 1, "ok": 2})
    assert run_made_up(plan).errors == 1
    assert run_made_up(plan).ended_here == 0
    tally = run_made_up(plan, retry_errors=True)
    assert (tally.ended_here, tally.errors, tally.retries) == (1, 0, 1)


def test_a_folder_of_another_spec_or_with_other_files_or_in_use_is_refused(run_made_up, tmp_path):
    plan, folder = MadeUp({"ok": 2}), tmp_path / "x"
    run_made_up(plan)
    spec, before = (folder / SPEC_FILE).read_text(), rows_of(folder, plan)
    with pytest.raises(InputError, match="holds rows of another spec"):
        run_made_up(replace(plan, root_seed=1))
    assert (folder / SPEC_FILE).read_text() == spec and rows_of(folder, plan) == before
    with sole_driver(folder), pytest.raises(InputError, match="another run is at work"):
        run_made_up(plan)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    with pytest.raises(InputError, match="already holds files"):
        run_made_up(plan, folder=tmp_path / "other")


def test_units_that_the_code_now_draws_differently_are_refused(run_made_up, tmp_path):
    class Redrawn(MadeUp):
        def unit(self, cell, index):
            return super().unit(cell, index + 100).model_copy(update={"index": index})

    run_made_up(MadeUp({"ok": 2}))
    with pytest.raises(InputError, match="the code now makes ok:0 another unit"):
        run_made_up(Redrawn({"ok": 3}))


def test_a_folder_of_a_driver_killed_at_its_start_is_reused(tmp_path):
    for name in (SPEC_FILE, LOCK_FILE, LEDGER_FILE):
        (tmp_path / name).write_text("")
        claim_folder(tmp_path)


@pytest.fixture
def small_disk(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", disk], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("no tmpfs may be mounted here")
    yield disk
    subprocess.run(["umount", disk], check=True)


def test_a_full_disk_ends_the_run_in_one_line_and_the_next_run_resumes(run_made_up, small_disk, tmp_path):
    plan, folder, filler = MadeUp({"ok": 12}), small_disk / "x", small_disk / "filler"

    def fill(tally):
        # Several units may end between two calls.
        if tally.ended_here >= 4 and not filler.exists():
            with pytest.raises(OSError, match="No space left"):
                filler.write_bytes(b"x" * 2**20)

    with pytest.raises(InputError, match="the disk is full; free some space and run the same command again"):
        run_made_up(plan, folder=folder, show=fill)
    filler.unlink()
    kept = rows_of(folder, plan)
    assert 4 <= len(kept) < 12
    assert run_made_up(plan, folder=folder).ended_here == 12 - len(kept)
    assert [row for row in rows_of(folder, plan) if row in kept] == kept
