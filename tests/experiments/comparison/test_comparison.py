"""Finished runs beside each other: known scores, intervals, a page, and what is no run."""

import json
import os
import shutil

import numpy as np
import pytest
from matplotlib.lines import Line2D
from slam_fakes import FakeSystem, make_sequence

from dslab.experiments.comparison.page import FIGURES_FILE, PAGE_FILE, compare_runs
from dslab.experiments.evaluation.audit_text import audit_text
from dslab.experiments.evaluation.metrics import PosePairs
from dslab.experiments.evaluation.robustness import robustness, share_within, step_errors
from dslab.experiments.report.plots.style import NARROW_IN, WIDE_IN, columns_that_fit
from dslab.experiments.result_folder import run_systems
from dslab.scenarios.errors import InputError

FRAMES = 60


def arc(n=101):
    """A half circle of 100 m."""
    T = np.tile(np.eye(4), (n, 1, 1))
    angle = np.linspace(0, np.pi, n)
    T[:, 0, 3], T[:, 2, 3] = 100 / np.pi * np.cos(angle), 100 / np.pi * np.sin(angle)
    return T


def placed(truth, frames, off_m=0.0):
    """Poses of frames, every other one off to either side so that no alignment takes it out."""
    T = truth[frames].copy()
    T[:, 1, 3] += off_m * np.where(np.arange(len(frames)) % 4 < 2, 1, -1)
    return PosePairs(np.asarray(frames), T, truth[frames])


@pytest.mark.parametrize(("off_m", "score"), [(0.0, 1.0), (0.1, 1.0), (1.0, 0.5), (10.0, 0.0)])
def test_robustness_is_uniform_in_the_logarithm_of_the_error(off_m, score):
    """Over a path of 100 m: .1 m is the least threshold, 10 m the largest, 1 m half way."""
    truth = arc()
    assert robustness(placed(truth, range(101), off_m), truth) == pytest.approx(score, abs=0.02)


def test_shares_of_a_path_add_to_1_at_most():
    shares = np.full(45, 1 / 45)
    assert shares.sum() > 1 and share_within(shares, np.zeros(45), np.ones(1)).tolist() == [1.0]


def test_getting_lost_early_is_not_rewarded():
    truth = arc()
    early, all_along = placed(truth, range(11), 0.1), placed(truth, range(101), 0.5)
    assert robustness(early, truth) == pytest.approx(0.1, abs=0.01)
    assert robustness(all_along, truth) > 0.6
    assert robustness(placed(truth, []), truth) == 0.0 and robustness(placed(truth, [0]), truth[:1]) is None


