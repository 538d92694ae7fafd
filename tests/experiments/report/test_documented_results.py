"""Committed results: report.json follows from the records, the documentation from report.json."""

import json
from pathlib import Path

import pytest

from experiments.campaign.folder import read_experiment
from experiments.report.content import report_content

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "docs" / "eq1-quick"


@pytest.fixture(scope="module")
def report():
    return json.loads((FOLDER / "report.json").read_text())


def percent(share: float) -> str:
    return f"{100 * share:.1f}"


@pytest.mark.slow
def test_the_report_follows_from_the_records(report):
    again = json.loads(json.dumps(report_content(*read_experiment(FOLDER), FOLDER), default=float))
    for cell, before in zip(again["analysis"]["cells"], report["analysis"]["cells"], strict=True):
        assert (cell["cell"], cell["p0"], cell["threads"]) == (
            before["cell"],
            before["p0"],
            before["threads"],
        )
        for level, as_before in zip(cell["levels"], before["levels"], strict=True):
            assert level["measured"] == as_before["measured"] and level["verdict"] == as_before["verdict"]
            assert level["lrt_p"] == pytest.approx(as_before["lrt_p"])
    assert again["units"] == report["units"]


def test_the_documentation_agrees_with_the_records(report):
    page, readme = (" ".join((ROOT / name).read_text().split()) for name in ("docs/eq1.md", "README.md"))
    kinds = report["kinds_of_world"]
    for level in kinds["levels"]:
        measured, by_cell, by_kind = (
            level[name] for name in ("measured", "predicted_by_cell", "predicted_by_kind")
        )
        shown = f"{percent(measured['value'])} % [{percent(measured['low'])}, {percent(measured['high'])}]"
        assert f"| {level['n']} | {shown} | {percent(by_cell)} % | {percent(by_kind)} % |" in page
        assert f"{percent(measured['value'])} %" in readme and f"{percent(by_kind)} %" in readme
    rows = [row for row in kinds["rows"] if not row["cell"].startswith("fast_rotation")]
    for world in ("room", "corridor"):
        broke, units = (sum(r[name] for r in rows if r["world"] == world) for name in ("breakages", "units"))
        assert f"{broke} of {units}" in page
    cells = report["analysis"]["cells"]
    silent, unbroken = (
        sum(cell["silent"]["events"] for cell in cells),
        sum(cell["completed"] - cell["p0"]["events"] for cell in cells),
    )
    assert f"{silent} of the {unbroken} unbroken units" in page
    for thread, name in enumerate(("ORB", "SIFT")):
        false = [cell["threads"][thread]["false_recoveries"] for cell in cells]
        assert f"{sum(f['events'] for f in false)} of {sum(f['units'] for f in false)} by {name}" in page
