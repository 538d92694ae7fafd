"""``dslab experiment``: run, resume, status, export, replay, power; bad input is one line."""

import json
import shutil
import sqlite3
from contextlib import nullcontext
from functools import partial

import pandas as pd
import pyarrow.parquet as pq
import pytest
from unit_fakes import made_up_record, made_up_unit

from experiments.campaign.folder import TABLE_FILE, export, read_experiment
from experiments.campaign.ledger import LEDGER_FILE
from experiments.campaign.runner import Tally, run_experiment
from experiments.campaign.unit_job import unit_record
from experiments.campaign.worker_pool import Ended, WorkerPool
from experiments.cli.experiment_progress import estimates_text, pace_text
from experiments.eq1.records import columns, decided
from experiments.eq1.spec import load_spec


class LocalPool:
    """A worker pool that runs each unit at once, in this process."""

    run = WorkerPool.run

    def __init__(self, task):
        self._task = task
        self._ended = []

    @property
    def busy(self):
        return len(self._ended)

    def free(self):
        return [] if self._ended else ["here"]

    def start(self, unit, worker, recording=None):
        self._ended.append(Ended(unit, worker, self._task(unit)))

    def wait(self, timeout_s):
        ended, self._ended = self._ended, []
        return ended


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of an experiment: three synthetic units per cell of smoke."""
    folder, spec = tmp_path_factory.mktemp("experiment") / "s", load_spec("smoke")
    spec = spec.model_validate(spec.model_dump(mode="json") | {"units": 3})
    run_experiment(spec, folder, lambda: nullcontext(LocalPool(partial(unit_record, made_up_unit))))
    return folder


@pytest.fixture
def smoke(finished, monkeypatch, tmp_path):
    """A copy of the folder, with synthetic units for the commands that run some."""

    def opened(settings, task):
        return nullcontext(LocalPool(task))

    monkeypatch.setattr("experiments.campaign.worker_pool.embedded_worker_pool", opened)
    monkeypatch.setattr("experiments.campaign.replay.embedded_worker_pool", opened)
    monkeypatch.setattr("experiments.eq1.trial.run_unit", made_up_unit)
    return shutil.copytree(finished, tmp_path / "s")


def test_a_run_can_be_read_and_made_longer(dslab, smoke):
    spec, table = read_experiment(smoke)
    assert spec.name == "smoke" and spec.units == 3
    assert list(table["cell"]) == [c for c in spec.cell_names() for _ in range(3)]
    assert list(table["index"]) == [0, 1, 2] * 2
    code, out, _ = dslab("experiment", "run", "smoke", "--out", smoke, "--units", "4")
    assert code == 0 and "8 of 8 units" in out and f"dslab experiment report {smoke}" in out
    code, out, _ = dslab("experiment", "status", smoke, "--json")
    status = json.loads(out)
    assert code == 0 and [cell["units"] for cell in status["cells"]] == [4, 4]


def test_the_exported_table_is_that_of_the_ledger_in_any_order_of_writing(dslab, smoke):
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


def test_the_status_counts_units_per_cell(dslab, smoke):
    code, out, _ = dslab("experiment", "status", smoke)
    assert code == 0 and "3 / 3" in out and "6 of 6 units" in out


def test_a_replay_agrees_with_the_ledger_or_names_the_differing_columns(dslab, smoke):
    spec, table = read_experiment(smoke)
    unit_id, cell, index = table["unit_id"][4], table["cell"][4], int(table["index"][4])
    code, out, _ = dslab("experiment", "replay", smoke, unit_id[:6])
    assert code == 0 and unit_id in out and "agrees with the ledger" in out
    with sqlite3.connect(smoke / LEDGER_FILE) as ledger:
        ledger.execute("UPDATE units SET onset_s = 1.5 WHERE unit_id = ?", (unit_id,))
    ledger.close()
    code, out, _ = dslab("experiment", "replay", smoke, f"{cell}:{index}", "--json")
    replayed = json.loads(out)
    assert code == 1 and replayed["differing"] == ["onset_s"] and replayed["recorded"]["onset_s"] == 1.5
    assert decided(replayed["record"]) == decided(made_up_record(spec.unit(cell, index)))


def test_a_unit_that_was_not_run_can_be_replayed(dslab, smoke):
    code, out, _ = dslab("experiment", "replay", smoke, "low_texture/1:7", "--json")
    assert code == 0 and json.loads(out)["recorded"] is None


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["replay", "{s}", "zz"], "zz"),
        (["status", "{s}/nothing"], "spec.yaml"),
        (["run", "eq1-quick", "--out", "{s}"], "another spec"),
        (["run", "no-such", "--out", "{s}2"], "no-such"),
        (["power", "--p0", "2", "--pr", "0.1"], "between 0 and 1"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_bad_input_is_one_line_and_exit_code_2(dslab, smoke, arguments, part):
    code, _, err = dslab("experiment", *(a.format(s=smoke) for a in arguments))
    assert code == 2 and err.startswith("error: ") and err.count("\n") == 1 and part in err


def test_power_prints_the_units(dslab):
    code, out, _ = dslab("experiment", "power", "--p0", "0.4", "--pr", "0.3", "--n", "2", "--json")
    plan = json.loads(out)
    assert code == 0 and plan["units"] > 50 and plan["power"] >= 0.8
    assert plan["predicted"] == pytest.approx(0.036)


def test_the_schema_is_one_of_json(dslab):
    code, out, _ = dslab("experiment", "schema")
    assert code == 0 and "stopping" in json.loads(out)["properties"]


def test_progress_shows_pace_and_estimates():
    tally = Tally(12, 20, completed=10, void=1, errors=1, retries=5, breakages=4, failures=1,
                  ended_here=6, workers=2)  # fmt: skip
    assert pace_text(tally, 360.0) == "60/h, 0:08:00 left"
    assert estimates_text(tally) == "p0 0.40 (4/10), dual failures 0.10 (1/10), 1 void, 1 errors"
    none = Tally(0, 20, 0, 0, 0, 0, 0, 0, 0, workers=0)
    assert pace_text(none, 1.0) == "waiting for workers" and "p0 - (0/0)" in estimates_text(none)
