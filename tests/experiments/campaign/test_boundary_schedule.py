"""Trials of a boundary search depend on plan and records alone; every one has a world of its own."""

import random
from contextlib import nullcontext
from functools import partial
from typing import Literal

import numpy as np
import pytest
from pool_fakes import LocalPool
from pydantic import Field
from unit_fakes import planted_unit, rows_of

from dslab.experiments.campaign.boundary_schedule import BoundarySchedule
from dslab.experiments.campaign.folder import open_ledger
from dslab.experiments.campaign.runner import run_experiment
from dslab.experiments.eq1.boundary_plan import boundary_plan
from dslab.experiments.eq1.doses import AXES, DoseAxis, dose_axis
from dslab.experiments.eq1.records import dual_column
from dslab.experiments.eq1.spec import load_spec
from dslab.scenarios.errors import InputError, MachineError
from dslab.scenarios.segments import SEGMENT_KINDS, SegmentBase

SPEC = load_spec("smoke")


def plan_of(kind="motion_blur", level=0.5, of="breakage", trials=40, **options):
    return boundary_plan(SPEC, kind, of, level, trials=trials, **options)


def run(plan, folder, **options):
    """Run a search with simulated units in this process and return its schedule."""
    order = partial(_order, plan)
    pool = partial(LocalPool, planted_unit)
    run_experiment(plan.spec, folder, lambda: nullcontext(pool()), order=order, **options)
    with open_ledger(folder, plan.spec, read_only=True) as ledger:
        return BoundarySchedule(plan, ledger.rows())


def _order(plan, _experiment, rows):
    return BoundarySchedule(plan, rows)


def in_order(plan, folder):
    return sorted(rows_of(folder, plan.spec), key=lambda row: row["index"])


def found(schedule, level=0.5):
    return schedule.grid.boundary(schedule.posterior(), level)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """Plan, rows and answer of a search that ran through."""
    plan, folder = plan_of(), tmp_path_factory.mktemp("search") / "x"
    schedule = run(plan, folder)
    return plan, in_order(plan, folder), found(schedule)


def test_every_trial_has_a_world_of_its_own_and_shams_come_first(uninterrupted):
    plan, rows, _ = uninterrupted
    assert [row["index"] for row in rows] == list(range(40))
    assert len({row["world_seed"] for row in rows}) == len({row["repeat_seed"] for row in rows}) == 40
    assert [row["kind"] for row in rows] == ["sham"] * 8 + ["motion_blur"] * 32
    assert {row["severity"] for row in rows[8:]} <= set(plan.axis.doses)
    assert len({row["severity"] for row in rows[8:]}) > 4


@pytest.mark.parametrize("kind", ["motion_blur", "low_texture"])
def test_the_planted_dose_is_found_where_more_is_stronger_and_where_less_is(kind, tmp_path):
    plan = plan_of(kind, trials=80)
    answer = found(run(plan, tmp_path / "x"))
    assert plan.axis.dose(answer.median) == pytest.approx(0.1, rel=0.35)
    low, high = sorted(map(plan.axis.dose, (answer.low, answer.high)))
    assert low < 0.1 < high < 4 * low


@pytest.mark.parametrize("ended", [3, 8, 9, 13, 27])
def test_an_ended_search_goes_on_with_the_same_doses_to_the_same_answer(uninterrupted, ended, tmp_path):
    plan, rows, answer = uninterrupted

    def interrupt(tally):
        if tally.ended_here >= ended:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(plan, tmp_path / "x", show=interrupt)
    assert len(in_order(plan, tmp_path / "x")) == ended
    schedule = run(plan, tmp_path / "x")
    assert in_order(plan, tmp_path / "x") == rows and found(schedule) == answer


@pytest.mark.parametrize("workers", [2, 3, 16])
def test_doses_depend_neither_on_the_number_of_workers_nor_on_who_ends_first(uninterrupted, workers):
    plan, rows, answer = uninterrupted
    schedule, flying, rng = BoundarySchedule(plan), {}, random.Random(workers)
    while not schedule.complete:
        for worker in map(str, range(workers)):
            if worker not in flying and (unit := schedule.next(worker)) is not None:
                flying[worker] = unit
        schedule.finish(planted_unit(flying.pop(rng.choice(sorted(flying)))))
    assert schedule.next("0") is None
    assert [(r["index"], r["cell"]) for r in schedule.records()] == [(r["index"], r["cell"]) for r in rows]
    assert found(schedule) == answer


def test_more_trials_go_on_with_a_search_and_fewer_are_its_beginning(uninterrupted, tmp_path):
    plan, rows, answer = uninterrupted
    run(plan_of(trials=22), tmp_path / "x")
    assert in_order(plan, tmp_path / "x") == rows[:22]
    assert found(run(plan, tmp_path / "x")) == answer
    assert in_order(plan, tmp_path / "x") == rows
    assert BoundarySchedule(plan_of(trials=22), rows).done == 22


