"""Pose error against baseline: from images to columns, slopes and the report page."""

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pandas as pd
import pytest
from html_page import Page
from report_fakes import FakeSpec, fake_table
from scipy.spatial.transform import Rotation
from unit_scenes import ONSET, run, synthetic, unit

from dslab.experiments.eq1.conditioning import PAIRS_PER_GAP, first_frames, judge_pairs, relative_pose
from dslab.experiments.eq1.record_table import normalise
from dslab.experiments.eq1.records import PAIR_COLUMNS, PAIR_GAPS, columns, decided, pair_column
from dslab.experiments.report.content import report_content
from dslab.experiments.report.page import report_html
from dslab.experiments.report.plots.conditioning import draw_conditioning
from dslab.experiments.report.plots.draw import rendered
from dslab.experiments.report.plots.style import settings
from dslab.experiments.statistics.conditioning import baseline_errors, lead_ins
from dslab.slam.toy_sequence import CAMERA

QUICK = 19
NAMES = [pair_column(gap, name) for gap in PAIR_GAPS for name in PAIR_COLUMNS]
WHOLE = synthetic()


def by_gap(record, name):
    return [record[pair_column(gap, name)] for gap in PAIR_GAPS]


# -- two views -----------------------------------------------------------------------------------------------


def two_views(baseline_m, noise_px=0.0, points=200, seed=0, way=(0.8, 0.0, 0.6)):
    """Pixels (N, 2) in two views of points 3 to 8 m away, and the true motion view 1 to view 2."""
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("yx", [1.5, -0.7], degrees=True).as_matrix()
    T[:3, 3] = baseline_m * np.array(way)
    z = rng.uniform(3, 8, points)
    xyz = np.column_stack([z * rng.uniform(-0.5, 0.5, points), z * rng.uniform(-0.4, 0.4, points), z])
    seen = []
    for p in (xyz, xyz @ T[:3, :3].T + T[:3, 3]):
        pixels = (p / p[:, 2:]) @ CAMERA.K.T
        seen.append((pixels[:, :2] + rng.normal(0, noise_px, (points, 2))).astype(np.float32))
    return *seen, T


@pytest.mark.parametrize("way", [(0.8, 0.0, 0.6), (-0.8, 0.0, -0.6), (0.0, 0.6, 0.8), (0.0, -0.6, -0.8)])
@pytest.mark.parametrize("baseline_m", [0.02, 0.5])
def test_the_pose_of_exact_matches_is_the_true_one_at_any_parallax(baseline_m, way):
    # At 0.02 m every point is more than 50 baselines away, which is too far for OpenCV's choice of the sign.
    xy_1, xy_2, T = two_views(baseline_m, way=way)
    # The first sample may explain all of a narrow pair to a pixel, and is then not refined.
    found = [relative_pose(xy_1, xy_2, CAMERA, seed) for seed in range(5)]
    assert np.median([np.abs(R - T[:3, :3]).max() for R, _ in found]) < 2e-4
    assert np.median([np.abs(t - way).max() for _, t in found]) < 2e-2


def test_the_pose_is_robust_to_wrong_matches():
    xy_1, xy_2, T = two_views(0.5, noise_px=0.3)
    xy_2[:60] = xy_2[59::-1]
    R, t = relative_pose(xy_1, xy_2, CAMERA, 0)
    assert np.rad2deg(Rotation.from_matrix(R.T @ T[:3, :3]).magnitude()) < 0.5
    assert t @ T[:3, 3] / 0.5 > np.cos(np.deg2rad(3))


def test_degenerate_matches_give_a_pose_or_none_but_no_exception():
    xy_1, xy_2, _ = two_views(0.5)
    line = np.column_stack([np.linspace(10, 300, 40), np.full(40, 100.0)]).astype(np.float32)
    same = np.full((40, 2), 50, np.float32)
    for a, b in ((xy_1, xy_1), (line, line + 1), (same, same), (xy_1[:8], xy_2[:8])):
        found = relative_pose(a, b, CAMERA, 0)
        assert found is None or (np.isfinite(found[0]).all() and np.isfinite(found[1]).all())
    assert relative_pose(xy_1[:7], xy_2[:7], CAMERA, 0) is None


# -- the arm -------------------------------------------------------------------------------------------------


def test_pairs_lie_in_the_lead_in_and_start_at_the_same_frames():
    found = first_frames(80)
    assert list(found) == list(PAIR_GAPS)
    assert all(starts == found[1] for starts in found.values())
    assert len(found[1]) == PAIRS_PER_GAP and (found[1][0], found[1][-1] + max(PAIR_GAPS)) == (0, 79)
    steps = [b - a for a, b in pairwise(found[1])]
    assert max(steps) - min(steps) <= 1
    short = first_frames(12)
    assert short[27] == [] and short[9] == [0, 1, 2]
    assert set(map(tuple, first_frames(1).values())) == {()}


