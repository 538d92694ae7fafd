"""Whether a stress acts: drawn before an experiment, and found anew for tables that do not say."""

import shutil
from pathlib import Path

import pytest

from dslab.experiments.campaign import exposure
from dslab.experiments.campaign.exposure import draw_exposure, fill_exposed
from dslab.experiments.campaign.folder import read_experiment, read_rows, read_spec, rewrite_table
from dslab.experiments.eq1.spec import load_spec
from dslab.scenarios.errors import InputError

PUBLISHED = Path(__file__).resolve().parents[3] / "docs" / "eq1-vga"


@pytest.fixture
def published(tmp_path):
    """A few published rows of faded corridors, as a table that does not say whether their stress acted."""
    for name in ("spec.yaml", "units.parquet"):
        shutil.copy(PUBLISHED / name, tmp_path)
    spec, rows = read_rows(tmp_path)
    faded = [row for row in rows if row["kind"] == "low_texture"]
    spared, acted = ([r for r in faded if r["exposed"] is said][:2] for said in (False, True))
    rewrite_table(tmp_path, spec, [row | {"exposed": None} for row in (*spared, *acted)])
    return tmp_path


def test_a_table_is_filled_from_its_own_rows_and_from_plans_made_again(published):
    spec, rows = read_rows(published)
    # Of the last sequence also a system without recovery threads, of which no view overlap is known.
    other = rows[-1] | {"index": 39, "unit_id": "0" * 16, "view_overlap": None, "rescuable": None}
    rewrite_table(published, spec, [*rows, other])
    found = fill_exposed(published)
    assert (found.acted, found.idle, found.unknown, found.looked) == (3, 2, 0, 2)
    _, table = read_experiment(published)
    assert list(table["exposed"]) == [False, False, True, True, True]


def test_a_unit_that_the_code_draws_otherwise_stays_unknown(published):
    spec, rows = read_rows(published)
    rewrite_table(published, spec, [rows[0] | {"unit_id": "0" * 16}])
    assert fill_exposed(published).unknown == 1


def test_a_ledger_is_left_as_it_was_run(published):
    (published / "ledger.sqlite").touch()
    with pytest.raises(InputError):
        rewrite_table(published, read_spec(published), [])


@pytest.mark.slow
def test_a_cell_whose_stress_seldom_acts_is_found_before_it_runs(monkeypatch):
    monkeypatch.setattr(exposure, "DRAWN_WORLDS", 4)
    spec = load_spec("eq1").model_copy(update={"worlds": 4})
    kept = [d for d in spec.degradations if d.kind in ("low_texture", "fast_rotation")]
    of_corridor = {"bases": {"corridor": spec.bases["corridor"]}, "degradations": tuple(kept)}
    spec = spec.model_copy(update=of_corridor)
    drawn = {cell.cell: cell for cell in draw_exposure(spec)}
    assert len(drawn) == 2 and [cell.is_exposed for cell in drawn.values()] == [False, True]
    always = kept[0].model_copy(update={"fields": {**kept[0].fields, "view_share": 0.8}})
    spec = spec.model_copy(update={"degradations": (always,)})
    assert all(cell.acted == 4 for cell in draw_exposure(spec))
    assert draw_exposure(spec.model_copy(update={"worlds": 3})) == []
