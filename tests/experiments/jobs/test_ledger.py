"""The ledger keeps every written row, of one spec, in one order, with one schema."""

import os
import random
import signal
import sqlite3
import subprocess
import sys
from dataclasses import replace
from multiprocessing import get_context

import pandas as pd
import pytest
from unit_fakes import MadeUp, made_up_record

from dslab.experiments.campaign.folder import ERROR_COLUMNS, open_ledger
from dslab.experiments.eq1.record_table import data_frame, normalise
from dslab.experiments.eq1.records import columns, decided, domains, empty_record
from dslab.experiments.jobs.ledger import LEDGER_FILE, LOCK_FILE, sole_driver
from dslab.scenarios.errors import InputError

PLAN = MadeUp({"b": 3, "a": 2})


def record_of(plan, cell, index):
    return normalise(made_up_record(plan.unit(cell, index)), len(plan.threads)) | {"attempts": 1}


def error_of(plan, cell, index, attempt=1, message="no GL"):
    values = (plan.unit(cell, index).unit_id, cell, index, attempt, "now", "1", message, "where")
    return dict(zip(ERROR_COLUMNS, values, strict=True))


def fill(folder, order):
    with open_ledger(folder, PLAN) as ledger:
        for cell, index in order:
            ledger.add(record_of(PLAN, cell, index))


def test_rows_are_read_back_unchanged_in_the_order_of_the_spec(tmp_path):
    fill(tmp_path, [("a", 1), ("b", 2), ("b", 0), ("a", 0)])
    with open_ledger(tmp_path, PLAN) as ledger:
        rows = ledger.rows()
        assert [(r["cell"], r["index"]) for r in rows] == [("b", 0), ("b", 2), ("a", 0), ("a", 1)]
        for row in rows:
            wanted = record_of(PLAN, row["cell"], row["index"])
            assert decided(row) == decided(wanted)


def test_the_table_has_nullable_types_with_and_without_rows(tmp_path):
    kinds = {"bool": "boolean", "int": "Int64", "float": "Float64", "text": "string"}
    wanted = {name: kinds[kind] for name, kind in columns(2).items()}
    with open_ledger(tmp_path, PLAN) as ledger:
        assert {n: str(t) for n, t in data_frame(ledger.rows(), 2).dtypes.items()} == wanted
        for index in range(3):
            ledger.add(record_of(PLAN, "b", index))
        table = data_frame(ledger.rows(), 2)
    assert {n: str(t) for n, t in table.dtypes.items()} == wanted
    assert list(table.columns) == list(columns(2)) and len(table) == 3
    assert table["world_seed"].tolist() == [PLAN.unit("b", i).world_seed for i in range(3)]


def test_another_spec_is_refused_in_one_line_and_changes_nothing(tmp_path):
    fill(tmp_path, [("a", 0)])
    before = (tmp_path / LEDGER_FILE).read_bytes()
    for read_only in (False, True):
        with pytest.raises(InputError, match=r"holds rows of another spec .*; choose a new folder"):
            open_ledger(tmp_path, replace(PLAN, root_seed=1), read_only=read_only)
    assert (tmp_path / LEDGER_FILE).read_bytes() == before


def test_a_ledger_of_another_form_is_refused_and_keeps_its_rows(tmp_path):
    fill(tmp_path, [("a", 0)])
    with sqlite3.connect(tmp_path / LEDGER_FILE) as connection:
        connection.execute("UPDATE meta SET value = '3' WHERE key = 'form'")
    connection.close()
    before = (tmp_path / LEDGER_FILE).read_bytes()
    for read_only in (True, False):
        with pytest.raises(InputError, match=r"another version of the lab; choose a new folder; .*merge"):
            open_ledger(tmp_path, PLAN, read_only=read_only)
    assert (tmp_path / LEDGER_FILE).read_bytes() == before


