"""A list in the stress of a batch is a series of doses: runs at each, and every system against them."""

import json
from typing import Literal

import batch_fakes
import pandas as pd
import pytest
from pool_fakes import open_local_pool
from slam_fakes import make_sequence

from dslab.experiments.batch import run as batch_run
from dslab.experiments.batch.doses import dose_series
from dslab.experiments.batch.run import run_batch
from dslab.experiments.batch.spec import BatchSpec
from dslab.experiments.comparison.dose_response import dose_response
from dslab.scenarios.errors import InputError
from dslab.scenarios.segments import SegmentBase
from dslab.sim.io.tum import write_tum

BLUR = "motion_blur:start_s=0.3,duration_s=0.3,exposure_s="
SYSTEM = """
import numpy as np

class Own:
    def __init__(self, camera, seed):
        pass

    def process(self, image, stamp_s):
        T = np.eye(4)
        T[0, 3] = stamp_s
        return T
"""


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    monkeypatch.setattr(batch_run, "open_pool", open_local_pool)


@pytest.fixture
def folder(tmp_path):
    write_tum(make_sequence(30, segment=None), tmp_path / "drive")
    return tmp_path / "drive"


def test_a_list_is_a_condition_per_dose():
    found = dose_series(["fog:start_s=1,duration_s=2,visibility_m=9", BLUR + "[0.1, 0.02]"])
    assert found is not None and (found.kind, found.field) == ("motion_blur", "exposure_s")
    assert found.label(0.1) == "exposure 0.1 s" and list(found.stresses) == [0.02, 0.1]
    assert [stress[1] for stress in found.stresses.values()] == [BLUR + "0.02", BLUR + "0.1"]
    one, two = (
        BatchSpec(sequences=("x",), systems=("base",), stress=(BLUR + of,)) for of in ("[1]", "[1,2]")
    )
    assert one.row_key == two.row_key  # doses may be added


def test_the_list_of_a_field_that_holds_several_is_no_series(monkeypatch):
    class Tint(SegmentBase):
        kind: Literal["tint"] = "tint"
        gains: tuple[float, ...] | None = None
        share: float = 1.0

    for module in ("dslab.experiments.batch.doses", "dslab.scenarios.segment_text"):
        monkeypatch.setattr(f"{module}.SEGMENT_KINDS", {"tint": Tint})
    text = "tint:start_s=2,duration_s=1,gains=[1,0.9,0.8]"
    found = dose_series([f"{text},share=[0.5,1]"])
    assert dose_series([text]) is None and found is not None and found.field == "share"


@pytest.mark.parametrize(
    ("stress", "says"),
    [
        (["a", BLUR + "[0.1,x]"], "'x' is no number"),
        ([BLUR + "[0.1,0.10]"], "0.10 is given twice"),
        (["motion_blur:start_s=[1,2],duration_s=0.3,exposure_s=[0.1,0.2]"], "is not the only list of doses"),
    ],
)
def test_a_series_that_is_wrong_is_bad_input(stress, says):
    with pytest.raises(InputError, match=says):
        dose_series(stress)


def test_a_wrong_dose_is_one_line(tmp_path, dslab):
    (tmp_path / "b.yaml").write_text(
        f"sequences: [clean-room]\nsystems: [base]\nstress: ['{BLUR}[0.1,-1]']\n"
    )
    code, _, err = dslab("batch", tmp_path / "b.yaml", "--out", tmp_path / "b")
    assert code == 2 and "b.yaml:3: stress[0]" in err and err.count("\n") == 1


@pytest.mark.slow
def test_doses_are_added_and_stand_in_table_and_plot(folder, tmp_path, dslab):
    (tmp_path / "own.py").write_text(SYSTEM)
    out = tmp_path / "b"

    def command(doses):
        spec = {"sequences": [str(folder)], "systems": [f"{tmp_path}/own.py:Own"], "runs": 2}
        (tmp_path / "b.yaml").write_text(json.dumps(spec | {"stress": [f"{BLUR}{doses}"]}))
        return dslab("batch", tmp_path / "b.yaml", "--out", out)

    command("[0.05]")
    first = {path: path.stat().st_mtime_ns for path in out.rglob("summary.json")}
    code, said, _ = command("[0.02,0.05]")
    rows = pd.read_parquet(out / "runs.parquet")
    assert code == 0 and rows.dose.tolist() == [0.02, 0.02, 0.05, 0.05] and rows.folder.nunique() == 4
    assert rows.stress.tolist()[::2] == [f"{BLUR}0.02", f"{BLUR}0.05"] and len(first) == 2
    assert all(path.stat().st_mtime_ns == made for path, made in first.items())
    table = pd.read_csv(out / "dose_response.csv")
    assert table.dose.tolist() == [0.02, 0.05] and table.runs.tolist() == [2, 2] and table.broke.isna().all()
    assert (
        out / "figures" / "dose_response.png"
    ).stat().st_size > 10_000 and "drive, exposure 0.02 s" in said
    code, said, _ = dslab("compare", str(out), "--out", str(tmp_path / "page"), "--json")
    (series,) = json.loads(said)["dose_series"]
    assert series["axis"] == "motion blur, exposure (s)"
    assert [point["completeness"]["mean"] for point in series["points"]] == table.completeness.tolist()
    page = (tmp_path / "page" / "index.html").read_text()
    assert page.count("<figure>") == 1 + 2 * 4 and page.count('id="input') == page.count('href="#input') == 2
    assert 'href="#dose1"' in page and '<td data-label="completeness">100 % (all alike)</td>' in page


def test_points_are_of_runs_or_of_many_sequences():
    """A quarter of 40 runs fails, all those of 1 of 4 or of 2 of 8 sequences."""

    def point(sequences):
        about = {"dose": 1.0, "system": "a", "declares": "events", "breakages": 0, "completeness": 0.5}
        runs = [{"sequence": k % sequences, "intact": k % 4 > 0, "ate_m": None} | about for k in range(40)]
        (found,) = dose_response(runs)
        return found

    few, many = point(4), point(8)
    assert few["failed"]["mean"] == many["failed"]["mean"] == 0.25 and few["ate_m"]["mean"] is None
    width = [of["failed"]["high"] - of["failed"]["low"] for of in (few, many)]
    assert width[0] < 0.3 < width[1] and few["completeness"]["reason"] == "all alike"
    assert few["broke"]["mean"] == few["broke"]["low"] == 0 < few["broke"]["high"] < 0.12


def test_the_stress_of_a_dose_is_that_of_its_runs(folder, tmp_path):
    spec = BatchSpec(sequences=("drive",), systems=("base",), runs=1, stress=(BLUR + "[0.02,0.1]",))
    rows = run_batch(spec, [str(folder)], tmp_path / "b", task=batch_fakes.made_up)
    assert [spec.segments(dose)[0].severity["exposure_s"] for dose in rows.dose] == [0.02, 0.1]