def test_the_score_is_the_area_under_the_shares_within_thresholds():
    truth, rng = arc(), np.random.default_rng(0)
    pairs = placed(truth, range(20, 90))
    pairs.T_map_cam[:, :3, 3] += rng.normal(0, 0.8, (70, 3))
    thresholds = np.geomspace(0.001, 0.1, 20001)
    area = share_within(*step_errors(pairs, truth), thresholds).mean()
    assert robustness(pairs, truth) == pytest.approx(area, abs=1e-3)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two runs of a fake that says the truth, one of a fake that is lost half way."""
    folder, sequence = tmp_path_factory.mktemp("runs"), make_sequence(FRAMES, segment=None)
    for name, kind, breaks_at in (("a", "base", None), ("b", "base", None), ("c", "dual", FRAMES // 2)):
        place = folder / name
        place.mkdir()
        fake = FakeSystem(sequence.T_world_cam, kind, starts_at=0, breaks_at=breaks_at, recovers=False)
        run_systems(sequence, [kind], 0, place, build=lambda *_, fake=fake: fake)
    return folder


def test_runs_stand_side_by_side(runs, tmp_path):
    content = compare_runs([runs], tmp_path / "page")
    (sequence,) = content["sequences"]
    base, dual = sequence["systems"]
    assert (base["name"], base["runs"], dual["runs"]) == ("base", 2, 1)
    score, lost = base["figures"]["robustness"], dual["figures"]["robustness"]
    assert score["mean"] == pytest.approx(1, abs=1e-6)
    assert (score["low"], score["reason"], lost["low"], lost["reason"]) == (
        None,
        "all alike",
        None,
        "one run",
    )
    assert 0.3 < lost["mean"] < 0.6
    assert json.loads((tmp_path / "page" / FIGURES_FILE).read_text()) == content
    text = (tmp_path / "page" / PAGE_FILE).read_text()
    assert text.count("<figure>") == 4 and "<script" not in text and sequence["name"] in text


def test_any_name_stands_on_the_page(runs, tmp_path):
    shutil.copytree(runs / "a", tmp_path / "a")
    named = json.loads((runs / "a" / "summary.json").read_text())
    named |= {"sequence": os.fsdecode(b"\xff"), "system": "$a^{$"}
    (tmp_path / "a" / "summary.json").write_text(json.dumps(named))
    compare_runs([tmp_path / "a"], tmp_path / "page")
    text = (tmp_path / "page" / PAGE_FILE).read_text()
    assert r"\udcff" in text and "$a^{$" in text


def test_what_the_audit_found_is_said_as_after_the_run(runs, tmp_path, dslab):
    own = audit_text(json.loads((runs / "c" / "summary.json").read_text()))
    code, out, _ = dslab("compare", str(runs), "--out", str(tmp_path / "page"))
    page = (tmp_path / "page" / PAGE_FILE).read_text()
    assert code == 0 and "1 declared loss" in own
    assert f"dual: {own}" in page and " ".join(f"made-up, dual: {own}".split()) in " ".join(out.split())
    of_two = "base: audit by the truth, of 2 runs: silent losses in none, corrupted maps in none"
    assert of_two in page and of_two in " ".join(out.split())


def test_systems_of_which_the_audit_says_the_same_share_a_line(runs, tmp_path, dslab):
    for name in ("one", "other"):
        shutil.copytree(runs / "a", tmp_path / "in" / name)
        summary = tmp_path / "in" / name / "summary.json"
        summary.write_text(json.dumps(json.loads(summary.read_text()) | {"system": name}))
    code, out, _ = dslab("compare", tmp_path / "in", "--out", tmp_path / "page")
    page = (tmp_path / "page" / PAGE_FILE).read_text()
    assert code == 0 and "<p>one, other: audit by" in page and "one, other: audit" in " ".join(out.split())


def test_the_command_prints_a_row_per_system(runs, tmp_path, dslab):
    code, out, _ = dslab("compare", str(runs), "--out", str(tmp_path / "page"))
    assert code == 0 and [word for word in out.split() if word in ("base", "dual")] == ["base", "dual"]
    assert max(map(len, out.splitlines()[:6])) <= 80


def test_what_is_no_run_is_one_line(runs, tmp_path, dslab):
    (tmp_path / "empty").mkdir()
    broken = tmp_path / "broken"
    broken.mkdir()
    shutil.copy(runs / "a" / "summary.json", broken)
    for folder, says in ((tmp_path / "empty", "holds no summary.json"), (broken, "holds no groundtruth.txt")):
        code, _, err = dslab("compare", str(folder), "--out", str(tmp_path / "page"))
        assert code == 2 and says in err and err.count("\n") == 1
    with pytest.raises(InputError, match="empty"):
        compare_runs([runs], runs)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("frames", None),
        ("sequence", ["a"]),
        ("ate_m", "0.1"),
        ("ate_m", -1.0),
        ("path_share", 7.0),
        ("breakages", 1.5),
        ("stages", []),
        ("stages", {"a\nb": {"frames": 3, "cpu_ms_median": 1e308}}),
        ("audit", {}),
        ("breakage_list", [{"frame": 3}]),
        ("segments", [{"kind": "fog", "start_s": 0.0, "end_s": 1.0, "severity": {"density": 1e300}}]),
        ("input", {"images": 3}),
    ],
)
def test_a_summary_that_was_damaged_is_one_line(runs, tmp_path, dslab, field, value):
    shutil.copytree(runs / "c", tmp_path / "c")
    path = tmp_path / "c" / "summary.json"
    summary = json.loads(path.read_text())
    path.write_text(json.dumps({name: v for name, v in (summary | {field: value}).items() if v is not None}))
    code, _, err = dslab("compare", str(tmp_path / "c"), "--out", str(tmp_path / "page"))
    assert (
        code == 2 and err.count("\n") == 1 and f"{path}: {field}" in err and not (tmp_path / "page").exists()
    )


@pytest.mark.parametrize(("names", "columns"), [("abcde", 5), (["a long name of a system"] * 5, 3)])
def test_a_legend_fills_its_rows_evenly(names, columns):
    handles = [Line2D([], [], label=name) for name in names]
    assert columns_that_fit(handles, WIDE_IN) == columns
    assert columns_that_fit(handles[:1], NARROW_IN) == 1
