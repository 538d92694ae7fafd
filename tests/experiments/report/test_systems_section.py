"""Systems beside each other on the page of an experiment."""

import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from html_page import Page
from report_fakes import FakeSpec, fake_table

from dslab.experiments.report.content import report_content
from dslab.experiments.report.page import report_html
from dslab.experiments.report.plots.style import NARROW_IN, WIDE_IN, settings
from dslab.experiments.report.plots.systems import draw_systems
from dslab.experiments.report.systems import sham_warnings

FEW = 99


def made(tmp_path, *systems: str) -> SimpleNamespace:
    spec = FakeSpec(doses=2, units=12, systems=systems)
    table = fake_table(spec)
    foreign = table["cell"].str.endswith("/Own").to_numpy(bool) | (systems == ("Own",))
    own = [
        name for name in table if name[:2] in ("d1", "d2") or name.startswith(("base_", "free_", "cross_"))
    ]
    table.loc[foreign, own] = None
    table.loc[foreign, ["declares", "ended"]] = ["nothing", "finished"]
    table.loc[foreign, "silent_failure"] = None
    for n in (1, 2):
        table[f"s{n}"], table[f"m{n}"] = table["breakage"], table["breakage"]
    report = report_content(spec, table, tmp_path, FEW)
    return SimpleNamespace(spec=spec, table=table, report=report, page=Page(report_html(report, {})))


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    return made(tmp_path_factory.mktemp("two"), "dual", "Own")


def test_eq1_is_asked_of_systems_with_recovery_threads_only(two):
    assert {cell["cell"].rpartition("/")[2] for cell in two.report["analysis"]["cells"]} == {"dual"}
    assert {row["system"] for row in two.report["tables"]["table_2"]} == {"dual"}
    assert two.report["units"]["recorded"] == len(two.table) == 2 * 6 * 12


def test_shares_and_paired_differences_are_those_of_the_table(two):
    systems, done = two.report["systems"], two.table[two.table.outcome == "completed"]
    shares = {share["cell"]: share for share in systems["shares"]}
    for cell, own in done.groupby("cell"):
        by_world = own.groupby("world_seed")
        assert shares[cell]["shares"]["breakage"]["value"] == pytest.approx(by_world.breakage.mean().mean())
    pair = next(p for p in systems["over_doses"] if p["failure"] == "mission_failure")
    assert (pair["first"], pair["second"]) == ("dual", "Own") and 0 < pair["units"] <= len(done) / 2
    assert not any(p["failure"] == "silent_failure" for p in systems["over_doses"])


def test_the_page_says_by_what_a_breakage_is_known_and_links_the_section(two):
    text = two.page.text
    assert "dual – Own" in text and "× nothing" in text
    assert {"href": "#systems"} in two.page.all("a")
    assert not {a["id"] for a in two.page.all("h2")} - {
        a["href"][1:] for a in two.page.all("a") if "href" in a
    }


def test_without_recovery_threads_the_page_does_not_ask_eq1(tmp_path):
    alone = made(tmp_path, "Own")
    assert alone.report["answer"]["headline"].startswith("Missions that fail under stress: Own ")
    assert "these systems stand beside each other" in alone.report["answer"]["sentences"][-1]
    assert {"href": "#systems"} in alone.page.all("a") and {"href": "#chain"} not in alone.page.all("a")


def test_one_system_with_recovery_threads_stands_beside_none(tmp_path):
    alone = made(tmp_path, "dual")
    assert alone.report["systems"] is None and {"href": "#systems"} not in alone.page.all("a")


def test_the_answer_names_every_system_with_its_failures_before_eq1(two):
    headline, sentences = two.report["answer"]["headline"], two.report["answer"]["sentences"]
    assert re.match(
        r"Missions that fail under stress: dual [\d.]+ % \[.*\], Own [\d.]+ % \[.*\]\. \w", headline
    )
    done = two.table[two.table.outcome == "completed"]
    own = done[done["cell"].str.endswith("/Own")]
    by_world = own.groupby(["world_seed", "cell", "sequence"]).m2.mean().groupby(level=[0, 1]).mean()
    assert f"Own {100 * by_world.groupby(level=0).mean().mean():.1f} %" in headline
    assert re.match(r"dual (is not told from|fails (less|more) often than) Own \(corridor: ", sentences[0])
    assert headline in two.page.text


def test_a_run_of_the_free_arm_alone_has_no_figure_of_eq1(tmp_path):
    spec = FakeSpec(doses=1, units=12, arms=("free",))
    table = fake_table(spec)
    table["m2"] = table["breakage"]
    report = report_content(spec, table, tmp_path, FEW)
    assert report["answer"]["headline"].endswith("Eq. 1 is not asked: only the free arm ran.")
    assert report["answer"]["rows"] == []
    page = Page(report_html(report, {}))
    assert {"href": "#systems"} in page.all("a") and {"href": "#chain"} not in page.all("a")


def test_a_system_that_fails_without_stress_or_of_which_nothing_counts_is_named(two):
    table = two.table.copy()
    assert sham_warnings(table, 2, Path("out/x")) == []
    own = table["cell"].str.endswith("/Own").to_numpy(bool)
    sham = own & table["cell"].str.startswith("motion_blur/1").to_numpy(bool)
    table["system"] = ["Own" if foreign else "dual" for foreign in own]
    table.loc[sham, ["kind", "breakage", "breakage_reason"]] = ["sham", True, "no_pose"]
    count = (table[sham].outcome == "completed").sum()
    (warning,) = sham_warnings(table, 2, Path("out/x"))
    assert warning.startswith(f"Own fails without stress in {count} of {count} trials, most for: no pose: ")
    assert re.search(r"See one: dslab experiment replay out/x motion_blur/1/Own:\d+$", warning)
    table.loc[own, ["outcome", "void_reason"]] = ["void", "no map"]
    (warning,) = sham_warnings(table, 2, Path("out/x"))
    assert warning.startswith("Nothing is known of Own: all its 72 trials are void, most for: no map. A")
    assert "fits the truth to 5%. See one:" in warning


def test_lead_ins_that_are_left_out_bear_the_name_of_their_system(two):
    table = two.table.copy()
    own = table["cell"].str.endswith("/Own").to_numpy(bool)
    table.loc[table["outcome"] == "void", "outcome"] = "completed"
    table.loc[own, ["outcome", "void_reason"]] = ["void", "no map"]
    said = report_content(two.spec, table, Path("out/x"), FEW)["answer"]["sentences"][-1]
    assert "lead-ins of Own that ended without a healthy map" in said


def test_every_system_has_a_point_at_every_dose(two):
    with settings():
        for width_in in (WIDE_IN, NARROW_IN):
            figure = draw_systems(two.report, width_in)
            assert len(figure.axes) == 6  # three kinds of degradation, breakages and missions
            points = [c for axes in figure.axes for c in axes.containers]
            assert len(points) == 6 * 2 * 2
