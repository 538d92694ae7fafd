"""Systems beside each other on the page of an experiment."""

from types import SimpleNamespace

import pytest
from html_page import Page
from report_fakes import FakeSpec, fake_table

from dslab.experiments.report.content import report_content
from dslab.experiments.report.page import report_html
from dslab.experiments.report.plots.style import NARROW_IN, WIDE_IN, settings
from dslab.experiments.report.plots.systems import draw_systems

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
    assert alone.report["answer"]["headline"] == "Not asked: no system has recovery threads."
    assert {"href": "#systems"} in alone.page.all("a") and {"href": "#chain"} not in alone.page.all("a")


def test_one_system_with_recovery_threads_stands_beside_none(tmp_path):
    alone = made(tmp_path, "dual")
    assert alone.report["systems"] is None and {"href": "#systems"} not in alone.page.all("a")


def test_every_system_has_a_point_at_every_dose(two):
    with settings():
        for width_in in (WIDE_IN, NARROW_IN):
            figure = draw_systems(two.report, width_in)
            assert len(figure.axes) == 6  # three kinds of degradation, breakages and missions
            points = [c for axes in figure.axes for c in axes.containers]
            assert len(points) == 6 * 2 * 2
