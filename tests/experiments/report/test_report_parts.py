"""Parts of a report: text, plots, profiles of trials."""

import pytest
from report_fakes import FakeSpec, fake_table
from test_documented_results import FOLDER

from experiments.eq1.former_spec import load_any_spec
from experiments.report.conditions import conditions
from experiments.report.describe import counts, figure_of, number, p_value, percent, proportion, share_of
from experiments.report.outcomes import taxonomy, unit_counts
from experiments.report.plots.calibration import draw_calibration
from experiments.report.plots.dose_response import draw_dose_response
from experiments.report.plots.style import NARROW_IN, WIDE_IN
from experiments.report.plots.trials import base_parts, dual_parts
from experiments.report.verdict import verdict

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


def test_figures_are_given_with_their_intervals():
    share = {"events": 3, "units": 40, "estimate": 0.075, "low": 0.016, "high": 0.204}
    assert proportion(share) == "3 of 40: 7.5 % (1.6 to 20.4 %)"
    assert proportion(share | {"events": 0, "units": 0, "estimate": None}) == "0 of 0"
    assert figure_of({"value": 4.1234, "low": 2.0, "high": None}) == "4.12 (2 to ?)"
    assert share_of({"value": None, "low": None, "high": None}) == "–"
    assert [p_value(p) for p in (None, 1e-9, 0.0123, 0.5)] == ["–", "< 0.001", "0.012", "0.50"]
    assert [number(x) for x in (None, 7.0, 12345.678, 0.00001)] == ["–", "7", "1.23e4", "1e-5"]
    # A name may end in a number's place: "too few matches with last frame" is not of frame 119.
    assert counts({"matches_with_last_frame": 119, "audit": 1}) == "119 × matches with last frame; 1 × audit"


def level(n: int, word: str, power: float | None) -> dict:
    return {"n": n, "verdict": word, "power_ratio_2": power, "tost_p": None}


def analysis(words: list[str], measured: tuple[float, float], within: tuple[float, float]) -> dict:
    """One cell per verdict, n = 1."""
    share = {"events": 5, "units": 100, "estimate": 0.05, "low": measured[0], "high": measured[1]}
    predicted = {"value": 0.02, "low": within[0], "high": within[1]}
    return {
        "threads": 1,
        "cells": [
            {
                "cell": f"c{place}",
                "levels": [level(1, word, 0.3 if word == "undecided" else 0.9)],
                "threads": [],
            }
            for place, word in enumerate(words)
        ],
        "heterogeneity": {
            "eckhardt_lee": [{"n": 1, "measured": share, "within": predicted, "pooled": predicted}],
            "gee": {},
        },
        "settings": {"power_ratio": 2.0, "power_wanted": 0.8, "equivalence_ratio": 2.0, "alpha": 0.05},
    }


@pytest.mark.parametrize(
    ("words", "headline"),
    [
        (["undecided"] * 3, "Undecided: no condition has enough trials"),
        (
            ["consistent", "undecided"],
            "not rejected in 1 of 2 verdicts with enough power. 1 of 2 verdicts are undecided",
        ),
        (["optimistic", "consistent"], "rejected in 1 of 2 verdicts: more failures"),
        (["pessimistic", "pessimistic"], "rejected in 2 of 2 verdicts: fewer failures"),
        (["pessimistic", "optimistic", "undecided"], "off in both directions"),
    ],
)
def test_the_headline_follows_the_verdicts(words, headline):
    text = verdict(analysis(words, (0.01, 0.1), (0.01, 0.05)))
    assert headline in text["tests_headline"]
    assert text["levels"][0]["counts"]["undecided"] == words.count("undecided")
    assert text["levels"][0]["powered"] == len(words) - words.count("undecided")


def test_a_profile_separates_recovered_from_lost_frames():
    assert base_parts(PROFILE, 300) == [(0, 120, "tracked"), (120, 300, "lost for good")]
    assert base_parts(PROFILE | {"relocalized": True}, 300)[1][2] == "relocalized later"
    assert base_parts(PROFILE | {"breakage": False}, 300) == [(0, 300, "tracked")]
    assert dual_parts(PROFILE, 300)[1:] == [(120, 160, "bridged by recovery"), (160, 300, "tracked")]
    failed = dual_parts(PROFILE | {"dual_failure": True}, 300)
    assert [part for *_, part in failed] == ["tracked", "lost for good", "a new map, not joined"]
    never = dual_parts(PROFILE | {"dual_failure": True, "reinit_frame": None}, 300)
    assert never[1] == (120, 300, "lost for good")


def mark(predicted: float, measured: float, word: str = "consistent") -> dict:
    return {
        "number": 1,
        "cell": "c",
        "n": 1,
        "verdict": word,
        "predicted": {"value": predicted, "low": predicted / 2, "high": predicted * 2},
        "measured": {
            "events": 1,
            "units": 9,
            "estimate": measured,
            "low": measured / 3,
            "high": measured * 3,
        },
    }


def test_points_of_the_calibration_lie_at_their_shares():
    figure = draw_calibration({"calibration": [mark(0.01, 0.2), mark(0.05, 0.0)]}, WIDE_IN)
    assert figure is not None
    axes = figure.axes[0]
    centres = [tuple(container[0].get_xydata()[0]) for container in axes.containers]
    assert centres == [(0.01, 0.2), (0.05, 0.0)]
    assert axes.get_xlim()[0] == axes.get_ylim()[0] == 0
    assert draw_calibration({"calibration": []}, WIDE_IN) is None


def fit(quantity: str) -> dict:
    points = [
        {"severity": x, "proportion": {"estimate": 0.5, "low": 0.1, "high": 0.9}} for x in (1.7, 2.7, 4.3)
    ]
    curve = [(1.7, 0.2, 0.1, 0.4), (4.3, 0.8, 0.6, 0.9)]
    return {"kind": "low_texture", "quantity": quantity, "points": points, "curve": curve}


@pytest.mark.parametrize("width_in", [WIDE_IN, NARROW_IN])
def test_doses_stand_on_the_axis_and_no_curve_lies_on_another(width_in):
    spec = load_any_spec(FOLDER / "spec.yaml")
    threads = [thread.model_dump() for thread in spec.threads]
    fits = [fit("p0"), fit("pr1"), fit("pr2"), fit("p0") | {"kind": "motion_blur"}]
    report = {
        "analysis": {"dose_response": fits},
        "conditions": conditions(spec),
        "experiment": {"threads": threads},
    }
    figure = draw_dose_response(report, width_in)
    assert figure is not None and len(figure.axes) == 4
    assert figure.get_figwidth() <= width_in
    for axes in figure.axes:
        texture = "low texture" in axes.get_title("left")
        assert axes.get_xlabel() == ("contrast" if texture else "exposure (s)")
        doses = ["0.3", "0.15", "0.05"] if texture else ["0.06", "0.1", "0.2"]
        assert [label.get_text() for label in axes.get_xticklabels()] == doses
        assert len(axes.containers) == 3 and len(axes.collections) == 4  # points; their bars and one band


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
