"""``dslab experiment``: run, go on, status, export, replay, power; what is wrong is one line."""

import json
import sqlite3
from contextlib import contextmanager

import pandas as pd
import pyarrow.parquet as pq
import pytest
from unit_fakes import made_up_record, made_up_unit

from experiments.campaign.folder import TABLE_FILE, export, read_experiment
from experiments.campaign.ledger import LEDGER_FILE
from experiments.campaign.runner import Tally
from experiments.campaign.worker_pool import WorkerPool
from experiments.cli.experiment_progress import estimates_text, pace_text
from experiments.eq1.records import columns, decided

COMMANDS = ["run", "status", "power", "replay", "export", "report", "schema"]


@pytest.fixture
def smoke(dslab, shared_pool, monkeypatch, tmp_path):
    """Runs `dslab experiment` with made-up units; its folder holds three units per cell of smoke."""
    shared = shared_pool._client

    @contextmanager
    def opened(settings, job):
        yield WorkerPool(shared, job, settings, tmp_path)

    monkeypatch.setattr("experiments.campaign.worker_pool.embedded_worker_pool", opened)
    monkeypatch.setattr("experiments.campaign.replay.embedded_worker_pool", opened)
    monkeypatch.setattr("experiments.eq1.trial.run_unit", made_up_unit)
    code, out, _ = dslab("experiment", "run", "smoke", "--out", tmp_path / "s", "--units", "3")
    assert code == 0 and f"next: dslab experiment report {tmp_path / 's'}" in out
    return tmp_path / "s"


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(dslab, command):
    code, out, _ = dslab("experiment", command, "--help")
    assert code == 0 and f"dslab experiment {command}" in out.split("Usage:")[1].split("\n", 1)[1]


def test_a_run_can_be_read_and_made_longer(dslab, smoke):
    spec, table = read_experiment(smoke)
    assert spec.name == "smoke" and spec.units == 3
    assert list(table["cell"]) == [c for c in spec.cell_names() for _ in range(3)]
    assert list(table["index"]) == [0, 1, 2] * 2
    code, out, _ = dslab("experiment", "run", "smoke", "--out", smoke, "--units", "4", "--json")
    status = json.loads(out)
    assert code == 0 and (status["done"], status["total"]) == (8, 8)
    assert [cell["units"] for cell in status["cells"]] == [4, 4]


def test_the_exported_table_is_that_of_the_ledger_whatever_the_order_of_writing(dslab, smoke):
    code, out, _ = dslab("experiment", "export", smoke, "--csv")
    assert code == 0 and str(smoke / TABLE_FILE) in out.replace("\n", "")
    first = (smoke / TABLE_FILE).read_bytes()
    spec, table = read_experiment(smoke)
    exported = pq.read_table(smoke / TABLE_FILE)
    assert exported.column_names == list(columns(2)) == list(pd.read_csv(smoke / "units.csv").columns)
    assert exported.schema.metadata[b"spec_hash"].decode() == spec.content_hash
    with sqlite3.connect(smoke / LEDGER_FILE) as ledger:
        rows = ledger.execute("SELECT * FROM units ORDER BY unit_id DESC").fetchall()
        ledger.execute("DELETE FROM units")
        ledger.executemany(f"INSERT INTO units VALUES ({', '.join('?' * len(rows[0]))})", rows)
    ledger.close()
    export(smoke)
    assert (smoke / TABLE_FILE).read_bytes() == first
    (smoke / LEDGER_FILE).unlink()
    pd.testing.assert_frame_equal(read_experiment(smoke)[1], table)


def test_the_status_tells_of_cells_and_errors(dslab, smoke):
    code, out, _ = dslab("experiment", "status", smoke)
    assert code == 0 and "3 / 3" in out and "6 of 6 units" in out


@pytest.mark.parametrize("abbreviated", [True, False])
def test_a_replay_agrees_with_the_ledger_or_says_where_not(dslab, smoke, abbreviated):
    spec, table = read_experiment(smoke)
    unit_id, cell = table["unit_id"][4], table["cell"][4]
    name = unit_id[:6] if abbreviated else f"{cell}:{table['index'][4]}"
    code, out, _ = dslab("experiment", "replay", smoke, name)
    assert code == 0 and unit_id in out and "agrees with the ledger" in out
    with sqlite3.connect(smoke / LEDGER_FILE) as ledger:
        ledger.execute("UPDATE units SET onset_s = 1.5 WHERE unit_id = ?", (unit_id,))
    ledger.close()
    code, out, _ = dslab("experiment", "replay", smoke, name, "--json")
    said = json.loads(out)
    assert code == 1 and said["differing"] == ["onset_s"] and said["recorded"]["onset_s"] == 1.5
    wanted = made_up_record(spec.unit(cell, int(table["index"][4])))
    assert decided(said["record"]) == decided(wanted)


def test_a_unit_that_was_not_run_can_be_replayed(dslab, smoke):
    code, out, _ = dslab("experiment", "replay", smoke, "low_texture/1:7")
    assert code == 0 and "does not have it yet" in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["replay", "{s}", "zz"], "zz: no unit of the ledger"),
        (["replay", "{s}", ""], "6 units have ids that begin so"),
        (["replay", "{s}", "fog:1"], "no such cell"),
        (["status", "{s}/nothing"], "has no spec.yaml"),
        (["export", "{s}/nothing"], "has no spec.yaml"),
        (["run", "eq1-quick", "--out", "{s}"], "holds units of another spec"),
        (["run", "no-such", "--out", "{s}2"], "no such experiment"),
        (["power", "--p0", "2", "--pr", "0.1"], "must lie strictly between 0 and 1"),
        (["power", "--p0", "0.2", "--pr", "0.1", "--pr", "0.2", "--n", "3"], "2 values of --pr"),
    ],
)
def test_what_is_wrong_is_one_line_and_exit_2(dslab, smoke, arguments, said):
    code, _, err = dslab("experiment", *(a.format(s=smoke) for a in arguments))
    assert code == 2 and err.startswith("error: ") and err.count("\n") == 1 and said in err


def test_power_prints_the_units(dslab):
    code, out, _ = dslab("experiment", "power", "--p0", "0.4", "--pr", "0.3", "--n", "2", "--json")
    plan = json.loads(out)
    assert code == 0 and plan["units"] > 50 and plan["power"] >= 0.8
    assert plan["predicted"] == pytest.approx(0.036)


def test_the_schema_is_one_of_json(dslab):
    code, out, _ = dslab("experiment", "schema")
    assert code == 0 and "stopping" in json.loads(out)["properties"]


def test_progress_tells_pace_and_estimates():
    tally = Tally(12, 20, completed=10, void=1, errors=1, retries=5, breakages=4, failures=1,
                  ended_here=6, workers=2)  # fmt: skip
    assert pace_text(tally, 360.0) == "60/h, 0:08:00 left"
    assert estimates_text(tally) == "p0 0.40 (4/10), dual failures 0.10 (1/10), 1 void, 1 errors"
    none = Tally(0, 20, 0, 0, 0, 0, 0, 0, 0, workers=0)
    assert pace_text(none, 1.0) == "waiting for workers" and "p0 - (0/0)" in estimates_text(none)