def test_errors_are_measured_against_the_truth():
    row = judge_pairs(WHOLE, ONSET, 1)
    assert list(row) == NAMES and by_gap(row, "count") == [8] * 4
    truth = WHOLE.T_world_cam[:, :3, 3]
    for gap, starts in first_frames(ONSET).items():
        steps = [np.linalg.norm(truth[i + gap] - truth[i]) for i in starts]
        assert row[pair_column(gap, "baseline_m")] == pytest.approx(np.median(steps))
    assert row["pairs9_rotation_deg"] < 0.5 and row["pairs9_direction_deg"] < 3
    # Narrow baselines are worse: Fig. 2.
    assert row["pairs1_direction_deg"] > 2 * row["pairs9_direction_deg"]
    assert by_gap(row, "matches") == sorted(by_gap(row, "matches"), reverse=True)
    # A truth rotated by ten degrees gives an error of ten degrees.
    turned = WHOLE.T_world_cam.copy()
    turned[9:, :3, :3] = Rotation.from_euler("y", 10, degrees=True).as_matrix()
    lying = judge_pairs(replace(WHOLE, T_world_cam=turned), 10, 1)
    assert lying["pairs9_rotation_deg"] == pytest.approx(10, abs=0.5)


def test_frames_after_the_lead_in_are_not_used():
    assert judge_pairs(synthetic(range(ONSET, 170)), ONSET, 1) == judge_pairs(WHOLE, ONSET, 1)


def test_frames_without_texture_or_motion_have_no_pairs():
    still = replace(WHOLE, T_world_cam=np.broadcast_to(np.eye(4), (170, 4, 4)))
    unknown = replace(WHOLE, T_world_cam=np.full((170, 4, 4), np.nan))
    for sequence in (synthetic(range(170)), still, unknown, replace(WHOLE, T_world_cam=None)):
        row = judge_pairs(sequence, ONSET, 1)
        assert by_gap(row, "count") == [0] * 4
        assert {row[name] for name in NAMES if not name.endswith("count")} == {None}


@pytest.mark.slow
def test_the_arm_runs_on_request(monkeypatch):
    record = run(monkeypatch, WHOLE, unit("orb", arms=("pairs",)))
    assert list(record) == list(columns(1)) and by_gap(record, "count") == [8] * 4
    assert record == normalise(record, 1)


@pytest.mark.slow
def test_the_arm_changes_nothing_else(monkeypatch):
    with_pairs, without = (
        run(monkeypatch, WHOLE, unit("orb", arms=arms)) for arms in (("crossing", "pairs"), ("crossing",))
    )
    assert {without[name] for name in NAMES} == {None}
    own = {*NAMES, "unit_id"}
    assert {k: v for k, v in decided(with_pairs).items() if k not in own} == {
        k: v for k, v in decided(without).items() if k not in own
    }


def test_the_result_does_not_depend_on_the_global_random_stream():
    cv2.setRNGSeed(1)
    one = judge_pairs(WHOLE, ONSET, 1)
    cv2.setRNGSeed(2)
    assert judge_pairs(WHOLE, ONSET, 1) == one != judge_pairs(WHOLE, ONSET, 2)


# -- statistics ----------------------------------------------------------------------------------------------


