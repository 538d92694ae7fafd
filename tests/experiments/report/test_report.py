"""Report of an experiment: its figures are those of the table, its page is self-contained."""

import errno
import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from html_page import Page
from report_fakes import KINDS, FakeSpec, fake_table
from slam_fakes import fake_factory, make_sequence

from dslab.experiments.eq1.units import ThreadChoice
from dslab.experiments.report import recordings, write
from dslab.experiments.report.content import report_content
from dslab.experiments.report.describe import percent
from dslab.experiments.report.page import report_html
from dslab.experiments.report.plots import draw
from dslab.experiments.report.plots.doses import draw_doses
from dslab.experiments.report.plots.draw import Image, Plot, rendered
from dslab.experiments.report.plots.paths import draw_paths
from dslab.experiments.report.plots.style import NARROW_IN, WIDE_IN, settings
from dslab.experiments.report.recordings import add_paths, paths_of, read_paths
from dslab.experiments.report.write import write_files, write_report
from dslab.experiments.runs.execution import execute
from dslab.scenarios.errors import InputError

IMAGE = Image(b"<svg xmlns='http://www.w3.org/2000/svg' width='300' height='150'/>", 300, 150)
PLOT = Plot("doses", "A plot.", IMAGE, IMAGE, b"png")
FEW = 99


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> SimpleNamespace:
    """A report of three cells, n = 1 and 2, with its files."""
    folder = tmp_path_factory.mktemp("a report's folder")
    spec = FakeSpec(doses=1)
    table = fake_table(spec, seed=0, hardness=1.5)
    report = report_content(spec, table, folder, FEW)
    with pytest.MonkeyPatch.context() as patch:
        # The figures are drawn; as files they take seconds.
        patch.setattr(draw, "rendered", lambda name, alt, *figures: replace(PLOT, name=name, alt=alt))
        write_files(report, folder)
    read = json.loads((folder / "report.json").read_text())
    html = (folder / "report.html").read_text()
    return SimpleNamespace(folder=folder, spec=spec, table=table, report=read, html=html, page=Page(html))


def done(made) -> pd.DataFrame:
    return made.table[made.table["outcome"] == "completed"]


def unknown(table: pd.DataFrame, *beginnings: str) -> pd.DataFrame:
    """The table without what its columns of such names say."""
    names = [name for name in table.columns if name.startswith(beginnings)]
    return table.assign(**{n: pd.Series(pd.NA, index=table.index, dtype=table[n].dtype) for n in names})


def test_figures_are_those_of_the_table(made):
    cells = made.report["analysis"]["cells"]
    assert {cell["cell"] for cell in cells} == set(made.spec.cell_names()) and len(cells) == 6
    for cell in cells:
        by_world = done(made)[done(made)["cell"] == cell["cell"]].groupby("world_seed")
        for name, column in (("breakage", "breakage"), ("dual_failure", f"d{cell['n']}")):
            assert cell["shares"][name]["value"] == pytest.approx(by_world[column].mean().mean())
        failed = [f"cross_r{j}_failed" for j in range(1, cell["n"] + 1)]
        assert cell["weakest"] == pytest.approx(by_world[["breakage", *failed]].mean().mean().min())


def test_every_unit_is_counted_once(made):
    units = made.report["units"]
    assert units["planned"] == units["recorded"] == len(made.table) == 120
    assert units["completed"] + units["void"] + units["errors"] == 120
    aside = made.report["set_aside"]
    void = made.table[made.table["outcome"] == "void"]
    assert units["void"] == len(void) > 0 and len(aside["void"]) == void["index"].nunique()
    assert len(aside["errors"]) == units["errors"] > 0
    assert sum(aside["void_reasons"].values()) == aside["void_lead_ins"] == len(aside["void"])


def test_every_recovery_of_table_3_is_a_success_or_a_failure(made):
    rows = made.report["tables"]["table_3"]
    assert [row["family"] for row in rows] == ["low_texture", "motion_blur", "fast_rotation", "all"]
    for row in rows:
        assert row["needs_recovery"] == row["failure"] + row["success"]
        assert row["success"] == sum(row["with_thread"])
    assert rows[-1]["failure"] == done(made)["s2"].fillna(False).sum()
    assert rows[-1]["trials"] == len(done(made))
    second = made.report["tables"]["table_2"][-1]
    assert second["reduction_of_breakage"] == 1 - rows[-1]["failure"] / rows[-1]["needs_recovery"]


