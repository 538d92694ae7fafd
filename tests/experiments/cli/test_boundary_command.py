"""``dslab experiment boundary``: answer, files, resumption; bad input is one line."""

import json

import pytest
from PIL import Image
from pool_fakes import open_local_pool
from unit_fakes import planted_unit

from dslab.experiments.campaign.boundary_schedule import BoundarySchedule
from dslab.experiments.campaign.folder import read_rows
from dslab.experiments.eq1.boundary_plan import boundary_plan
from dslab.experiments.eq1.doses import DoseAxis
from dslab.experiments.eq1.spec import load_spec
from dslab.experiments.report.boundary import answer_text, boundary_content
from dslab.experiments.statistics.boundary import Boundary

BLUR = ("experiment", "boundary", "motion_blur", "--of", "breakage", "--fail", "0.5", "--spec", "smoke")


@pytest.fixture
def search(dslab, monkeypatch, tmp_path):
    """A function that runs the command on simulated units, in the same folder each time."""

    monkeypatch.setattr("dslab.experiments.campaign.workers.open_pool", open_local_pool)
    monkeypatch.setattr("dslab.experiments.eq1.trial.run_unit", planted_unit)
    monkeypatch.setattr("dslab.sim.stress_check.stress_measure", lambda scenario: ("blur_px", 12.34))
    return lambda *arguments: dslab(*arguments, "--out", tmp_path / "b")


def test_a_search_prints_its_answer_and_writes_json_and_picture(search, tmp_path):
    code, out, err = search(*BLUR, "--trials", 40)
    found = json.loads((tmp_path / "b" / "boundary.json").read_text())
    assert code == 0 and err == ""
    lines = out.splitlines()
    assert lines[0] == found["answer"]
    assert lines[0].startswith("motion blur, corridor: breakage reaches 0.5 at exposure 0.")
    assert lines[2].startswith("world: corridor, lamp level 1, length uniform from 36 to 50 m, width 2.4 m")
    assert lines[3].startswith("motion: walk, max speed uniform from 0.8 to 1.1 m/s, ")
    assert lines[4].startswith("camera: 320 × 240 px, 15 frames/s, focal length 250 × 250 px, ")
    assert lines[5].startswith("blur at exposure 0.") and lines[5].endswith(
        " s: 12.3 px (nearest of the doses searched)"
    )
    assert lines[1].startswith("40 trials in as many worlds, ") and "without stress 0 of 8 fail" in lines[1]
    assert found["status"] == "reached" and found["low"] < found["dose"] < found["high"]
    assert found["dose"] == pytest.approx(0.1, rel=0.4) and found["field"] == "exposure_s"
    assert len(found["trials"]) == 40 and found["trials"][0]["dose"] is None
    assert found["curve"]["dose"][0] == pytest.approx(0.01) and len(found["curve"]["low"]) > 20
    with Image.open(tmp_path / "b" / "boundary.png") as picture:
        assert min(picture.size) > 300


@pytest.mark.slow
def test_the_same_command_goes_on_or_says_the_same_again(search, tmp_path):
    search(*BLUR, "--trials", 20)
    first = read_rows(tmp_path / "b")[1]
    code, out, _ = search(*BLUR, "--trials", 32, "--json")
    found = json.loads(out)
    assert code == 0 and len(found["trials"]) == 32
    files = [(tmp_path / "b" / name).read_bytes() for name in ("boundary.json", "boundary.png")]
    rows = read_rows(tmp_path / "b")[1]
    assert all(row in rows for row in first)
    assert json.loads(search(*BLUR, "--trials", 32, "--json")[1]) == found
    assert [(tmp_path / "b" / n).read_bytes() for n in ("boundary.json", "boundary.png")] == files


def test_the_boundary_of_another_system_is_searched_by_its_name(search, tmp_path):
    blur = ("experiment", "boundary", "motion_blur", "--fail", "0.5", "--spec", "smoke", "--trials", 12)
    code, out, err = search(*blur, "--of", "mission", "--system", "dso")
    assert code == 0 and out.startswith("motion blur, corridor: dso, mission failure ")
    assert {row["system"] for row in read_rows(tmp_path / "b")[1]} == {"dso"}
    for of, system, says in (("dual", "dso", "recovery threads"), ("breakage", "dsoo", "no system 'dsoo'")):
        code, _, err = search(*blur, "--of", of, "--system", system)
        assert code == 2 and says in err and err.count("\n") == 1


