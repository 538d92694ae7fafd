"""Parts of a report: text, plots, profiles of trials."""

import pandas as pd
import pytest
from report_fakes import KINDS, FakeSpec, fake_table

from dslab.experiments.report.describe import (
    counts,
    ends,
    interval_of_share,
    number,
    p_value,
    percent,
    proportion,
    ratio,
)
from dslab.experiments.report.outcomes import set_aside, taxonomy, unit_counts
from dslab.experiments.report.plots.chain import draw_chain
from dslab.experiments.report.plots.doses import draw_doses
from dslab.experiments.report.plots.repeats import draw_repeats
from dslab.experiments.report.plots.style import NARROW_IN, WIDE_IN
from dslab.experiments.report.plots.trials import base_parts, dual_parts
from dslab.experiments.report.reproductions import end_errors, table_1, tables_2_and_3

PROFILE = {
    "breakage": True,
    "breakage_frame": 120,
    "reinit_frame": 160,
    "relocalized": False,
    "dual_failure": False,
}


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "–"),
        (0.0, "0.0 %"),
        (1.0, "100.0 %"),
        (0.0312, "3.1 %"),
        (0.0034567, "0.35 %"),
        (2e-5, "0.002 %"),
    ],
)
def test_small_shares_keep_their_digits(value, words):
    assert percent(value) == words


def test_figures_are_given_with_their_intervals_and_open_ends_are_said():
    share = {"events": 3, "units": 40, "estimate": 0.075}
    assert proportion(share) == "3 of 40: 7.5 %"
    assert proportion({"events": 0, "units": 0, "estimate": None}) == "0 of 0"
    assert interval_of_share({"value": 0.241, "low": 0.134, "high": 0.343}) == "24.1 % [13.4, 34.3]"
    assert ends({"low": 2.0, "high": None}) == "2 to unbounded"
    assert [ratio(x) for x in (None, 0.0, 4.1234, 22.0)] == ["unbounded", "0.00", "4.12", "22"]
    assert [p_value(p) for p in (None, 1e-9, 0.0123, 0.5)] == ["–", "< 0.001", "0.012", "0.50"]
    assert [number(x) for x in (None, 7.0, 12345.678, 0.00001)] == ["–", "7", "1.23e4", "1e-5"]
    # A name may end in a number's place: "too few matches with last frame" is not of frame 119.
    assert counts({"matches_with_last_frame": 119, "audit": 1}) == "119 × matches with last frame; 1 × audit"


def test_a_profile_separates_recovered_from_lost_frames():
    assert base_parts(PROFILE, 300) == [(0, 120, "tracked"), (120, 300, "lost for good")]
    assert base_parts(PROFILE | {"relocalized": True}, 300)[1][2] == "relocalized later"
    assert base_parts(PROFILE | {"breakage": False}, 300) == [(0, 300, "tracked")]
    assert dual_parts(PROFILE, 300)[1:] == [(120, 160, "bridged by recovery"), (160, 300, "tracked")]
    failed = dual_parts(PROFILE | {"dual_failure": True}, 300)
    assert [part for *_, part in failed] == ["tracked", "lost for good", "a new map, not joined"]
    never = dual_parts(PROFILE | {"dual_failure": True, "reinit_frame": None}, 300)
    assert never[1] == (120, 300, "lost for good")


def judged(n: int, **steps: tuple) -> dict:
    """A judged cell with some steps of the chain."""
    ratios = {name: dict(zip(("value", "low", "high"), step, strict=True)) for name, step in steps.items()}
    return {
        "cell": "c", "world": "room", "kind": "blur", "n": n, "steps": ratios, "confirmatory": False,
        "verdict_in_units": "untested", "verdict_forecast": "saturated",
    }  # fmt: skip


@pytest.mark.parametrize("width_in", [WIDE_IN, NARROW_IN])
def test_the_chain_has_a_panel_per_condition_and_arrows_for_open_ends(width_in):
    cells = [
        judged(1, world=(1.2, 0.9, 1.5), whole=(2.0, 1.0, None)),
        judged(2, arms=(0.0, 0.0, 1.0)),
        judged(2),
    ]
    condition = {"cell": "c", "number": 4, "dose": "exposure 1 s", "value": 1.0}
    figure = draw_chain({"analysis": {"cells": cells}, "conditions": [condition]}, "blur", width_in)
    assert figure is not None and figure.get_figwidth() == width_in and len(figure.axes) == 2
    one, two = figure.axes
    assert one.get_title("left") == "4. room, exposure 1 s, n = 1\nQ: untested, D: saturated"
    assert [label.get_text() for label in one.get_yticklabels()] == ["world", "arms", "D / Eq. 1"]
    marks = {(line.get_marker(), line.get_ydata()[0]) for line in one.lines if line.get_marker() in "o<>"}
    assert marks == {("o", 0), ("o", 2), (">", 2)}
    # A ratio of 0 has no place on the axis.
    assert [line.get_marker() for line in two.lines if line.get_marker() in "o<>"] == ["<"]
    assert draw_chain({"analysis": {"cells": [judged(2)]}, "conditions": []}, "blur", width_in) is None