def test_recovery_time_counts_only_threads_that_the_system_would_run(made):
    rows = done(made)[done(made)["reinit"].fillna(False)]
    second = rows["free_r2_cpu_ms"].where(~rows["free_r1_declared"], 0)
    mean_s = float((rows["free_r1_cpu_ms"] + second).mean()) / 1e3
    assert made.report["tables"]["table_3"][-1]["mean_recovery_cpu_s"] == pytest.approx(mean_s)


def test_every_failed_unit_is_listed_with_its_command(made):
    false = [f"{arm}_r{j}_false" for arm in ("free", "cross") for j in (1, 2)]
    failed = done(made)[["d1", "silent_failure", *false]].fillna(False).any(axis=1)
    listed = {unit["unit_id"]: unit for unit in made.report["failures"]}
    assert list(listed) == list(done(made)[failed]["unit_id"])
    for unit_id, unit in listed.items():
        # The folder's name holds blanks and an apostrophe.
        assert unit["command"].startswith("dslab experiment replay '/")
        assert unit["command"].endswith(f" {unit_id} --rerun {unit_id}.rrd")
        assert unit_id in made.html
    what = " ".join(w for unit in listed.values() for w in unit["what"])
    assert "dual failure (n = 1, 2)" in what and "silent failure" in what and "false recovery" in what


def test_the_page_begins_with_the_answer(made):
    text, answered = made.page.text, made.report["answer"]
    first = text[: text.index("Words used on this page")]
    assert first.index(answered["headline"]) < first.index("Asked")
    assert made.html.index('id="answer"') < made.html.index("<nav")
    assert " ".join(answered["sentences"]) in first
    for row in answered["rows"]:
        assert percent(row["eq1"]) in first and percent(row["measured"]["value"]) in first


def test_every_condition_stands_with_its_dose_and_unit(made):
    table = made.html[made.html.index('id="t-cells"') :]
    table = table[: table.index("</table>")].replace("\N{NO-BREAK SPACE}", " ")
    for name in ("low texture, contrast 0.3", "motion blur, exposure 1 s", "fast rotation, rate 1 °/s"):
        assert f". {name} <small>" in table
    for cell in made.report["analysis"]["cells"]:
        assert percent(cell["shares"]["dual_failure"]["value"]) in table


def test_what_the_design_does_not_allow_is_said_in_a_line(made):
    for line in (
        "no sequence was repeated",
        "do not say M",
        "no thread is of Algorithm 1",
        "rate of false alarms",
    ):
        assert line in made.page.text


def test_a_card_of_a_narrow_page_names_each_of_its_cells(made):
    heads = re.compile(r"<thead>.*?</thead>", re.DOTALL)
    for table in re.findall(r"<table>.*?</table>", made.html, re.DOTALL):
        names = re.findall(r'<th scope="col">(.*?)</th>', heads.search(table)[0])
        for row in re.findall(r"<tr.*?</tr>", heads.sub("", table), re.DOTALL):
            assert re.findall(r'data-label="(.*?)"', row) == names