def test_a_trial_whose_stress_did_not_act_says_nothing_of_its_dose(uninterrupted):
    plan, rows, answer = uninterrupted
    idle = [row for row in rows[plan.shams :] if row["outcome"] == "completed"][-3:]
    spared = [row | {"exposed": False} if row in idle else row for row in rows]
    left = BoundarySchedule(plan, [row for row in rows if row not in idle])
    assert BoundarySchedule(plan, spared).outcomes() == left.outcomes()
    assert found(BoundarySchedule(plan, spared)) != answer


def test_a_void_trial_says_nothing_of_its_dose(uninterrupted):
    plan, rows, answer = uninterrupted
    assert any(row["outcome"] == "void" for row in rows[8:])
    judged = [row for row in rows if row["outcome"] != "void"]
    assert found(BoundarySchedule(plan, judged)) == answer
    assert len(BoundarySchedule(plan, rows).outcomes()[0]) == len(judged)


def test_trials_that_were_given_up_are_tried_again_with_their_doses(uninterrupted, tmp_path, monkeypatch):
    plan, rows, _ = uninterrupted
    assert rows[13]["outcome"] == "completed"
    monkeypatch.setenv("PLANTED_FAULT", "13")
    assert len(run(plan, tmp_path / "x").outcomes()[0]) < len(rows)
    once = in_order(plan, tmp_path / "x")
    assert [r["index"] for r in once if r["outcome"] == "infrastructure_error"] == [13]
    monkeypatch.delenv("PLANTED_FAULT")
    run(plan, tmp_path / "x", retry_errors=True)
    # Those that came later were chosen without it, and stay.
    assert in_order(plan, tmp_path / "x") == [*once[:13], rows[13], *once[14:]]
    assert once[:13] == rows[:13]


def test_a_fault_of_the_machine_ends_a_search_before_trials_are_given_up(tmp_path, monkeypatch):
    monkeypatch.setenv("PLANTED_FAULT", "all")
    plan = plan_of()
    with pytest.raises(MachineError, match="the last 3 units ended in the same error: no GL here"):
        run(plan, tmp_path / "x")
    monkeypatch.delenv("PLANTED_FAULT")
    assert in_order(plan, tmp_path / "x") == []
    assert run(plan, tmp_path / "x").done == 40


def test_a_level_that_shams_reach_is_refused():
    plan = plan_of(level=0.25)
    schedule, units = BoundarySchedule(plan), []
    while (unit := schedule.next()) is not None:
        units.append(unit)
    assert [unit.kind for unit in units] == ["sham"] * 8
    for unit in units:
        schedule.finish(planted_unit(unit) | {"breakage": unit.index < 2})
    refused = r"dual: 2 of 8 trials fail without stress; give --fail above 0\.25, or mend the system"
    with pytest.raises(InputError, match=refused):
        schedule.next()
    with pytest.raises(InputError, match=refused):
        BoundarySchedule(plan, schedule.records())
    assert BoundarySchedule(plan_of(level=0.3), schedule.records()).next() is not None


def test_the_trials_of_a_search_answer_other_levels(uninterrupted):
    plan, rows, _ = uninterrupted
    doses = []
    for level in (0.35, 0.5, 0.65):
        schedule = BoundarySchedule(plan_of(level=level), rows)
        assert schedule.complete
        doses.append(plan.axis.dose(found(schedule, level).median))
    assert doses == sorted(doses) and doses[0] < 0.95 * doses[2]


def test_units_of_the_same_experiment_that_no_search_chose_are_refused(uninterrupted):
    plan, rows, _ = uninterrupted
    for wrong in ({"index": 2}, {"cell": "motion_blur/1", "index": 3}, {"cell": "sham", "index": 20}):
        with pytest.raises(InputError, match="no search chooses"):
            BoundarySchedule(plan, [*rows[:2], rows[2], rows[9] | wrong])


def test_another_question_is_another_experiment(tmp_path):
    run(plan_of(trials=9), tmp_path / "x")
    others = [{"of": "mission"}, {"kind": "low_texture"}, {"seed": 1}, {"batch": 2},
              {"axis": DoseAxis("exposure_s", 0.01, 0.5)}, {"shams": 7}]  # fmt: skip
    for other in others:
        with pytest.raises(InputError, match="holds rows of another spec"):
            run(plan_of(**({"trials": 9} | other)), tmp_path / "x")


def test_the_failure_is_the_column_that_eq1_names():
    columns = {of: plan_of(of=of).column for of in ("breakage", "dual", "system", "mission", "recovery")}
    whole = dual_column(len(SPEC.threads))
    assert columns == {"breakage": "breakage", "dual": whole, "system": "s2", "mission": "m2",
                       "recovery": "cross_r1_failed"}  # fmt: skip
    assert plan_of(of="recovery").spec.arms == ("crossing",) and plan_of().spec.arms == ("free",)


