"""Committed results: report.json follows from the records, the documentation from report.json."""

import json
import runpy
from pathlib import Path

import pytest

from experiments.campaign.folder import read_experiment
from experiments.report.content import report_content
from experiments.report.describe import interval_of_share
from experiments.runs.files import to_json

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "docs" / "eq1-quick"


@pytest.fixture(scope="module")
def report():
    return json.loads((FOLDER / "report.json").read_text())


def percent(share: float) -> str:
    return f"{100 * share:.1f}"


def figures(data, place: str = "") -> dict:
    """Every number, text and null of nested data by its place."""
    if not isinstance(data, dict | list):
        return {place: data}
    inside = data.items() if isinstance(data, dict) else enumerate(data)
    return {k: v for name, of in inside for k, v in figures(of, f"{place}/{name}").items()}


def test_the_report_follows_from_the_records(report):
    again = json.loads(to_json(report_content(*read_experiment(FOLDER), FOLDER)))
    assert again["reanalysed"] and again["format"] == report["format"] == 2
    for part in ("answer", "units", "analysis", "taxonomy", "tables"):
        assert figures(again[part]) == pytest.approx(figures(report[part]), abs=1e-9, nan_ok=True)


def test_a_page_of_pandas_gives_the_same_figures(report, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["recompute.py", str(FOLDER / "units.parquet")])
    again = runpy.run_path(str(ROOT / "examples" / "recompute.py"))["found"]
    cells = {(c["cell"], c["world"], c["n"]): c for c in report["analysis"]["cells"]}
    assert len(again) == len(cells) == 36 and "low_texture/2" in capsys.readouterr().out
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


def test_the_documentation_agrees_with_the_records(report):
    page, readme = (" ".join((ROOT / name).read_text().split()) for name in ("docs/eq1.md", "README.md"))
    analysis = report["analysis"]
    for row in analysis["kinds_of_world"]:
        if row["world"] == "corridor":
            shown = interval_of_share(row["measured"])
            eq1, weakest = (percent(row[name]) for name in ("eq1", "weakest"))
            assert f"| {row['n']} | {eq1} % | {weakest} % | {shown} |" in page
            assert f"{percent(row['measured']['value'])} %" in readme and f"{eq1} %" in readme
    assert interval_of_share(analysis["failed_or_silent_by_worlds"]) in page
    silent = report["taxonomy"]["silent"]
    assert f"{silent['events']} of the {silent['units']} unbroken units" in page
    for name, row in zip(("ORB", "SIFT"), report["taxonomy"]["threads"][2:], strict=True):
        assert row["arm"] == "crossing"
        assert f"{row['false']['events']} of {row['false']['units']} by {name}" in page