def simulated(rng, slope, worlds=25, per_world=4, level=1.0, noise=0.4):
    """Lead-ins with errors as a power of the baseline; worlds differ in level, cameras in speed."""
    units = worlds * per_world
    table = fake_table(FakeSpec(doses=1, units=units), per_world=per_world)[:units]
    table["outcome"] = "completed"
    world = rng.normal(0, level, worlds)[np.arange(units) // per_world]
    # Fast cameras are in hard worlds: the slope is unbiased only within lead-ins.
    speed = np.exp(0.5 * world + rng.normal(0, 0.3, units))
    for gap in PAIR_GAPS:
        baseline_m = 0.05 * gap * speed
        of = rng.normal(0, noise, units) + rng.normal(0, noise, worlds)[np.arange(units) // per_world]
        for name, values in {
            "baseline_m": baseline_m,
            "direction_deg": np.exp(world + slope * np.log(baseline_m) + of),
            "rotation_deg": np.exp(world + of),
            "matches": np.full(units, 400.0 / gap),
        }.items():
            table[pair_column(gap, name)] = pd.array(values, dtype="Float64")
        table[pair_column(gap, "count")] = pd.array([8] * units, dtype="Int64")
    return table


@pytest.mark.slow
def test_a_known_slope_is_found_and_its_interval_covers_it():
    rng, covered, found = np.random.default_rng(3), [], []
    for _ in range(30):
        rows = simulated(rng, -0.7)
        errors = baseline_errors(rows, "direction_deg")
        found.append(errors.slope.value)
        covered.append(errors.slope.low <= -0.7 <= errors.slope.high)
    assert np.mean(found) == pytest.approx(-0.7, abs=0.05)
    assert np.mean(covered) >= 0.85 and np.ptp(found) > 0.05
    assert [(s.narrow, s.wide) for s in errors.steps] == [(1, 3), (3, 9), (9, 27)]
    assert all(s.slope.value == pytest.approx(-0.7, abs=0.3) for s in errors.steps)


def test_medians_are_those_of_the_lead_ins():
    rows = simulated(np.random.default_rng(4), -0.7)
    errors = baseline_errors(rows, "rotation_deg")
    assert (errors.lead_ins, errors.worlds) == (100, 25)
    for gap in errors.gaps:
        values = rows[pair_column(gap.gap, "rotation_deg")].astype(float)
        assert gap.error == np.median(values)
        assert (gap.lead_ins, gap.pairs, gap.matches) == (100, 800, 400.0 / gap.gap)


def test_a_lead_in_that_cells_share_counts_once_and_gaps_may_be_missing():
    def direction(table):
        return baseline_errors(lead_ins(table), "direction_deg")

    table = simulated(np.random.default_rng(6), -0.7)
    twice = pd.concat([table, table.assign(cell="other", unit_id="x" + table["unit_id"])], ignore_index=True)
    assert direction(twice) == direction(table)
    void = table.copy()
    void.loc[:49, "outcome"] = "void"
    assert len(lead_ins(void)) == 50
    narrow = table.copy()
    narrow[[name for name in NAMES if name.startswith("pairs27_")]] = pd.NA
    narrow.loc[0:9, [name for name in NAMES if not name.startswith("pairs1_")]] = pd.NA
    errors = direction(narrow)
    assert [g.lead_ins for g in errors.gaps] == [100, 90, 90]
    assert errors.slope.value == pytest.approx(-0.7, abs=0.15)
    errors = direction(table[:1])
    assert errors.slope.low == -np.inf and errors.slope.high == np.inf


# -- report --------------------------------------------------------------------------------------------------


def test_the_page_states_and_plots_the_slope(tmp_path):
    spec = FakeSpec(doses=1, units=100)
    table = simulated(np.random.default_rng(7), -0.7)
    report = report_content(spec, table, tmp_path, QUICK)
    with settings():
        plot = rendered("conditioning", "Errors.", draw_conditioning(report, 7.6))
    page = Page(report_html(report, {"conditioning": plot}))
    rotation, direction = report["conditioning"]["told"]
    assert "neither falls nor rises significantly" in rotation and "falls as the baseline grows" in direction
    assert direction in page.text and any(link.get("href") == "#conditioning" for link in page.all("a"))
    assert [image["alt"] for image in page.all("img")] == ["Errors."]
    slope = report["analysis"]["conditioning"][1]["slope"]
    assert f"{slope['value']:.3g} ({slope['low']:.3g} to {slope['high']:.3g})" in direction
    marks = report["conditioning"]["marks"]
    assert len(marks) == 400 and marks[0]["baseline_m"] == table["pairs1_baseline_m"].iloc[0]


def test_a_rise_at_the_wide_end_is_stated(tmp_path):
    table = simulated(np.random.default_rng(8), -0.7, noise=0.1)
    table["pairs27_direction_deg"] = table["pairs9_direction_deg"] * 2
    report = report_content(FakeSpec(doses=1), table, tmp_path, QUICK)
    told = report["conditioning"]["told"][1]
    assert "; from 9 to 27 frames apart it rises with the baseline." in told and "from 3 to 9" not in told


def test_without_the_arm_there_is_no_section(tmp_path):
    spec = FakeSpec(doses=1, units=6)
    report = report_content(spec, fake_table(spec), tmp_path, QUICK)
    assert report["conditioning"] is None and report["analysis"]["conditioning"] == []
    assert draw_conditioning(report, 7.6) is None
    assert "against baseline" not in Page(report_html(report, {})).text


def test_one_lead_in_has_a_plot_without_intervals(tmp_path):
    table = simulated(np.random.default_rng(9), -0.7)[:1]
    report = report_content(FakeSpec(doses=1), table, tmp_path, QUICK)
    assert "without an interval" in report["conditioning"]["told"][0]
    assert draw_conditioning(report, 7.6) is not None