@pytest.mark.parametrize("width_in", [WIDE_IN, NARROW_IN])
def test_sequences_stand_by_the_runs_that_break_to_the_right_and_fail_upwards(width_in):
    grids = [
        {"cell": "c", "world": "room", "thread": j, "sequences": [[7, 0], [5 * (j == 1), 1]]} for j in (1, 2)
    ]
    report = {
        "analysis": {"repeats": grids},
        "conditions": [{"cell": "c", "number": 4, "name": "room, blur"}],
        "experiment": {"threads": [{"kind": "orb"}, {"kind": "sift"}]},
    }
    orb, sift = draw_repeats(report, width_in).axes
    assert orb.get_title(loc="left") == "4. room, blur" and sift.get_ylabel() == "SIFT fails"
    assert {text.get_text(): text.get_position() for text in orb.texts} == {
        "7": (0, 0),
        "5": (1, 0),
        "1": (1, 1),
    }
    assert [text.get_text() for text in sift.texts] == ["7", "1"], "no number where there are none"
    assert draw_repeats(report | {"analysis": {"repeats": []}}, width_in) is None


def test_doses_stand_on_the_axis_in_their_unit_with_the_sham_as_none():
    share = {"value": 0.5, "low": 0.1, "high": 0.9}
    points = [
        {
            "kind": "blur",
            "world": "room",
            "setting": "",
            "cell": cell,
            "shares": {"breakage": share, "dual_1": share},
        }
        for cell in ("sham", "a", "b")
    ]
    named = [
        {"cell": cell, "value": value, "field": "exposure_s" if value else "", "axis": "exposure (s)"}
        for cell, value in (("sham", 0.0), ("a", 0.06), ("b", 0.2))
    ]
    threads = {"threads": [{"kind": "orb"}]}
    report = {"analysis": {"doses": points}, "conditions": named, "experiment": threads}
    figure = draw_doses(report, WIDE_IN)
    assert figure is not None
    (axes,) = figure.axes
    assert [label.get_text() for label in axes.get_xticklabels()] == ["none", "0.06", "0.2"]
    assert axes.get_xlabel() == "exposure (s)" and len(axes.containers) == 6


def test_a_void_lead_in_counts_once_though_it_voids_its_unit_in_every_cell():
    spec = FakeSpec(doses=3, units=10)
    table = fake_table(spec)
    table["outcome"] = "completed"
    table.loc[table["index"] == 4, ["outcome", "void_reason"]] = ["void", "no map"]
    found = set_aside(table, dict.fromkeys(spec.cell_names(), "dual"))
    assert (table["outcome"] == "void").sum() == 9
    assert (found["void_lead_ins"], found["void_reasons"], len(found["void"])) == (1, {"no map": 1}, 1)


def test_table_1_is_over_keyframes_and_tables_2_and_3_without_the_sham():
    spec = FakeSpec(doses=1, units=6)
    table = fake_table(spec)
    table["outcome"], table["dual_failure"] = "completed", table["d2"]
    assert [row["base"]["median_ate_m"] for row in table_1(table)] == [0.5] * 3
    both = pd.concat([table, table[:6].assign(cell="sham", kind="sham", breakage=True)])
    cells = [*spec.cell_names(), "sham"]
    of = {cell: cell.split("/")[0] for cell in cells}, dict.fromkeys(cells, "dual")
    found = tables_2_and_3(both, 2, *of)
    assert [row["family"] for row in found["table_3"]] == [*KINDS, "all"]
    assert found["table_2"][-1]["breakage"]["units"] == table["breakage"].notna().sum()


def test_errors_of_the_last_pose_stand_by_cell_in_the_order_of_the_table_and_then_by_unit():
    spec = FakeSpec(doses=1, units=6)
    table = fake_table(spec)[1:].assign(outcome="completed", dual_failure=False)
    found = end_errors(pd.concat([table[4:5], table.drop(table.index[4])]))
    assert [row["cell"] for row in found] == spec.cell_names() and found[0]["index"] == [1, 2, 3, 4, 5]


def test_reasons_that_differ_in_figures_only_are_counted_together():
    table = fake_table(FakeSpec(doses=1))
    failed = table["cross_r1_failed"].fillna(False).astype(bool)
    table.loc[failed, "cross_r1_reason"] = [f"scale -0.{k}, seam {k}.5 m" for k in range(failed.sum())]
    reasons = next(r for r in taxonomy(table, 2)["threads"] if (r["arm"], r["thread"]) == ("crossing", 1))[
        "reasons"
    ]
    assert reasons == {"scale …, seam … m": failed.sum()}


def test_counts_per_cell_include_missing_units():
    spec = FakeSpec(doses=1, units=10)
    counted = unit_counts(fake_table(spec, units=8), dict.fromkeys(spec.cell_names(), 10))
    assert counted["missing"] == 6 and [row["missing"] for row in counted["per_cell"]] == [2, 2, 2]


def test_taxonomy_counts_every_failure_once():
    spec = FakeSpec(doses=3)
    table = fake_table(spec)
    found = taxonomy(table, 2)
    done = table[table["outcome"] == "completed"]
    assert sum(found["breakage_reasons"].values()) == done["breakage"].sum()
    for row in found["threads"]:
        arm = "free" if row["arm"] == "free" else "cross"
        assert row["failed"] == done[f"{arm}_r{row['thread']}_failed"].sum() == sum(row["stages"].values())
    delays = done["declaration_delay_s"].dropna()
    assert found["declaration_delay_s"]["median"] == pytest.approx(float(delays.median()))
    assert sum(row["declaration_delay_s"]["units"] for row in found["per_cell"]) == len(delays)