def test_a_unit_is_written_once(tmp_path):
    with open_ledger(tmp_path, PLAN) as ledger:
        ledger.add(record_of(PLAN, "a", 0))
        with pytest.raises(sqlite3.IntegrityError):
            ledger.add(record_of(PLAN, "a", 0))
        assert len(ledger.rows()) == 1


def test_errors_are_kept_apart_and_units_given_up_can_be_retried(tmp_path):
    unit = PLAN.unit("a", 0)
    with open_ledger(tmp_path, PLAN) as ledger:
        for attempt in (1, 2):
            ledger.add(error_of(PLAN, "a", 0, attempt), table="errors")
        assert ledger.rows() == []
        assert [(e["cell"], e["index"], e["attempt"], e["message"]) for e in ledger.errors()] == [
            ("a", 0, 1, "no GL"), ("a", 0, 2, "no GL"),
        ]  # fmt: skip
        ledger.add(normalise(empty_record(unit) | {"message": "no GL", "attempts": 4}, 2))
        ledger.add(record_of(PLAN, "b", 0))
        ledger.drop(ledger.rows()[1:])
        assert [r["cell"] for r in ledger.rows()] == ["b"] and len(ledger.errors()) == 2


def add_many(ledger):
    for index in range(100):
        ledger.add(record_of(PLAN, "a", index))


def test_a_full_disk_is_one_line_and_leaves_the_rows(tmp_path):
    with open_ledger(tmp_path, PLAN) as ledger:
        ledger.add(record_of(PLAN, "b", 0))
        pages = ledger._connection.execute("PRAGMA page_count").fetchone()[0]
        ledger._connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(InputError, match=r"ledger.sqlite: the disk is full; free some space"):
            add_many(ledger)
        kept = len(ledger.rows())
    with open_ledger(tmp_path, PLAN) as ledger:
        assert len(ledger.rows()) == kept >= 1
        ledger.add(record_of(PLAN, "a", 100))


@pytest.mark.parametrize("content", [b"no database at all" * 100, b""])
def test_another_file_is_refused_and_an_empty_one_becomes_a_ledger(tmp_path, content):
    (tmp_path / LEDGER_FILE).write_bytes(content)
    if content:
        with pytest.raises(InputError, match="is not a ledger; choose a new folder"):
            open_ledger(tmp_path, PLAN)
    else:
        assert open_ledger(tmp_path, PLAN).rows() == []


def test_a_missing_ledger_cannot_be_read_and_is_not_created(tmp_path):
    with pytest.raises(InputError, match=r"has no ledger.sqlite"):
        open_ledger(tmp_path, PLAN, read_only=True)
    assert list(tmp_path.iterdir()) == []


def test_a_ledger_can_be_read_during_a_run(tmp_path):
    with open_ledger(tmp_path, PLAN) as writing:
        writing.add(record_of(PLAN, "a", 0))
        with open_ledger(tmp_path, PLAN, read_only=True) as reading:
            assert len(reading.rows()) == 1
            writing.add(record_of(PLAN, "a", 1))
            assert len(reading.rows()) == 2
            with pytest.raises(InputError, match="cannot be used"):
                reading.add(record_of(PLAN, "b", 0))


def add_and_die(folder):
    ledger = open_ledger(folder, PLAN)
    for index in range(3):
        ledger.add(record_of(PLAN, "b", index))
    os.kill(os.getpid(), signal.SIGKILL)


def test_added_rows_outlive_kill_9(tmp_path):
    # Forked, as a new interpreter takes seconds to start; the child runs nothing but the ledger.
    child = get_context("fork").Process(target=add_and_die, args=(tmp_path,))
    child.start()
    child.join()
    assert child.exitcode == -9
    with open_ledger(tmp_path, PLAN, read_only=True) as ledger:
        assert [r["index"] for r in ledger.rows()] == [0, 1, 2]


