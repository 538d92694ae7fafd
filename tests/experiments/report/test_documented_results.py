"""Committed results: report.json follows from the records, the documentation from report.json."""

import json
import re
import runpy
from pathlib import Path

import pytest

from dslab.experiments.campaign.folder import read_experiment, read_spec, release_of
from dslab.experiments.eq1.spec import load_spec
from dslab.experiments.report.content import report_content
from dslab.experiments.runs.files import to_json

ROOT = Path(__file__).resolve().parents[3]
FIRST, RUN = ROOT / "docs" / "eq1-quick", ROOT / "docs" / "eq1"


@pytest.fixture(scope="module")
def reports():
    return {folder: json.loads((folder / "report.json").read_text()) for folder in (FIRST, RUN)}


def words(name: str) -> str:
    return " ".join((ROOT / name).read_text().split())


def figures(data, place: str = "") -> dict:
    """Every number, text and null of nested data by its place."""
    if not isinstance(data, dict | list):
        return {place: data}
    inside = data.items() if isinstance(data, dict) else enumerate(data)
    return {k: v for name, of in inside for k, v in figures(of, f"{place}/{name}").items()}


@pytest.mark.parametrize("name", ["eq1", "ldso", "threads"])
def test_a_preset_with_a_published_table_is_still_that_experiment(name):
    assert load_spec(name).content_hash == read_spec(ROOT / "docs" / name).content_hash


@pytest.mark.parametrize("folder", sorted(file.parent for file in ROOT.glob("docs/*/units.parquet")))
@pytest.mark.slow
def test_a_published_table_names_its_release_and_its_seeds_are_still_drawn(folder):
    assert re.fullmatch(r"\d+\.\d+\.\d+|[0-9a-f]{40}", release_of(folder))
    spec, table = read_experiment(folder)
    drawn = ["kind", "severity", "base", "world_seed", "sequence_seed", "repeat_seed", "start_frame"]
    for row in table.groupby("cell").head(1).itertuples() if folder != FIRST else ():
        unit = spec.unit(row.cell, int(row.index))
        assert [getattr(unit, name) for name in drawn] == [getattr(row, name) for name in drawn]


def test_the_figures_of_direct_methods_follow_from_their_tables():
    """Those in prose; the tables of the page are made."""
    known, page = words("docs/known.md"), words("docs/direct.md")
    table = read_experiment(ROOT / "docs" / "ldso")[1]
    done = table[(table["outcome"] == "completed") & table["exposed"].fillna(False)]
    ldso = done[done["system"] == "ldso"]
    unbroken, delays_s = ldso[~ldso["breakage"]], ldso["declaration_delay_s"].dropna()
    silent = 100 * unbroken["silent_failure"].sum() / len(unbroken)
    assert f"{len(unbroken)} stressed units" in known and f"{silent:.1f} %" in known
    assert delays_s.quantile(0.95) == 0 and f"95 % of {len(delays_s)} cases" in known
    assert f"{delays_s.max():.2f} s" in known
    table = read_experiment(ROOT / "docs" / "threads")[1]
    table = table[table["exposed"]]
    failed = [table[f"cross_r{thread}_failed"].astype(bool) for thread in (1, 2, 3)]
    both = failed[0] & failed[1]
    assert f"{(both & ~failed[2]).sum()} of the {both.sum()} trials" in page
    declared = table["cross_r3_declared"].sum()
    other = read_experiment(ROOT / "docs" / "direct-thread")[1]
    false = table["cross_r3_false"].sum() + other["cross_r3_false"].sum()
    assert f"{false} of {declared + other['cross_r3_declared'].sum()}" in page


@pytest.mark.parametrize("folder", [FIRST, pytest.param(RUN, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_the_report_follows_from_the_records(reports, folder):
    report = reports[folder]
    again = json.loads(to_json(report_content(*read_experiment(folder), folder)))
    assert again["reanalysed"] == (folder is FIRST) and again["format"] == report["format"] == 2
    for part in ("answer", "units", "analysis", "taxonomy", "tables"):
        assert figures(again[part]) == pytest.approx(figures(report[part]), abs=1e-9, nan_ok=True)


@pytest.mark.parametrize(
    ("folder", "rows", "cell"), [(FIRST, 36, "low_texture/2"), (RUN, 32, "room/fog-creeping/1")]
)
def test_a_page_of_pandas_gives_the_same_figures(reports, folder, rows, cell, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["recompute.py", str(folder / "units.parquet")])
    again = runpy.run_path(str(ROOT / "examples" / "recompute.py"))["found"]
    cells = {(c["cell"], c["world"], c["n"]): c for c in reports[folder]["analysis"]["cells"]}
    assert len(again) == len(cells) == rows and cell in capsys.readouterr().out
    for row in again.itertuples():
        cell = cells[row.cell, row.world, row.n]
        mine = (cell["eq1"], cell["weakest"], cell["in_units"], cell["shares"]["dual_failure"]["value"])
        theirs = (row.eq1, row.weakest_link, row.in_units, row.measured)
        assert mine == pytest.approx(theirs, abs=1e-12)
        for name, ends in (
            ("breakage", (row.p0_low, row.p0_high)),
            ("dual_failure", (row.measured_low, row.measured_high)),
        ):
            share = cell["shares"][name]
            assert (share["low"], share["high"]) == pytest.approx(ends, abs=1e-9)


def test_the_figures_of_eq1_follow_from_its_records(reports):
    """Those in prose; the tables of the page are made."""
    page, report = words("docs/eq1.md"), reports[RUN]
    analysis = report["analysis"]
    named = [cell for cell in analysis["cells"] if cell["n"] <= 2]
    refuted = [sum(c[f"verdict_{of}"] == "optimistic" for c in named) for of in ("in_units", "forecast")]
    assert f"{refuted[0]} of {len(named)} tests, the forecast in {refuted[1]}" in page
    assert f"{analysis['units']:,} trials" in page and f"{analysis['unexposed']} trials (96" in page
    for of in ("measured", "of_sequences"):
        one, two = (r for r in analysis["readings"] if r["cell"] is None and r["n"] <= 2)
        shares = [r[of]["value" if of == "measured" else "predicted"] for r in (one, two)]
        assert all(f"{100 * share:.1f}" in page for share in shares)
    for test in analysis["within_sequences"][:2]:
        assert f"{test['ratio']:.3f}" in page and f"p = {test['p']:.2f}" in page
    for share in analysis["chance"].values():
        low, high = 100 * share["low"], 100 * share["high"]
        assert f"{100 * share['value']:.0f} % [{low:.0f}, {high:.0f}]" in page
    gain = {k: f"{100 * v:.1f}" for k, v in analysis["formulas"][1]["second_thread"].items()}
    assert f"{gain['value']} percentage points [{gain['low']}, {gain['high']}]" in page
    silent = report["taxonomy"]["silent"]
    assert f"{silent['events']} of the {silent['units']:,} unbroken trials" in page
