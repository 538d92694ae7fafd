"""The examples run as they stand, and so do the cells of the notebook."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
pytestmark = pytest.mark.slow


def run(code_or_file, folder):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    done = subprocess.run(
        [sys.executable, *code_or_file],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("quickstart", "breakages: ["),
        ("own_images", "frames have a pose"),
        ("own_degradation", "50% dead: "),
        ("own_recovery_thread", "patient_orb: "),
        ("small_experiment", "2 of 2 units"),
    ],
)
def test_the_example_runs(name, said, tmp_path):
    assert said in run([EXAMPLES / f"{name}.py"], tmp_path)


def test_the_cells_of_the_notebook_run_and_show_figures(tmp_path):
    notebook = json.loads((EXAMPLES / "quickstart.ipynb").read_text())
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    run(["-c", "\n".join("".join(cell["source"]) for cell in cells)], tmp_path)
    shown = [output.get("data", {}) for cell in cells for output in cell["outputs"]]
    assert sum("image/png" in data for data in shown) >= 2


def test_the_quickstart_is_twelve_lines():
    lines = (EXAMPLES / "quickstart.py").read_text().splitlines()
    assert len([line for line in lines if line and not line.startswith(('"""', "#"))]) <= 12
