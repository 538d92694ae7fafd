"""Experiments on claims: run, resumed, reported, from a ledger and from an exported table alone."""

import json
import shutil

import pyarrow.parquet as pq
import pytest
from claim_fakes import FAILS, KIND, SPEC

from dslab.experiments.claims.folder import read_claim
from dslab.experiments.claims.kinds import KINDS
from dslab.experiments.claims.loading import claim_presets, is_claim, load_claim
from dslab.experiments.claims.merge import merge_claims
from dslab.experiments.claims.report import write_claim_report
from dslab.experiments.claims.runner import run_claim
from dslab.experiments.eq1.spec import preset_names
from dslab.experiments.jobs.pool import PoolSettings
from dslab.scenarios.errors import InputError, MachineError


@pytest.fixture
def spec_file(tmp_path, monkeypatch):
    monkeypatch.setitem(KINDS, "fake", KIND)
    (tmp_path / "made-up.yaml").write_text(SPEC.format(worlds=3))
    return tmp_path / "made-up.yaml"


def test_conditions_share_their_worlds_and_only_stress_tells_them_apart(spec_file):
    spec = load_claim(spec_file)
    assert list(spec.cells) == ["room", "room/motion_blur/1"]
    clean, blurred = (spec.scenario(name, 1) for name in spec.cells)
    assert clean.world == blurred.world and clean.trajectory == blurred.trajectory
    assert not clean.segments and [s.kind for s in blurred.segments] == ["motion_blur"]
    assert spec.scenario("room", 2).world != clean.world


@pytest.mark.slow
def test_a_run_goes_on_after_failures_and_reports_the_same_from_the_table_alone(
    spec_file, tmp_path, monkeypatch
):
    spec = load_claim(spec_file)
    monkeypatch.setenv(FAILS, "1")
    tally = run_claim(spec, tmp_path / "out", PoolSettings(1))
    assert (tally.done, tally.errors, tally.total) == (4, 2, 6)
    assert read_claim(tmp_path / "out").messages == ("RuntimeError: no length today",)
    monkeypatch.setenv(FAILS, "")
    assert run_claim(spec, tmp_path / "out", PoolSettings(2)).ended_here == 2
    whole = run_claim(spec, tmp_path / "whole", PoolSettings(1), last_first=True)
    assert whole.done == whole.total == 6
    rows, messages = (found := read_claim(tmp_path / "out")).rows, found.messages
    assert rows == read_claim(tmp_path / "whole").rows and not messages and len(rows) == 12
    assert [row["world"] for row in rows[::4]] == [0, 1, 2] and all(row["code"] for row in rows)

    figures = write_claim_report(tmp_path / "out")
    assert figures["is_look"] and figures["length_m"]["low"] is None
    published = tmp_path / "published"
    published.mkdir()
    for name in ("spec.yaml", "table.parquet"):
        shutil.copy(tmp_path / "out" / name, published / name)
    assert write_claim_report(published) == figures
    assert json.loads((published / "figures.json").read_text()) == figures
    for name in ("table.parquet", "figure.svg", "figure.png"):
        assert (tmp_path / "out" / name).is_file()

    again = tmp_path / "again"
    assert (
        merge_claims(again, [published]).added == 6
        and run_claim(spec, again, PoolSettings(1)).ended_here == 0
    )
    assert merge_claims(again, [tmp_path / "whole"]).known == 6
    write_claim_report(again)
    assert (again / "table.parquet").read_bytes() == (published / "table.parquet").read_bytes()

    damaged = pq.read_table(published / "table.parquet")
    pq.write_table(damaged.slice(1), published / "table.parquet")
    with pytest.raises(InputError, match="is damaged"):
        read_claim(published)


@pytest.mark.slow
def test_a_run_whose_units_all_fail_stops(spec_file, tmp_path, monkeypatch):
    monkeypatch.setenv(FAILS, "0,1,2")
    with pytest.raises(MachineError, match="the last 3 units ended in an error: RuntimeError: no length"):
        run_claim(load_claim(spec_file), tmp_path / "out", PoolSettings(1))


def test_the_commands_know_a_claim_by_its_kind_and_say_what_is_wrong_in_a_line(spec_file, tmp_path, dslab):
    def said(command, *arguments):
        code, out, err = dslab("experiment", command, *arguments)
        assert code == 0, err
        return " ".join(out.split())

    out = tmp_path / "out"
    assert "2 of 2 units" in said("run", spec_file, "--worlds", 1, "--workers", 1, "--out", out)
    assert is_claim(out) and not is_claim("smoke") and not is_claim("docs/eq1-quick")
    assert "2 of 2 units, finished, 4 rows" in said("status", out)
    assert "1 worlds, a look" in (report := said("report", out)) and "rooms are" in report
    assert "# Sec. II: Rooms are long." in said("show", out)
    assert "made-up finished 2 / 2" in said("list", tmp_path)

    def fault(*arguments):
        code, _, err = dslab("experiment", *arguments)
        assert code == 2 and err.count("\n") == 1
        return err

    assert "has no `export`" in fault("export", out)
    assert "use conditioning (did you mean that?)" in fault(
        "run", "conditionings", "--out", tmp_path / "other"
    )
    assert not {*claim_presets()} & {*preset_names()}
    spec_file.write_text(SPEC.format(worlds=3).replace("fake", "fakes", 1))
    assert "made-up.yaml:2: kind: unknown kind 'fakes'; use fake" in fault("show", spec_file)
    spec_file.write_text(SPEC.format(worlds=3).replace("kind: room", "kind: rom"))
    assert "made-up.yaml:10: bases.room.world.kind" in fault("run", spec_file, "--out", tmp_path / "other")
    spec_file.write_text(SPEC.format(worlds=3).replace("II", "III").replace("root_seed: 5", "root_seed: 6"))
    assert "holds rows of another spec" in fault("run", spec_file, "--out", out)