def test_the_page_stands_alone(made):
    assert not re.search(r"https?:|<script|@import|url\(", made.html)
    ids = [attrs["id"] for _, attrs in made.page.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    for tag, attrs in made.page.elements:
        for name in ("href", "src"):
            target = attrs.get(name)
            if target is None or target.startswith("data:"):
                continue
            if target.startswith("#"):
                assert target[1:] in ids
            else:
                assert (made.folder / target).is_file(), f"<{tag}> leads to {target}"
        if "aria-labelledby" in attrs:
            assert attrs["aria-labelledby"] in ids


def test_the_page_is_accessible(made):
    tags = [tag for tag, _ in made.page.elements]
    assert tags.count("h1") == 1 and tags.count("main") == 1
    levels = [int(tag[1]) for tag in tags if re.fullmatch(r"h[1-6]", tag)]
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert tags.count("caption") == tags.count("table") > 10
    assert all(attrs.get("alt") for tag, attrs in made.page.elements if tag == "img")
    assert all("scope" in attrs for tag, attrs in made.page.elements if tag == "th")
    assert ("html", {"lang": "en"}) in made.page.elements


def test_every_plot_is_written_as_png_and_svg(made):
    names = {*(f"chain_{kind}" for kind in KINDS), "doses", "formulas", "timeline", "end_errors"}
    files = {path.name for path in (made.folder / "plots").iterdir()}
    assert files == {f"{name}.{form}" for name in names for form in ("png", "svg")}
    assert sum(tag == "img" for tag, _ in made.page.elements) == len(names)
    assert sorted(path.name for path in made.folder.iterdir()) == ["plots", "report.html", "report.json"]


def test_the_same_figures_give_the_same_files(made):
    with settings():
        first, second = (rendered("doses", "", draw_doses(made.report, 4.0)) for _ in range(2))
    assert first == second and first.wide == first.narrow and first.wide.width_px == 384
    assert first.png.startswith(b"\x89PNG") and b"</svg>" in first.wide.svg


@pytest.mark.slow
def test_no_legend_lies_over_data_and_no_plot_is_wider_than_its_page(made, monkeypatch, tmp_path):
    figures = []
    monkeypatch.setattr(draw, "rendered", lambda name, alt, *drawn: figures.append(drawn))
    draw.draw_plots(made.report, tmp_path)
    for figure, most_px in (each for drawn in figures for each in zip(drawn, (1110, 350), strict=True)):
        assert figure.get_figwidth() <= most_px / 96
        assert not [axes for axes in figure.axes if axes.get_legend() is not None]


def test_an_experiment_without_a_unit_has_a_report(tmp_path):
    spec = FakeSpec(doses=1)
    report = report_content(spec, fake_table(spec, units=0), tmp_path, FEW)
    text = Page(write_files(report, tmp_path).read_text()).text
    assert "120 of 120 planned trials are missing" in text
    assert report["analysis"]["cells"] == []
    assert report["failures"] == []


def test_without_the_free_arm_nothing_is_said_of_breakages_only_of_threads(tmp_path):
    spec = FakeSpec(doses=1, arms=("crossing",))
    of_free = ("breakage", "base_", "dual_", "free_", "reinit", "silent", "relocalized")
    table = unknown(fake_table(spec), *of_free, "d1", "d2", "s1", "s2")
    report = report_content(spec, table, tmp_path, FEW)
    analysis = report["analysis"]
    of_eq1 = ("levels", "kinds_of_world", "cells", "formulas", "sham", "rescuable", "delays")
    assert not any(analysis[part] for part in of_eq1) and analysis["failed_or_silent"] is None
    assert len(analysis["thread_shares"]) == 6 and analysis["units"] > 100
    assert {name for dose in analysis["doses"] for name in dose["shares"]} == {"thread_1", "thread_2"}
    rows = table[table["outcome"] == "completed"]
    none_crosses = rows[rows["cross_r1_failed"].fillna(False) & rows["cross_r2_failed"].fillna(False)]
    told = [unit for unit in report["failures"] if "no thread crosses" in unit["what"]]
    assert len(told) == len(none_crosses) > 3 and all(len(unit["threads"]) == 2 for unit in told)
    html = report_html(report, {"doses": PLOT})
    named = re.findall(r'<h2 id="(\w+)"', html)
    assert named == ["answer", "threads", "doses", "trials", "failures", "aside", "provenance"]
    assert re.findall(r'<li><a href="#(\w+)"', html) == named and "is Pr(failure)" not in html
    assert "Declared reasons of breakages" not in html and "<td>free</td>" not in html
    with settings():
        legend = draw_doses(report, NARROW_IN).legends[0].get_texts()
    assert [text.get_text() for text in legend] == ["ORB fails to cross", "SIFT fails to cross"]


@pytest.fixture(scope="module")
def odd(tmp_path_factory):
    """Report of one thread, two systems, two code states and no crossing arm."""
    spec = FakeSpec(doses=1, units=6, threads=(ThreadChoice(kind="orb"),), systems=("dual", "dual+"))
    table = pd.concat([fake_table(spec, units=3), fake_table(spec, units=3, code="0ld")], ignore_index=True)
    return report_content(spec, unknown(table, "cross_"), tmp_path_factory.mktemp("odd"), FEW)


def test_one_thread_two_systems_two_code_states_and_no_crossing_arm(odd):
    assert "dual+" in report_html(odd, {})
    systems = [(row["system"], row["family"]) for row in odd["tables"]["table_2"]]
    assert len(systems) == 8 and ("dual+", "all") in systems
    points = odd["analysis"]["doses"]
    assert points and all("thread_1" not in point["shares"] for point in points)
    assert any("2 states of the sources" in warning for warning in odd["warnings"])
    assert odd["sources"]["code"] == {"0ld": 18, "c0de": 18}


def test_a_design_with_all_parts_has_them_on_its_page(tmp_path):
    kinds = (ThreadChoice(kind="paper_orb"), ThreadChoice(kind="sift"))
    spec = FakeSpec(doses=1, threads=kinds, confirmatory=("low_texture/1",))
    table = fake_table(spec, hardness=1.5, per_world=3)
    number = table["index"].to_numpy(int)
    table["sequence"], table["repeat"] = 0 * number, number % 3
    table["rescuable"] = number % 2 == 0
    table["m2"] = table["s2"] | (number % 7 == 0)
    table.loc[number % 7 == 0, "mission_cause"] = "final_pose"
    report = report_content(spec, table, tmp_path, FEW)
    text = Page(report_html(report, {})).text
    for part in ("the paper's ORB, SIFT", "confirmatory", "telling sequences", "hopeless", "final pose"):
        assert part in text
    analysis = report["analysis"]
    assert analysis["directions"] and analysis["rescuable"] and analysis["chance"]["corridor"]["low"] >= 0
    assert all("run" in cell["steps"] for cell in analysis["cells"] if cell["steps"] and cell["n"] == 1)
    assert {(len(r["sequences"]), r["thread"]) for r in analysis["repeats"]} == {(4, 1), (4, 2)}
    pairs = [(pair["first"], pair["second"]) for pair in analysis["event_pairs"]]
    assert pairs == [(0, 1), (0, 2), (1, 2)] and "Which events come together" in text
    assert analysis["readings"][0]["of_sequences"] and {r["cell"] for r in analysis["readings"]} > {None}
    soon = [part["breakages"] for part in analysis["delays"]]
    assert f"{soon[0]} of {sum(soon)} breakages are declared up to 0.1 s" in text
    assert "named before the run" in text and "final_pose" in report["taxonomy"]["mission_causes"]


def test_text_from_specs_and_records_is_escaped(made):
    report = json.loads(json.dumps(made.report))
    report["experiment"]["name"] = "<i>x</i>"
    report["taxonomy"]["breakage_reasons"] = {"<b>few</b> & less": 3}
    html = report_html(report, {})
    assert "<i>" not in html and "<b>few" not in html
    assert "&lt;b&gt;few&lt;/b&gt; &amp; less" in html


@pytest.fixture
def folder(made, tmp_path, monkeypatch) -> Path:
    """A folder that `read_experiment` knows, with the figures of the made report and one plot."""
    read = "dslab.experiments.campaign.folder.read_experiment"
    monkeypatch.setattr(read, lambda where: (made.spec, made.table))
    monkeypatch.setattr(write, "report_content", lambda *about: json.loads(json.dumps(made.report)))
    monkeypatch.setattr(write, "draw_plots", lambda report, where: {"doses": PLOT})
    return tmp_path


def test_recordings_are_made_once_and_linked(made, folder, monkeypatch):
    recorded = []

    def record_unit(unit, path):
        recorded.append((unit.cell, unit.index))
        path.write_bytes(b"rrd")
        return "runs"

    monkeypatch.setattr("dslab.experiments.eq1.trial.record_unit", record_unit)
    monkeypatch.setattr(recordings, "paths_of", lambda runs: {"truth": np.zeros((4, 3))})
    steps = []
    page = write_report(folder, recordings=3, progress=lambda done, total: steps.append((done, total)))
    first = made.report["failures"][:3]
    assert recorded == [(unit["cell"], unit["index"]) for unit in first]
    assert steps == [(0, 3), (1, 3), (2, 3), (3, 3)]
    places = [f"recordings/{unit['unit_id']}.rrd" for unit in first]
    links = [attrs.get("href") for tag, attrs in Page(page.read_text()).elements if tag == "a"]
    assert [link for link in links if link.startswith("recordings/")] == places
    assert {f"recordings/{path.name}" for path in (folder / "recordings").iterdir()} == set(places)
    assert list(read_paths(folder)) == [unit["unit_id"] for unit in first]
    write_report(folder, recordings=2)
    assert len(recorded) == 3


def test_a_report_replaces_the_earlier_one_wholly(folder):
    (folder / "plots").mkdir()
    (folder / "plots" / "old.png").write_bytes(b"")
    assert write_report(folder) == folder / "report.html"
    assert not (folder / "plots" / "old.png").exists()
    assert sorted(path.name for path in folder.iterdir()) == ["plots", "report.html", "report.json"]


def test_a_full_disk_leaves_the_earlier_report(folder, monkeypatch):
    (folder / "report.html").write_text("earlier")

    def replace(source, target):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("dslab.sim.io.folders.os.replace", replace)
    with pytest.raises(InputError, match="the disk is full"):
        write_report(folder)
    assert (folder / "report.html").read_text() == "earlier"
    assert not [path.name for path in folder.iterdir() if ".partial" in path.name]


def test_paths_are_kept_and_shown(made, tmp_path):
    along = np.linspace(0, 20, 50)
    truth = np.column_stack([along, np.sin(along), np.ones(50)])
    add_paths(tmp_path, "b", {"truth": truth, "base": truth[:20]})
    add_paths(tmp_path, "a", {"truth": truth})
    add_paths(tmp_path, "b", {"truth": truth, "base": truth[:30]})
    paths = read_paths(tmp_path)
    lengths = {unit: {k: len(path) for k, path in own.items()} for unit, own in paths.items()}
    assert lengths == {"b": {"truth": 50, "base": 30}, "a": {"truth": 50}}
    figure = draw_paths(paths, {"b": "cell 0"}, WIDE_IN)
    assert figure is not None and figure.axes[0].get_title() == "cell 0"
    # Drawn in the plane of the two longest axes.
    assert np.array_equal(figure.axes[0].lines[0].get_xydata(), truth[:, :2])
    assert "paths from above" in report_html(made.report, {"paths": PLOT})
    assert read_paths(tmp_path / "elsewhere") == {}


def test_the_path_of_a_broken_run_ends_at_the_breakage():
    sequence = make_sequence()
    build = fake_factory(sequence, breaks_at=220)
    paths = paths_of([execute(sequence, kind, 0, build=build) for kind in ("base", "dual")])
    truth = sequence.T_world_cam[:, :3, 3]
    assert np.array_equal(paths["truth"], truth.astype(np.float32))
    known = {which: np.isfinite(paths[which]).all(axis=1) for which in ("base", "dual")}
    assert known["base"][219] and not known["base"][220:].any() and known["dual"][260:].all()
    for which, where in known.items():
        np.testing.assert_allclose(paths[which][where], truth[where], atol=1e-5)


def test_published_figures_stay_unless_a_report_says_something_else(tmp_path, monkeypatch):
    monkeypatch.setattr("dslab.experiments.report.write.draw_plots", lambda *_: {})
    monkeypatch.setattr("dslab.experiments.report.write.report_html", lambda *_: "")
    report = {"share": 0.1, "counts": [1, None], "sources": {"report_commit": "a"}, "versions": {}}
    write_files(report, tmp_path)
    before = (tmp_path / "report.json").read_bytes()
    rounded = {"share": 0.1 + 1e-16, "sources": {"report_commit": "b"}, "versions": {"numpy": "3"}}
    write_files(report | rounded, tmp_path)
    assert (tmp_path / "report.json").read_bytes() == before
    for other in ({"share": 0.1001}, {"counts": [1, 2]}, {"counts": [True, None]}, {"more": None}):
        write_files(report | other, tmp_path)
        assert json.loads((tmp_path / "report.json").read_text()) == report | other
