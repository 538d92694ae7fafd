"""Progress and status of an experiment: per system, with dashes for what a system does not have."""

from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq

from dslab.experiments.campaign.runner import SystemTally, Tally
from dslab.experiments.cli.units import estimates_text

ROOT = Path(__file__).parents[3]


def test_estimates_are_shares_with_counts():
    dual = SystemTally("dual", completed=10, breakages=4, failures=1)
    tally = Tally(12, 20, void=1, errors=1, retries=5, ended_here=6, workers=2, systems=(dual,))
    assert estimates_text(tally) == "p0 0.40 (4/10), dual failures 0.10 (1/10); 1 void, 1 errors"
    crossing = SystemTally("dual", 0, 0, 0, crossing=8, uncrossed=2)
    assert estimates_text(replace(tally, systems=(crossing,), errors=0)) == (
        "no thread crosses 0.25 (2/8); 1 void"
    )
    assert estimates_text(Tally(0, 20, 0, 0, 0, 0, workers=0)) == "0 void"
    own = SystemTally("Own", completed=0, breakages=0, failures=0, has_threads=False)
    assert estimates_text(replace(tally, systems=(dual, own), errors=0)) == (
        "dual: p0 0.40 (4/10), dual failures 0.10 (1/10); Own: p0 - (0/0), system failures - (0/0); 1 void"
    )


def test_a_system_without_threads_has_a_dash_where_all_threads_fail(dslab):
    folder = ROOT / "docs" / "rescue"
    code, out, _ = dslab("experiment", "status", folder)
    lines = [line.split() for line in out.splitlines() if " / " in line]
    assert code == 0 and lines and all(line[-2] == "-" for line in lines)
    assert out.rstrip().splitlines()[-1].startswith("360 of 360 units, finished, ")


def test_a_run_of_the_crossing_arm_says_how_often_no_thread_crosses(dslab, tmp_path):
    folder = tmp_path / "threads"
    assert dslab("experiment", "merge", str(ROOT / "docs" / "threads"), "--out", str(folder))[0] == 0
    code, out, _ = dslab("experiment", "run", "threads", "--out", str(folder))
    table = pq.read_table(ROOT / "docs" / "threads" / "units.parquet").to_pandas()
    table = table[table["exposed"]]  # in nine units the stress acts on no frame
    failed = table[[f"cross_r{thread}_failed" for thread in (1, 2, 3)]].astype(bool).all(axis=1).sum()
    assert code == 0
    assert f"700 of 700 units: no thread crosses {failed / 691:.2f} ({failed}/691); 0 void" in out