@pytest.mark.slow
def test_less_contrast_is_stronger(search, tmp_path):
    arguments = (
        "experiment",
        "boundary",
        "low_texture",
        "--of",
        "mission",
        "--fail",
        "0.5",
        "--spec",
        "smoke",
    )
    code, out, _ = search(*arguments, "--trials", 40, "--json")
    found = json.loads(out)
    assert code == 0 and found["stronger"] == "less" and found["column"] == "m2"
    assert found["low"] < found["dose"] < found["high"] and found["dose"] == pytest.approx(0.1, rel=0.4)
    assert found["curve"]["dose"][0] > found["curve"]["dose"][-1]
    assert found["curve"]["probability"][0] < 0.1 and found["curve"]["probability"][-1] > 0.9


@pytest.mark.parametrize(
    ("ends", "status", "said"),
    [
        (("0.01", "0.04"), "not_reached", "does not reach 0.5 up to exposure 0.04 s"),
        (("0.3", "0.9"), "exceeded", "exceeds 0.5 even at the weakest dose, exposure 0.3 s"),
    ],
)
@pytest.mark.slow
def test_a_boundary_outside_the_doses_is_said(search, ends, status, said):
    given = ("--weakest", ends[0], "--strongest", ends[1], "--trials", 40, "--json")
    found = json.loads(search(*BLUR, *given)[1])
    assert found["status"] == status and said in found["answer"] and found["dose"] is None


def test_the_folder_of_a_search_is_that_of_an_experiment(search, dslab, monkeypatch, tmp_path):
    search(*BLUR, "--trials", 20)
    code, out, _ = dslab("experiment", "replay", tmp_path / "b", read_rows(tmp_path / "b")[1][12]["unit_id"])
    assert code == 0 and "agrees with the ledger" in out
    assert dslab("experiment", "export", tmp_path / "b")[0] == 0
    code, out, _ = dslab("experiment", "status", tmp_path / "b")
    assert code == 0 and "20 of 20 trials of the search, finished, " in out and " / " not in out


@pytest.mark.slow
def test_doses_that_outcomes_have_chosen_have_no_report(search, dslab, tmp_path):
    search(*BLUR, "--trials", 12)
    code, _, err = dslab("experiment", "report", tmp_path / "b")
    assert (
        code == 2 and err.count("\n") == 1 and "is a boundary search, whose outcomes chose its doses" in err
    )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["blur", "--of", "breakage", "--fail", "0.5"], "error: blur: there is no such kind of stress; use "),
        (["jpeg", "--of", "breakage", "--fail", "1.5"], "error: --fail: 1.5 is no probability"),
        (["jpeg", "--of", "breakage", "--fail", "nan"], "error: --fail: nan is no probability"),
        (["jpeg", "--of", "breakage", "--fail", "0.5", "--dose", "fall_s"], "error: --dose: "),
        (
            ["jpeg", "--of", "breakage", "--fail", "0.5", "--strongest", "-1"],
            "error: --strongest: -1 has no log",
        ),
        (
            ["jpeg", "--of", "breakage", "--fail", "0.5", "--spec", "none"],
            "error: none: no such experiment; use ",
        ),
        (["jpeg", "--of", "breakage", "--fail", "0.5", "--world", "moon"], "error: --world: "),
    ],
)
def test_bad_input_is_one_line_and_leaves_no_folder(search, arguments, said, tmp_path):
    code, out, err = search("experiment", "boundary", *arguments)
    assert code == 2 and out == "" and err.startswith(said) and err.count("\n") == 1
    assert not (tmp_path / "b").exists()


def test_the_folder_of_another_search_or_of_other_files_is_refused_and_kept(search, tmp_path):
    search(*BLUR, "--trials", 12)
    before = (tmp_path / "b" / "boundary.json").read_bytes()
    code, _, err = search(*BLUR, "--trials", 12, "--strongest", "0.5")
    assert code == 2 and err.count("\n") == 1 and "holds rows of another spec (boundary-breakage-8-4" in err
    assert (tmp_path / "b" / "boundary.json").read_bytes() == before


def test_an_answer_without_bounds_says_so():
    plan = boundary_plan(load_spec("smoke"), "low_texture", "dual", 0.5, axis=DoseAxis("contrast", 1.0, 0.01))
    near = plan.axis.strength(0.02)
    text = answer_text(Boundary(0.5, near, plan.axis.strength(0.2), float("inf"), 0.2, 0.0), plan)
    assert text == "low texture, corridor: dual failure reaches 0.5 at contrast 0.02 [unbounded, 0.2]"
    text = answer_text(Boundary(0.5, float("inf"), near, float("inf"), 0.6, 0.0), plan)
    assert text.endswith("does not reach 0.5 at any dose up to contrast 0.01: its ceiling is lower")


def test_a_search_without_any_trial_yet_has_an_answer():
    plan = boundary_plan(load_spec("smoke"), "jpeg", "breakage", 0.5)
    found = boundary_content(BoundarySchedule(plan))
    assert found["trials"] == [] and found["sham"]["trials"] == 0 and 0 < found["sham"]["rate"] < 0.2
