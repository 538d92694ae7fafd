"""Committed results: report.json follows from the records, the documentation from report.json."""

import json
import runpy
from collections import Counter
from pathlib import Path

import pytest

from dslab.experiments.campaign.folder import read_experiment
from dslab.experiments.eq1.spec import load_spec
from dslab.experiments.report.content import report_content
from dslab.experiments.report.describe import interval_of_share, percent
from dslab.experiments.runs.files import to_json

ROOT = Path(__file__).resolve().parents[3]
FIRST, RUN = ROOT / "docs" / "eq1-quick", ROOT / "docs" / "eq1"


@pytest.fixture(scope="module")
def reports():
    return {folder: json.loads((folder / "report.json").read_text()) for folder in (FIRST, RUN)}


def words(name: str) -> str:
    return " ".join((ROOT / name).read_text().split())


KINDS_OF_THREADS = ("low texture,", "motion blur,", "defocus,", "low light,", "fast rotation,", "fog,")


def figures(data, place: str = "") -> dict:
    """Every number, text and null of nested data by its place."""
    if not isinstance(data, dict | list):
        return {place: data}
    inside = data.items() if isinstance(data, dict) else enumerate(data)
    return {k: v for name, of in inside for k, v in figures(of, f"{place}/{name}").items()}


@pytest.mark.parametrize(
    ("name", "both_ways"),
    [
        ("eq1", False),
        ("eq1-doses", False),
        ("eq1-vga", False),
        ("direct-thread", True),
        ("threads", None),
        ("ldso", None),
        ("rescue", None),
    ],
)
def test_a_documented_run_is_its_preset_and_its_units_are_still_the_same(name, both_ways):
    """Whatever becomes a default later: the direct thread of `eq1` goes one way, as it did."""
    spec, table = read_experiment(ROOT / "docs" / name)
    assert load_spec(name).content_hash == spec.content_hash
    for row in table.groupby("cell").head(1).itertuples():
        unit = spec.unit(row.cell, int(row.index))
        assert unit.unit_id == row.unit_id
        meant = {thread.kind: thread.config for thread in unit.meant_threads}
        assert meant.get("direct", {}).get("other_way", {}).get("check") == both_ways


def test_what_direct_odometry_withstands_follows_from_its_table():
    page = words("docs/measured-systems.md").partition("what it withstands")[2]
    _, table = read_experiment(ROOT / "docs" / "ldso")
    _, smaller = read_experiment(ROOT / "docs" / "ldso-flicker")
    done = table[(table["outcome"] == "completed") & table["exposed"].fillna(False)]
    systems = [done[done["system"] == name] for name in ("dual", "ldso")]
    rows = (
        "low texture, contrast",
        "motion blur",
        "fast rotation",
        "low light",
        "flicker, .62",
        "flicker, .55",
    )
    for row in rows:
        run = smaller if row == "flicker, .55" else done
        of_kind = run[run["kind"] == row.partition(",")[0].replace(" ", "_")]
        cells = [of_kind[of_kind["system"] == name] for name in ("dual", "ldso")]
        broke = [f"{100 * cell['breakage'].mean():.0f}" for cell in cells]
        failed = [f"{100 * cell['mission_cause'].notna().mean():.0f}" for cell in cells]
        (told,) = [line for line in page.split("| |") if line.strip().startswith(row)]
        columns = [column.strip() for column in told.split("|")]
        assert columns[1:3] == broke and columns[6:8] == failed, row
    ldso = systems[1]
    unbroken = ldso[~ldso["breakage"]]
    assert f"**Of {len(unbroken)} stressed units" in page
    assert f"in silence in {unbroken['silent_failure'].sum()}, 8.7 %**" in page
    delays_s = ldso["declaration_delay_s"].dropna()
    assert (len(delays_s), delays_s.quantile(0.95)) == (
        180,
        0,
    ) and f"the latest after {delays_s.max():.2f}".replace("0.", ".") in page


def test_the_claim_about_the_direct_thread_follows_from_its_table():
    page = words("docs/direct.md")
    _, table = read_experiment(ROOT / "docs" / "direct-thread")
    assert table["cross_r3_declared"].sum() == 191 and not table["cross_r3_false"].any()
    assert "**none of 191 alignments that were declared is false**" in page
    for (_, cell), crossed, needed in zip(table.groupby("cell"), (14, 17), (49, 48), strict=True):
        both = cell[cell["cross_r1_failed"] & cell["cross_r2_failed"]]
        assert ((~both["cross_r3_failed"]).sum(), len(both)) == (crossed, needed)
        assert f"| {needed} | **{100 * crossed / needed:.1f} %" in page


