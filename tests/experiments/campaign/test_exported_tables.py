"""Exported tables are read as they were written, or not at all."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dslab.experiments.campaign.folder import (
    ERROR_COLUMNS,
    ERRORS_FILE,
    TABLE_FILE,
    export,
    open_ledger,
    read_errors,
    read_experiment,
)
from dslab.experiments.eq1.spec import load_spec
from dslab.experiments.jobs.ledger import LEDGER_FILE
from dslab.scenarios.errors import InputError

ERROR = {name: "text" if kind == "text" else 1 for name, kind in ERROR_COLUMNS.items()}


@pytest.fixture
def folder(tmp_path, run_made_up):
    """An exported experiment of six units and one infrastructure error, without its ledger."""
    spec = load_spec("smoke").model_copy(update={"sham": False, "repeats": 1, "worlds": 3})
    run_made_up(spec)
    with open_ledger(tmp_path / "x", spec) as ledger:
        ledger.add(ERROR, table="errors")
    export(tmp_path / "x")
    (tmp_path / "x" / LEDGER_FILE).unlink()
    return tmp_path / "x"


def test_a_changed_bit_of_an_exported_table_changes_no_row_silently(folder):
    _, table = read_experiment(folder)
    file = folder / TABLE_FILE
    content, rng, found = file.read_bytes(), np.random.default_rng(0), 0
    for place, bit in zip(rng.integers(len(content), size=20), rng.integers(8, size=20), strict=True):
        damaged = bytearray(content)
        damaged[place] ^= 1 << bit
        file.write_bytes(damaged)
        try:
            pd.testing.assert_frame_equal(read_experiment(folder)[1], table)
        except InputError:
            found += 1
    assert found > 4


def test_an_exported_table_belongs_to_its_spec(dslab, folder):
    spec = (folder / "spec.yaml").read_text()
    (folder / "spec.yaml").write_text(spec.replace("tail_s: ", "tail_s: 1"))
    code, _, err = dslab("experiment", "report", folder)
    assert code == 2 and err.count("\n") == 1 and "another spec.yaml" in err


@pytest.mark.parametrize("damage", ["banana", "changed", "twice", "column", "no table"])
def test_an_exported_table_of_wrong_rows_is_one_line(dslab, folder, damage):
    table = pq.read_table(folder / TABLE_FILE)
    rows = table.to_pylist()
    if damage == "twice":
        rows[2] = rows[0]
    rows[1] |= {"banana": {"outcome": "banana"}, "changed": {"severity": 7.0}}.get(damage, {})
    schema = table.schema.remove(0) if damage == "column" else table.schema
    pq.write_table(table.from_pylist(rows, schema=schema), folder / TABLE_FILE)
    if damage == "no table":
        (folder / TABLE_FILE).write_bytes(b"PAR1 no table PAR1")
    code, _, err = dslab("experiment", "report", folder)
    assert code == 2 and err.count("\n") == 1 and TABLE_FILE in err
    said = {"banana": "outcome is 'banana'", "changed": "not those that were written", "twice": "twice"}
    said |= {"column": "missing or unknown columns: unit_id", "no table": "is no Parquet file"}
    assert said[damage] in err


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda t: t.drop_columns("message"), "missing or unknown columns: message"),
        (lambda t: t.set_column(2, "index", pa.array(["two"])), "index: is damaged: it is of type string"),
        (lambda t: pa.concat_tables([t, t]), "not those that were written"),
        (lambda t: t.slice(1), "not those that were written"),
    ],
    ids=["missing", "mistyped", "doubled", "dropped"],
)
def test_a_table_of_errors_that_was_damaged_is_one_line(dslab, folder, damage, says):
    assert read_errors(folder) == [ERROR]
    pq.write_table(damage(pq.read_table(folder / ERRORS_FILE)), folder / ERRORS_FILE)
    code, _, err = dslab("experiment", "status", folder)
    assert code == 2 and err.count("\n") == 1 and ERRORS_FILE in err and says in err


def test_millions_of_rows_in_a_small_table_are_refused_unread(dslab, folder, monkeypatch):
    table = pq.read_table(folder / TABLE_FILE)
    many = table.take(pa.array(np.zeros(1_000, int)))
    pq.write_table(many, folder / TABLE_FILE)
    monkeypatch.setattr(pq.ParquetFile, "read", None)
    code, _, err = dslab("experiment", "status", folder)
    assert code == 2 and err.count("\n") == 1 and "has 1000 rows, more than the " in err