def test_the_folder_has_one_driver_at_a_time_and_is_free_after_kill_9(tmp_path):
    script = (
        "import sys, time; from pathlib import Path\n"
        "from dslab.experiments.jobs.ledger import sole_driver\n"
        "with sole_driver(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", script, tmp_path], stdout=subprocess.PIPE) as other:
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(InputError, match="another run is at work in this folder"), sole_driver(tmp_path):
            pass
        other.kill()
    with sole_driver(tmp_path):
        pass


SHARES = [name for name, domain in domains(2).items() if domain == "share"]


@pytest.mark.parametrize("name", SHARES)
def test_a_share_beyond_its_ends_by_rounding_is_stored_as_its_end(tmp_path, name):
    ends = {index: {name: end} for index, end in enumerate((1.0000000000000002, -1e-17))}
    with open_ledger(tmp_path, PLAN) as ledger:
        for index, end in ends.items():
            ledger.add(normalise(record_of(PLAN, "b", index) | end, 2))
        assert [row[name] for row in ledger.rows()] == [1.0, 0.0]
    for wrong in (1.01, -0.01):
        with pytest.raises(ValueError, match=f"{name}: {wrong} is not from 0 to 1"):
            normalise(record_of(PLAN, "b", 0) | {name: wrong}, 2)


@pytest.mark.parametrize(
    "change",
    [{"severity": "much"}, {"index": 1.5}, {"index": -1}, {"breakage": 2}, {"cell": 3}, {"surprise": 1}],
)
def test_a_record_of_wrong_form_is_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        normalise(made_up_record(PLAN.unit("a", 0)) | change, 2)


def test_nan_and_infinities_are_null():
    record = made_up_record(PLAN.unit("a", 0)) | {"base_ate_m": float("nan"), "dual_ate_m": float("inf")}
    plain = normalise(record, 2)
    assert plain["base_ate_m"] is None and plain["dual_ate_m"] is None
    assert data_frame([plain], 2)["base_ate_m"].tolist() == [pd.NA]


def test_an_unfinished_ledger_is_reported(tmp_path):
    (tmp_path / LEDGER_FILE).touch()
    with pytest.raises(InputError, match="holds nothing yet; try again when the run has started"):
        open_ledger(tmp_path, MadeUp({"ok": 1}), read_only=True)


def test_a_changed_bit_anywhere_in_the_file_changes_no_row_silently(tmp_path):
    fill(tmp_path, [("b", 0), ("a", 1), ("b", 2), ("a", 0)])
    with open_ledger(tmp_path, PLAN) as ledger:
        ledger.add(error_of(PLAN, "a", 0), table="errors")
        rows, errors = ledger.rows(), ledger.errors()
    content = (tmp_path / LEDGER_FILE).read_bytes()
    rng, found = random.Random(0), 0
    for _ in range(80):
        damaged = bytearray(content)
        damaged[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        (tmp_path / LEDGER_FILE).write_bytes(damaged)
        try:
            with open_ledger(tmp_path, PLAN, read_only=True) as ledger:
                assert (ledger.rows(), ledger.errors()) == (rows, errors)
        except InputError:
            found += 1
    assert found > 4


def test_negative_zero_and_text_that_is_no_unicode_can_be_stored(tmp_path):
    record = record_of(PLAN, "a", 0) | {"severity": -0.0}
    record = normalise(record | {"message": "no \udcff"}, 2)
    with open_ledger(tmp_path, PLAN) as ledger:
        ledger.add(record)
        (row,) = ledger.rows()
    assert row["message"] == "no \\udcff" and str(row["severity"]) == "0.0"


def test_a_lock_that_cannot_be_had_is_one_line(tmp_path):
    (tmp_path / LOCK_FILE).mkdir()
    with pytest.raises(InputError, match="cannot be locked"), sole_driver(tmp_path):
        pass


def test_errors_of_the_run_are_not_taken_for_those_of_its_lock(tmp_path):
    with pytest.raises(OSError, match="of the run"), sole_driver(tmp_path):
        raise OSError("of the run")
