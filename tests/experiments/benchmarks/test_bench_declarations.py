"""The table of what systems declare over many sequences: counted, kept, resumed."""

import json

import pandas as pd
import pytest
from typer.testing import CliRunner

from dslab.experiments.benchmarks import declarations, kept_rows
from dslab.experiments.cli.commands import app
from dslab.scenarios.errors import InputError


def test_rows_are_kept_and_a_second_run_makes_only_what_is_missing(tmp_path, monkeypatch):
    table = tmp_path / "rows"
    first = declarations.measure_declarations(["small"], [7], ["base"], table)
    assert list(first.system) == ["base"] and first.frames[0] > 100 and first.ate_m[0] < 1
    assert first.unjudged[0] == first.false_loops[0] == 0
    again = declarations.measure_declarations(["small"], [7], ["base"], table)
    pd.testing.assert_frame_equal(first, again)
    monkeypatch.setattr(kept_rows, "code_hash", lambda: "another")
    with pytest.raises(InputError, match="rows of another version of the code"):
        declarations.measure_declarations(["small"], [7], ["base"], table)


@pytest.mark.parametrize("seeds", ["x", "5-2", "-3", "1-"])
def test_seeds_out_of_form_are_one_line(tmp_path, seeds):
    given = ["bench", "declarations", "small", f"--seeds={seeds}", "--out", str(tmp_path / "t")]
    result = CliRunner().invoke(app, given)
    assert isinstance(result.exception, InputError) or result.exit_code == 2
    assert not list(tmp_path.iterdir())


def test_a_file_of_another_kind_is_refused_and_kept(tmp_path):
    table = tmp_path / "t"
    table.write_text("mine")
    with pytest.raises(InputError, match="cannot be written"):
        declarations.measure_declarations(["small"], [1], ["base"], table)
    assert table.read_text() == "mine"


def test_the_command_prints_sums(tmp_path, monkeypatch):
    row = {"scenario": "small", "seed": 1, "system": "base", "ate_m": 0.1, "unjudged": 0}
    counts = {f"{part}{name}": 2 for name in declarations.COUNTS for part in ("", "false_")}
    monkeypatch.setattr(
        declarations,
        "measure_declarations",
        lambda *_: pd.DataFrame([{**row, **counts, "seed": s} for s in (1, 2)]),
    )
    given = ["bench", "declarations", "small", "--out", str(tmp_path / "t"), "--json"]
    (printed,) = json.loads(CliRunner().invoke(app, given).stdout)
    assert printed["runs"] == 2 and printed["loops"] == printed["false_joins"] == 4
