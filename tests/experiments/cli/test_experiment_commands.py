"""``dslab experiment``: run, resume, status, export, replay, power; bad input is one line."""

import json
import re
import shutil
import sqlite3
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq
import pytest
from pool_fakes import LocalPool, open_local_pool
from unit_fakes import made_up_record, made_up_unit

from dslab.experiments.campaign.folder import (
    TABLE_FILE,
    export,
    open_ledger,
    read_experiment,
)
from dslab.experiments.campaign.runner import run_experiment
from dslab.experiments.eq1.records import columns, decided
from dslab.experiments.eq1.spec import load_spec
from dslab.experiments.jobs.ledger import LEDGER_FILE

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The file of a spec with two cells: smoke without sham and repeats."""
    path, spec = tmp_path_factory.mktemp("spec") / "plain.yaml", load_spec("smoke")
    path.write_text(spec.model_copy(update={"sham": False, "repeats": 1, "worlds": 4}).as_yaml())
    return path


@pytest.fixture(scope="module")
def finished(tmp_path_factory, plain):
    """The folder of an experiment: three synthetic units per cell."""
    folder, spec = tmp_path_factory.mktemp("experiment") / "s", load_spec(plain)
    spec = spec.model_copy(update={"worlds": 3})
    run_experiment(spec, folder, lambda: nullcontext(LocalPool(made_up_unit)))
    return folder


@pytest.fixture
def smoke(finished, monkeypatch, tmp_path):
    """A copy of the folder, with synthetic units for the commands that run some."""

    monkeypatch.setattr("dslab.experiments.campaign.workers.open_pool", open_local_pool)
    monkeypatch.setattr("dslab.experiments.eq1.trial.run_unit", made_up_unit)
    return shutil.copytree(finished, tmp_path / "s")


def test_a_run_can_be_read_and_made_longer(dslab, smoke, plain):
    spec, table = read_experiment(str(smoke))
    assert spec.name == "smoke" and spec.units == 3
    assert list(table["cell"]) == [c for c in spec.cell_names() for _ in range(3)]
    assert list(table["index"]) == [0, 1, 2] * 2
    code, out, _ = dslab("experiment", "run", plain, "--out", smoke, "--worlds", "4")
    assert code == 0 and "8 of 8 units" in out and f"dslab experiment report {smoke}" in out
    code, out, _ = dslab("experiment", "status", smoke, "--json")
    status = json.loads(out)
    assert code == 0 and [cell["units"] for cell in status["cells"]] == [4, 4]


def test_the_end_of_a_run_names_every_system_with_its_doses(dslab, smoke, plain, tmp_path):
    path = tmp_path / "two.yaml"
    path.write_text(plain.read_text().replace("- dual\n", "- dual\n- base\n"))
    code, out, _ = dslab("experiment", "run", path, "--out", tmp_path / "two")
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert code == 0 and "; base: p0 " in lines[0]
    for dose in ("contrast 0.3", "contrast 0.02"):
        assert any(line.startswith(f"low texture, {dose} dual 4 ") for line in lines)
        assert any(line.startswith(f"low texture, {dose} base ") for line in lines)


def test_an_unknown_system_is_one_line_before_anything_runs(dslab, smoke, plain, tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(plain.read_text().replace("- dual\n", "- dual\n- orbslam33\n"))
    code, _, err = dslab("experiment", "run", path, "--out", tmp_path / "own")
    assert code == 2 and err.count("\n") == 1 and "there is no system 'orbslam33'" in err
    assert not (tmp_path / "own").exists()


def test_shams_are_units_but_not_of_the_shares_that_a_run_prints(tmp_path):
    spec = load_spec("smoke").model_copy(update={"repeats": 1})
    pool = partial(LocalPool, made_up_unit)
    tally = run_experiment(spec, tmp_path / "s", lambda: nullcontext(pool()))
    done = read_experiment(tmp_path / "s")[1].query("outcome == 'completed'")
    assert tally.done == 6 and tally.systems[0].completed == (done["kind"] != "sham").sum() < len(done)


def test_the_exported_table_is_that_of_the_ledger_in_any_order_of_writing(dslab, smoke):
    code, out, _ = dslab("experiment", "export", smoke, "--csv")
    assert code == 0 and str(smoke / TABLE_FILE) in out.replace("\n", "")
    first = (smoke / TABLE_FILE).read_bytes()
    spec, table = read_experiment(smoke)
    exported = pq.read_table(smoke / TABLE_FILE)
    assert exported.column_names == list(columns(2)) == list(pd.read_csv(smoke / "units.csv").columns)
    assert exported.schema.metadata[b"spec_hash"].decode() == spec.content_hash
    with sqlite3.connect(smoke / LEDGER_FILE) as ledger:
        rows = ledger.execute("SELECT key, row, digest FROM rows ORDER BY key DESC").fetchall()
        ledger.execute("DELETE FROM rows")
        ledger.executemany("INSERT INTO rows (key, row, digest) VALUES (?, ?, ?)", rows)
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
    with open_ledger(smoke, spec) as ledger:
        rows = [row | ({"onset_s": 1.5} if row["unit_id"] == unit_id else {}) for row in ledger.rows()]
    (smoke / LEDGER_FILE).unlink()
    with open_ledger(smoke, spec) as ledger:
        ledger.add(*rows)
    code, out, _ = dslab("experiment", "replay", smoke, f"{cell}:{index}", "--json")
    replayed = json.loads(out)
    assert code == 1 and replayed["differing"] == ["onset_s"] and replayed["recorded"]["onset_s"] == 1.5
    assert decided(replayed["record"]) == decided(made_up_record(spec.unit(cell, index)))


def test_without_a_unit_the_first_failure_of_each_condition_is_listed_with_its_command(dslab, smoke):
    table = read_experiment(smoke)[1]
    code, out, _ = dslab("experiment", "replay", smoke)
    lines = [line.partition("  # ") for line in out.splitlines()]
    assert code == 0 and len(lines) == 2
    for (command, _, words), (cell, own) in zip(lines, table.groupby("cell"), strict=True):
        failed = own[own["d1"].fillna(False)]
        index = (failed if len(failed) else own[own["breakage"].fillna(False)])["index"].iloc[0]
        assert command == f"dslab experiment replay {smoke} {cell}:{index}" and "breakage" in words
    code, out, _ = dslab("experiment", "replay", smoke, "--outcome", "dual failure", "--json")
    assert code == 0 and json.loads(out)["record"]["d1"]
    code, _, err = dslab("experiment", "replay", smoke, "--outcome", "rain")
    assert code == 2 and err.count("\n") == 1 and "use a part of: " in err and "breakage" in err
    code, _, err = dslab("experiment", "replay", smoke, "a:0", "--outcome", "rain")
    assert code == 2 and "a:0 is named already" in err


def test_what_there_is_to_run_and_what_was_run_is_listed_and_shown(dslab, smoke, tmp_path):
    code, out, _ = dslab("experiment", "list", tmp_path)
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert code == 0 and any(
        re.match(r"eq1 2400 about \d+ \w+ on \d+ cores? Eq. 1, conf", li) for li in lines
    )
    assert any(line.endswith(" smoke finished 6 / 6") for line in lines)
    shown = dslab("experiment", "show", smoke)[1]
    assert load_shown(shown, tmp_path).content_hash == load_spec(str(smoke / "spec.yaml")).content_hash
    assert "# low_texture/2: low texture, contrast 0.02\n# 6 of 6 units are done\n" in shown.replace(
        "\xa0", " "
    )
    shown = dslab("experiment", "show", "smoke")[1]
    assert load_shown(shown, tmp_path).content_hash == load_spec("smoke").content_hash
    assert shown.startswith("# smoke: 3 cells of 4 units (2 worlds × 1 sequence × 2 repeats), about ")
    code, _, err = dslab("experiment", "list", tmp_path / "none")
    assert code == 2 and "is no folder" in err


def load_shown(text, folder):
    (folder / "shown.yaml").write_text(text)
    return load_spec(folder / "shown.yaml")


def test_a_published_table_is_replayed_without_its_ledger(dslab, smoke):
    export(smoke)
    (smoke / LEDGER_FILE).unlink()
    code, out, _ = dslab("experiment", "replay", smoke, "low_texture/1:1")
    assert code == 0 and "agrees with the ledger" in out


def test_a_replay_of_a_row_of_other_code_names_what_replays_it(dslab, smoke):
    spec = load_spec(str(smoke / "spec.yaml"))
    with open_ledger(smoke, spec) as ledger:
        rows = [row | {"code": "1", "commit": "0123456"} for row in ledger.rows()]
    (smoke / LEDGER_FILE).unlink()
    with open_ledger(smoke, spec) as ledger:
        ledger.add(*rows)
    code, _, err = dslab("experiment", "replay", smoke, "low_texture/1:1")
    assert code == 0 and "systems install lab@0123456`" in err and err.count("\n") == 1
    export(smoke)
    (smoke / LEDGER_FILE).unlink()
    table = pq.read_table(smoke / TABLE_FILE)
    about = {**table.schema.metadata, b"release": b"0.2.0"}
    pq.write_table(table.replace_schema_metadata(about), smoke / TABLE_FILE)
    assert "systems install lab@0.2.0`" in dslab("experiment", "replay", smoke, "low_texture/1:1")[2]


def test_a_unit_that_was_not_run_can_be_replayed(dslab, smoke):
    code, out, _ = dslab("experiment", "replay", smoke, "low_texture/1:7", "--json")
    assert code == 0 and json.loads(out)["recorded"] is None


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["replay", "{s}", "zz"], "zz"),
        (["status", "{s}/nothing"], "spec.yaml"),
        (["run", "demo", "--out", "{s}"], "another spec"),
        (["run", "no-such", "--out", "{s}2"], "no-such"),
        (["power", "--p0", "2", "--pr", "0.1"], "between 0 and 1"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_bad_input_is_one_line_and_exit_code_2(dslab, smoke, arguments, part):
    code, _, err = dslab("experiment", *(a.format(s=smoke) for a in arguments))
    assert code == 2 and err.startswith("error: ") and err.count("\n") == 1 and part in err


@pytest.fixture
def failing(smoke, monkeypatch):
    """Makes the units of a cell fail, or those of every cell."""

    def fail(cell=""):
        def job(unit, **options):
            if unit.cell.endswith(cell):
                raise OSError(28, "No space left on device", f"/cache/{unit.unit_id}")
            return made_up_unit(unit)

        monkeypatch.setattr("dslab.experiments.eq1.trial.run_unit", job)

    return fail


@pytest.mark.parametrize(
    ("units", "part"),
    [(1, "all 2 units were given up: OSError"), (9, "the last 3 units ended in the same error")],
)
def test_a_run_in_which_every_unit_fails_says_why_and_ends_with_1(
    dslab, failing, tmp_path, units, part, plain
):
    failing()
    run = ("experiment", "run", plain, "--out", tmp_path / "x", "--worlds", units)
    code, out, err = dslab(*run)
    assert (code, out) == (1, "") and err.count("\n") == 1
    assert part in err and "No space left on device" in err and "run the same command again" in err
    code, out, err = dslab(*run)
    assert code == 1 and part in err


def test_units_given_up_among_others_are_counted_in_the_last_line(dslab, failing, tmp_path, plain):
    failing("2")
    code, out, _ = dslab("experiment", "run", plain, "--out", tmp_path / "x", "--worlds", 3)
    assert code == 0
    assert out.splitlines()[-1].startswith(
        "3 of 6 units were given up, most for: OSError: [Errno 28] No space"
    )
    assert out.rstrip().endswith("--retry-errors")


def test_a_replay_that_ends_in_an_infrastructure_error_ends_with_1(dslab, smoke, failing):
    failing()
    code, _, err = dslab("experiment", "replay", smoke, "low_texture/1:0")
    assert code == 1 and "No space left on device" in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("option", "part"),
    [
        (("--memory", "1"), "--memory: 1 MB is less than the 400 MB that a worker takes to start; give mega"),
        (("--timeout", "1e300"), "--timeout: 1e+300 s is no time limit"),
    ],
)
def test_limits_under_which_no_unit_could_run_are_refused(dslab, smoke, tmp_path, option, part, plain):
    for command in (("run", plain, "--out", tmp_path / "x"), ("replay", smoke, "low_texture/1:0")):
        code, _, err = dslab("experiment", *command, *option)
        assert code == 2 and part in err and err.count("\n") == 1
    assert not (tmp_path / "x").exists()


def change(folder, *statements):
    """Change a ledger behind its back."""
    with sqlite3.connect(folder / LEDGER_FILE) as ledger:
        for statement in statements:
            ledger.execute(statement)
    ledger.close()


READERS = (("status",), ("status", "--json"), ("export",), ("report",), ("replay", "low_texture/1:0"))


@pytest.mark.parametrize(
    ("statement", "part"),
    [
        ("UPDATE rows SET row = replace(row, 'completed', 'banana')", "it does not agree with its digest"),
        ("UPDATE rows SET key = 'x' WHERE number = 2", "rows row 2, x: is damaged: it does not agree"),
        ("DELETE FROM rows WHERE number = 2", "5 rows are not those that were written"),
        ("UPDATE meta SET value = '{}' WHERE key = 'owner'", "its description has changed"),
    ],
)
def test_a_damaged_ledger_is_one_line_for_every_command(dslab, smoke, statement, part, plain):
    change(smoke, statement)
    before = sorted(path.name for path in smoke.iterdir())
    for name, *rest in (*READERS, ("run",)):
        arguments = (plain, "--out", smoke) if name == "run" else (smoke, *rest)
        code, _, err = dslab("experiment", name, *arguments)
        assert code == 2 and err.count("\n") == 1 and part in err, name
        assert LEDGER_FILE in err and ("--rerun-damaged" in err or "new folder" in err)
    assert sorted(path.name for path in smoke.iterdir()) == before


def test_damaged_units_are_run_again_on_request(dslab, smoke, plain):
    _, before = read_experiment(smoke)
    change(
        smoke,
        "UPDATE rows SET row = '{}' WHERE number = 2",
        "DELETE FROM rows WHERE number = 4",
        "UPDATE sums SET digest = 'x'",
    )
    run = ("experiment", "run", plain, "--out", smoke, "--worlds", 3)
    assert dslab(*run)[0] == 2
    code, out, _ = dslab(*run, "--rerun-damaged")
    assert code == 0 and "6 of 6 units" in out
    _, table = read_experiment(smoke)
    assert decided(table.to_dict("list")) == decided(before.to_dict("list"))
    assert not list(smoke.glob(".*"))


def test_a_ledger_of_another_version_is_one_line_for_every_command(dslab, smoke, plain):
    change(smoke, "UPDATE meta SET value = '2' WHERE key = 'form'")
    for name, *rest in (*READERS, ("run",)):
        arguments = (plain, "--out", smoke) if name == "run" else (smoke, *rest)
        code, _, err = dslab("experiment", name, *arguments)
        assert code == 2 and err.count("\n") == 1 and "is of another version" in err, name


@pytest.mark.slow
def test_power_prints_that_of_both_tests(dslab):
    given = ["--p0", "0.4", "--pr", "0.3", "--pr", "0.3", "--ratio", "4", "--worlds", "40", "--json"]
    code, out, _ = dslab("experiment", "power", *given)
    found = json.loads(out)
    assert code == 0 and found["predicted"] == pytest.approx(0.036)
    assert found["design"]["worlds"] == 40 and 0.5 < found["independence"] <= 1 and 0 < found["forecast"] <= 1


def test_the_schema_is_one_of_json(dslab):
    code, out, _ = dslab("experiment", "schema")
    assert code == 0 and "confirmatory" in json.loads(out)["properties"]


@pytest.mark.slow
def test_the_example_of_a_class_runs_through_experiment_and_report(dslab, tmp_path):
    """It never looks, so that its lead-in is void: as the page says, beside the base on the same frames."""
    example = Path(__file__).parents[3] / "examples" / "own_slam.py"
    spec = load_spec("smoke").model_copy(
        update={"systems": ("base", f"{example}:ConstantVelocity"), "arms": ("free",), "worlds": 1}
    )
    path = tmp_path / "two.yaml"
    path.write_text(spec.model_copy(update={"repeats": 1, "sham": False}).as_yaml())
    assert dslab("experiment", "run", path, "--out", tmp_path / "x", "--workers", 1)[0] == 0
    rows = read_experiment(tmp_path / "x")[1].set_index("cell")
    assert set(rows.outcome[rows.system == "ConstantVelocity"]) == {"void"}
    assert set(rows.outcome[rows.system == "base"]) == {"completed"}
    assert dslab("experiment", "replay", tmp_path / "x", f"{rows.index[-1]}:0")[0] == 0
    code, out, _ = dslab("experiment", "report", tmp_path / "x")
    assert code == 0 and "No trial" not in out and "Missions that fail under stress: base " in out
    page = (tmp_path / "x" / "report.html").read_text()
    assert "Systems beside each other" in page and "the lead-in cannot be judged" in page
