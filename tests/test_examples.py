"""The examples run as they stand, and so do the cells of the notebook."""

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from dslab import experiments

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def runs():
    """Runs by system, as quickstart and notebook make the same ones."""
    return {}


@pytest.fixture
def here(monkeypatch, tmp_path, runs):
    """A folder for the outputs; a run of a system is done once."""
    run = experiments.run

    def run_once(sequence, system):
        if system not in runs:
            runs[system] = run(sequence, system)
        return runs[system]

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setattr(experiments, "run", run_once, raising=False)
    return tmp_path


def test_the_quickstart_shows_that_the_base_stays_lost_where_dual_slam_recovers(here, runs, capsys):
    runpy.run_path(str(EXAMPLES / "quickstart.py"), run_name="__main__")
    assert "breakages: [" in capsys.readouterr().out and (here / "quickstart.png").is_file()
    base, dual = (runs[system].metrics for system in ("base", "dual"))
    # Either may relocalize briefly, with too little in view to keep tracking.
    assert base["breakages"] >= 1 and base["share_tracked"] < 0.4
    assert dual["breakages"] >= 1 and dual["recoveries"] == 1 and dual["share_tracked"] > 0.9
    assert dual["ate_poses"] > 0.9 * dual["frames"] and dual["ate_m"] < 0.01 * dual["path_m"]


def test_the_cells_of_the_notebook_run_and_show_figures(here):
    notebook = json.loads((EXAMPLES / "quickstart.ipynb").read_text())
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    exec("\n".join("".join(cell["source"]) for cell in cells), {})
    shown = [output.get("data", {}) for cell in cells for output in cell["outputs"]]
    assert sum("image/png" in data for data in shown) >= 2


def test_the_small_experiment_is_run_and_reported(here, capsys):
    runpy.run_path(str(EXAMPLES / "small_experiment.py"), run_name="__main__")
    assert "1 of 1 units" in capsys.readouterr().out
    assert (here / "small-experiment" / "report.html").is_file()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("many_seeds", "small/room"),
        ("own_images", "frames have a pose"),
        ("own_degradation", "50% dead: "),
        ("own_recovery_thread", "patient_orb: "),
    ],
)
def test_the_example_runs_as_a_program(name, said, tmp_path):
    # What an example registers lasts as long as its process.
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert said in done.stdout


def test_the_readings_of_eq1_are_printed_for_a_published_run(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["eq1_readings.py", str(ROOT / "docs" / "eq1"), "way", "beta"])
    runpy.run_path(str(EXAMPLES / "eq1_readings.py"))
    lines = capsys.readouterr().out.splitlines()
    assert sum("k of Q" in line for line in lines) == 16 and lines[-4].count("[") == 8


def test_the_quickstart_is_twelve_lines():
    lines = (EXAMPLES / "quickstart.py").read_text().splitlines()
    assert len([line for line in lines if line and not line.startswith(('"""', "#"))]) <= 12
