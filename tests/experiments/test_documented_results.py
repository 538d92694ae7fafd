"""The committed results: report.json follows from the records beside it, the README from report.json."""

import json
from pathlib import Path

import pytest

from experiments.experiment_folder import read_experiment
from experiments.report.content import report_content

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "eq1-quick"


@pytest.fixture(scope="module")
def report():
    return json.loads((FOLDER / "report.json").read_text())


def percent(share: float) -> str:
    return f"{100 * share:.1f}"


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


def test_the_readme_says_what_the_report_says(report):
    readme = " ".join((ROOT / "README.md").read_text().split())
    for level in report["verdict"]["levels"]:
        for name in ("measured", "within"):
            found = level["overall"][name]
            value = found["estimate"] if name == "measured" else found["value"]
            told = f"[{percent(found['low'])}, {percent(found['high'])}]"
            assert f"{percent(value)} %" in readme and told in readme
    counts = [level["counts"] for level in report["verdict"]["levels"]]
    optimistic, undecided = (sum(c[name] for c in counts) for name in ("optimistic", "undecided"))
    assert f"{optimistic} are *optimistic* and {undecided} *undecided*" in readme
    cells = report["analysis"]["cells"]
    units = sum(cell["completed"] for cell in cells)
    assert f"{sum(cell['silent']['events'] for cell in cells)} of {units} units" in readme
    for thread, name in enumerate(("ORB", "SIFT")):
        false = [cell["threads"][thread]["false_recoveries"] for cell in cells]
        assert f"{sum(f['events'] for f in false)} of {sum(f['units'] for f in false)} by {name}" in readme
