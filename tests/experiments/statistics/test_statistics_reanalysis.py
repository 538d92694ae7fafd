"""The records of the first run, analysed anew: the figures that two recomputations agree on."""

import json
import runpy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from experiments.cli.commands import app
from experiments.statistics.from_records import cells_of
from experiments.statistics.reanalysis import reanalyse

RECORDS = Path(__file__).resolve().parents[3] / "docs" / "eq1-quick"
TABLE = pd.read_parquet(RECORDS / "units.parquet")


@pytest.fixture(scope="module")
def found():
    return reanalyse(TABLE, 2, permutations=199)


def test_products_over_distinct_units_and_the_chain(found):
    one, two = found.levels
    assert (found.worlds, found.units, found.void) == (15, 522, 18)
    shares = [(v.within_worlds, v.within_kinds, v.in_units, v.measured) for v in (one, two)]
    assert shares[0] == pytest.approx((0.253, 0.241, 0.272, 0.241), abs=1e-3)
    assert shares[1] == pytest.approx((0.196, 0.190, 0.213, 0.218), abs=1e-3)
    assert found.failed_or_silent == pytest.approx(0.274, abs=5e-4)
    assert one.by_worlds.high - one.by_worlds.low > 0.15, "by worlds, not by units: .075"


def test_no_formula_can_be_told_from_another_in_saturated_corridors(found):
    """Of these some are untested besides, since too few worlds have the event; nothing else has a verdict."""
    saturated = {
        (c.cell, c.n)
        for c in found.cells
        if c.world == "corridor" and c.units.saturated and c.units.product.value > 0
    }
    both = {(f"{cell}", n) for cell in ("low_texture/3", "motion_blur/2", "motion_blur/3") for n in (1, 2)}
    assert saturated == both | {("fast_rotation/3", 1)}
    assert {str(v) for c in found.cells for v in (c.independence, c.prediction)} == {"untested", "saturated"}
    (never,) = (c for c in found.cells if (c.cell, c.world, c.n) == ("fast_rotation/3", "corridor", 2))
    assert never.independence == "untested" and never.worlds_with == (10, 5, 0)


def test_a_cell_is_split_by_kind_of_world_and_void_units_are_no_outcome():
    cells = cells_of(TABLE, 2)
    assert len(cells) == 18 and sum(cell.units for cell in cells) == 522
    corridor = next(c for c in cells if (c.name, c.world) == ("low_texture/1", "corridor"))
    assert corridor.outcomes.breakage.shape == (10, 4, 1) and corridor.void == 2
    assert np.isnan(corridor.outcomes.breakage).sum() == 2
    rows = TABLE[(TABLE.cell == "low_texture/1") & (TABLE.world == "corridor")]
    assert np.nansum(corridor.outcomes.breakage) == rows.breakage.fillna(False).sum()


def test_replicates_stand_in_their_sequences_and_shams_are_left_out():
    rows = TABLE[(TABLE.cell == "low_texture/1") & (TABLE.world == "corridor")].copy()
    rows["sequence"], rows["repeat"] = rows["index"] % 4 // 2, rows["index"] % 2
    (cell,) = cells_of(pd.concat([rows, rows.assign(kind="sham", cell="sham")]), 2)
    assert cell.outcomes.breakage.shape == (10, 2, 2)
    world, unit = cell.worlds[3], rows[rows.world_seed == cell.worlds[3]].iloc[-1]
    assert unit.world_seed == world and unit.outcome == "completed"
    assert cell.outcomes.breakage[3, int(unit["sequence"]), int(unit["repeat"])] == unit["breakage"]


def test_the_steps_of_the_chain_multiply_to_the_whole():
    rng = np.random.default_rng(3)
    worlds, sequences, repeats = 30, 3, 3
    index = np.arange(worlds * sequences * repeats)
    place = np.unravel_index(index, (worlds, sequences, repeats))
    hard = np.repeat(rng.uniform(0.2, 0.8, worlds), sequences * repeats)
    rows = pd.DataFrame({"world_seed": place[0], "sequence": place[1], "repeat": place[2], "index": index})
    rows = rows.assign(cell="a/1", world="room", kind="a", outcome="completed", silent_failure=False)
    rows["breakage"], rows["cross_r1_failed"] = rng.random(len(index)) < hard, rng.random(len(index)) < hard
    rows["d1"] = rows["breakage"] & (rng.random(len(index)) < hard)
    rows["s1"] = rows["d1"] | (rows["breakage"] & (index % 7 == 0))  # a first success that is false
    rows["m1"] = rows["s1"] | (index % 11 == 0)
    (found,) = reanalyse(rows, 1, permutations=199).cells
    step = {name: ratio.value for name, ratio in found.steps.items()}
    assert set(step) == {"arms", "run", "path", "world", "whole"}
    assert np.prod([step[name] for name in ("arms", "run", "path", "world")]) == pytest.approx(step["whole"])
    assert all(ratio.low < ratio.value < ratio.high for ratio in found.steps.values())
    assert step["world"] > 1.05  # what a world shares; runs and paths share nothing here
    assert found.steps["run"].low < 1 < found.steps["run"].high
    assert found.chance is not None and 0.8 < found.chance.value < 1.0
    for name, column in (("dual_failure", "d1"), ("system_failure", "s1"), ("mission_failure", "m1")):
        assert found.shares[name].value == pytest.approx(rows[column].mean())
    assert found.shares["system_failure"].value > found.shares["dual_failure"].value
    (once,) = reanalyse(rows[(rows["repeat"] == 0) & (rows["sequence"] == 0)], 1, permutations=199).cells
    assert set(once.steps) == {"arms", "whole"} and once.chance is None


def test_a_page_of_pandas_gives_the_same_figures(found, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["recompute.py", str(RECORDS / "units.parquet")])
    again = runpy.run_path(str(RECORDS.parents[1] / "examples" / "recompute.py"))["found"]
    told = {(c.cell, c.world, c.n): c for c in found.cells}
    assert len(again) == 36 and len(told) >= 28 and "low_texture/2" in capsys.readouterr().out
    for row in again.itertuples():
        cell = told.get((row.cell, row.world, row.n))
        if cell is None:
            assert row.worlds < 2 + row.n  # too few worlds for a test
            continue
        mine = (cell.units.product, cell.units.weakest, cell.units.measured, cell.forecast.measured)
        theirs = (row.eq1, row.weakest_link, row.in_units, row.measured)
        assert [figure.value for figure in mine] == pytest.approx(theirs, abs=1e-12)
        for name, ends in (
            ("breakage", (row.p0_low, row.p0_high)),
            ("dual_failure", (row.measured_low, row.measured_high)),
        ):
            assert (cell.shares[name].low, cell.shares[name].high) == pytest.approx(ends, abs=1e-9)


def test_the_command_prints_the_figures(monkeypatch):
    monkeypatch.setattr("experiments.statistics.reanalysis.permutations_for", lambda tests: 99)
    printed = CliRunner().invoke(app, ["experiment", "reanalyse", str(RECORDS)])
    assert printed.exit_code == 0 and "27.4 %" in printed.stdout
    row = json.loads(CliRunner().invoke(app, ["experiment", "reanalyse", str(RECORDS), "--json"]).stdout)
    assert row["levels"][0]["n"] == 1 and len(row["cells"]) == 36