def test_the_threads_beside_each_other_follow_from_their_table():
    page = words("docs/direct.md").partition("Fourteen conditions side by side")[2]
    spec, table = read_experiment(ROOT / "docs" / "threads")
    table = table[table["exposed"]]
    failed = {thread: table[f"cross_r{thread}_failed"].astype(bool) for thread in (1, 2, 3)}
    both = failed[1] & failed[2]
    assert (
        f"it crosses {(both & ~failed[3]).sum()} of the {both.sum()} trials in which ORB and SIFT both"
        in page
    )
    rows = [line.split("|") for line in page.split("| |") if line.strip().startswith(KINDS_OF_THREADS)]
    cells = [table[table["cell"] == name] for name in spec.cell_names()]
    for row, cell in zip(rows, cells, strict=True):
        shares = [f"{100 * cell[f'cross_r{thread}_failed'].mean():.0f}" for thread in (1, 2, 3)]
        assert [column.split()[0] for column in row[1:4]] == shares
        assert [row[4].strip(), row[6].strip()] == [str(cell["rescuable"].sum()), str(both[cell.index].sum())]


@pytest.mark.parametrize("folder", [FIRST, RUN])
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


def test_the_documentation_agrees_with_the_records_of_the_run(reports):
    page, report = words("docs/eq1.md"), reports[RUN]
    analysis = report["analysis"]
    failed = {(t["cell"], t["thread"]): percent(t["failed"]["value"]) for t in analysis["thread_shares"]}
    named = [cell for cell in analysis["cells"] if cell["n"] <= 2]
    for cell in named:
        broke = [percent(cell["shares"]["breakage"]["value"])] if cell["n"] == 1 else []
        shares = [failed[cell["cell"], cell["n"]], percent(cell["eq1"]), percent(cell["weakest"])]
        shown = interval_of_share(cell["shares"]["dual_failure"])
        assert f"| {' | '.join([*broke, *shares])} | {shown} |" in page, cell["cell"]
    verdicts = [Counter(cell[f"verdict_{of}"] for cell in named) for of in ("in_units", "forecast")]
    assert verdicts[0] == {"optimistic": 8, "saturated": 3, "untested": 3, "undecided": 2}
    assert verdicts[1] == {"optimistic": 4, "saturated": 3, "untested": 3, "undecided": 6}
    assert "Independence is refuted in 8 of 16 tests, the forecast in 4." in page
    assert f"{analysis['units']:,} trials count" in page and f"{analysis['unexposed']} trials (96" in page
    for of in ("measured", "of_sequences"):
        one, two = (r for r in analysis["readings"] if r["cell"] is None and r["n"] <= 2)
        shares = [r[of]["value" if of == "measured" else "predicted"] for r in (one, two)]
        assert all(f"{100 * share:.1f}" in page for share in shares)
    for cell in analysis["over_rescuable"]:
        reading = cell["readings"]
        if cell["n"] == 2 and reading and reading["of_averages"]["ratio"] and cell["failures"] > 10:
            shown = percent(reading["of_averages"]["predicted"]), interval_of_share(reading["measured"])
            assert f"| {reading['units']} | {shown[0]} | {shown[1]} |" in page, cell["cell"]
    for test in analysis["within_sequences"][:2]:
        assert (
            f"{test['ratio']:.3f}".lstrip("0") in page and f"p = {test['p']:.2f}".replace("0.", ".") in page
        )
    like = next(p for p in analysis["event_pairs"] if (p["first"], p["second"]) == (1, 4))["within"]
    assert f"**{like['value']:.0f} [{like['low']:.0f}, {like['high']:.0f}]**" in page
    for share in analysis["chance"].values():
        low, high = 100 * share["low"], 100 * share["high"]
        assert f"{100 * share['value']:.0f} % [{low:.0f}, {high:.0f}]" in page
    gain = {k: f"{100 * v:.1f}" for k, v in analysis["formulas"][1]["second_thread"].items()}
    assert f"{gain['value']} percentage points [{gain['low']}, {gain['high']}]" in page
    silent = report["taxonomy"]["silent"]
    assert f"{silent['events']} of the {silent['units']:,} unbroken trials" in page
    crossing = [row["false"] for row in report["taxonomy"]["threads"] if row["arm"] == "crossing"]
    for false in crossing:
        assert f"{false['events']} of {false['units']:,} by" in page