def test_every_kind_has_an_axis_whose_doses_rise_in_strength_and_are_valid():
    assert set(AXES) == set(SEGMENT_KINDS)
    for kind in AXES:
        plan = plan_of(kind)
        assert np.all(np.diff(plan.strengths) > 0) and plan.axis == AXES[kind]
        assert plan.axis.dose(plan.axis.strength(0.3)) == pytest.approx(0.3)
        assert len(plan.dose_cells) == len(plan.strengths)
    assert not AXES["low_texture"].rises and AXES["motion_blur"].rises


def test_times_and_fields_are_those_of_the_spec():
    run = load_spec("eq1")
    plan = boundary_plan(run, "fast_rotation", "breakage", 0.5, base="room")
    (segment,) = plan.spec.unit(plan.dose_cells[3], 0).scenario.segments
    assert (segment.axis, segment.duration_s, segment.start_s) == ("yaw", 1.0, 5.5)
    assert segment.rate_degps == plan.axis.doses[3]
    creeping = boundary_plan(run, "fog-creeping", "breakage", 0.5, base="room")
    (segment,) = creeping.spec.unit(creeping.dose_cells[0], 0).scenario.segments
    assert (segment.ramp_s, segment.fall_s) == (2.0, 0.0) and creeping.kind == "fog-creeping"
    assert boundary_plan(run, "defocus-creeping", "dual", 0.5).spec.confirmatory_threads is None


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            {"base": "corridr"},
            r"--world: smoke has no corridr among its bases; use corridor \(did you mean that\?\)",
        ),
        ({"level": 1.0}, "--fail: 1 is no probability that a dose can have"),
        ({"level": 0.0}, "--fail: 0 is no probability"),
        ({"trials": 8}, "--trials: 8 trials leave none with stress beside 8 without"),
        ({"kind": "motion_blurr"}, r"motion_blurr: there is no such kind of stress; use motion_blur \(did"),
        ({"kind": "motion_blur-creeping"}, "motion_blur has no ramp_s"),
    ],
)
def test_a_search_that_cannot_be_is_one_line(options, said):
    with pytest.raises(InputError, match=said):
        plan_of(**options)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ("motion_blur", "contrast"),
            "--dose: a segment of kind motion_blur has no number contrast; use exp",
        ),
        (("fast_rotation", "axis"), "has no number axis; use rate_degps"),
        (("fog", "airlight_level"), "no range of airlight_level is known of fog; give --dose with --weakest"),
        (("motion_blur", None, 0.0, 0.5), "--weakest: 0 has no logarithm"),
        (("motion_blur", None, None, 2.0), "--strongest: exposure_s: 2.0 is not valid; input should be less"),
        (("motion_blur", None, 0.1, 0.1), "0.1 and 0.1 are too near each other"),
    ],
)
def test_doses_that_cannot_be_are_one_line(arguments, said):
    with pytest.raises(InputError, match=said):
        dose_axis(*arguments)
    assert dose_axis("fog", "airlight_level", 250.0, 10.0) == DoseAxis("airlight_level", 250.0, 10.0)


def test_kinds_from_outside_are_searched_if_they_have_a_number():
    class Eclipse(SegmentBase):
        kind: Literal["eclipse"]
        of: Literal["sun", "moon"] = "sun"

    class Smoke(SegmentBase):
        kind: Literal["smoke"]
        density: float = Field(gt=0)

    for model in (Eclipse, Smoke):
        SEGMENT_KINDS.add(model)
    try:
        with pytest.raises(InputError, match="eclipse: has no number that could be its dose"):
            dose_axis("eclipse")
        with pytest.raises(InputError, match="no range of density is known of smoke; give --dose with"):
            dose_axis("smoke")
        assert dose_axis("smoke", None, 0.1, 9.0) == DoseAxis("density", 0.1, 9.0)
    finally:
        for kind in ("eclipse", "smoke"):
            SEGMENT_KINDS.remove(kind)


@pytest.mark.parametrize(
    ("change", "ended", "said"),
    [
        (
            {"breakage": True, "breakage_reason": "few_inliers"},
            4,
            r"dual: 4 of 4 trials fail .* \(few inliers\); mend",
        ),
        (
            {"outcome": "void", "void_reason": "no_map", "breakage": None},
            8,
            "all 8 trials .* are void: no map; see one",
        ),
    ],
)
def test_a_system_that_fails_without_stress_is_refused_as_soon_as_that_is_sure(change, ended, said):
    schedule = BoundarySchedule(plan_of())
    for _ in range(ended):
        schedule.finish(planted_unit(schedule.next()) | {"outcome": "completed"} | change)
    with pytest.raises(InputError, match=said):
        schedule.next()
