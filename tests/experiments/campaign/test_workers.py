"""Systems of an experiment are looked for, and their workers checked, before anything runs."""

from pathlib import Path

import pytest
from slam_fakes import make_sequence
from system_programs import write_program
from unit_fakes import MadeUp, made_up_unit

from dslab.experiments.campaign.workers import find_systems, unit_workers
from dslab.experiments.eq1.boundary_plan import boundary_plan
from dslab.experiments.eq1.spec import load_spec
from dslab.scenarios.errors import InputError

SMOKE = load_spec("smoke")
EXAMPLE = f"{Path(__file__).parents[3] / 'examples' / 'own_slam.py'}:ConstantVelocity"


def with_systems(*names: str):
    return SMOKE.model_copy(update={"systems": names})


def test_an_unknown_system_and_one_that_cannot_be_started_are_one_line(tmp_path):
    with pytest.raises(InputError, match=r"systems: there is no system 'dualx'; give .*dual"):
        find_systems(with_systems("dual", "dualx"))
    write_program(tmp_path, make_sequence(4, segment=None), command="no-such-program {sequence} {out}")
    with pytest.raises(InputError, match="no such command: no-such-program"):
        find_systems(with_systems("copy"), (tmp_path,))


def test_what_takes_real_time_has_no_other_worker_beside(tmp_path):
    write_program(tmp_path, make_sequence(4, segment=None), pace="real_time")
    spec = with_systems("dual", "copy")
    assert unit_workers(spec, (tmp_path,)).settings.workers == 1
    for wrong in ({"workers": 2}, {"scheduler": "tcp://there:1"}):
        with pytest.raises(InputError, match=r"copy takes frames in real time.*give --workers 1"):
            unit_workers(spec, (tmp_path,), **wrong)


def test_the_limit_of_a_unit_leaves_a_hanging_system_to_its_own():
    spec = with_systems(EXAMPLE)
    assert list(find_systems(spec)) == ["ConstantVelocity"] == list(unit_workers(spec).digests)
    with pytest.raises(InputError, match="100 s are less than the 360 s"):
        unit_workers(spec, time_s=100)
    assert unit_workers(SMOKE, time_s=1).digests == {}


def test_rows_of_a_system_that_was_changed_are_not_mixed_with_new_ones(run_made_up):
    plan = MadeUp({"fine": 2})
    run_made_up(plan, job=digested_unit, digests={"dual": "before"})
    run_made_up(plan, job=digested_unit, digests={"dual": "before"})
    with pytest.raises(InputError, match="dual was changed since it ran here; choose a new folder"):
        run_made_up(plan, job=digested_unit, digests={"dual": "after"})


def digested_unit(unit, **options):
    return made_up_unit(unit, **options) | {"system_digest": "before"}


def test_a_boundary_is_that_of_the_named_system():
    plan = boundary_plan(SMOKE, "motion_blur", "mission", 0.5, system=EXAMPLE)
    unit = plan.spec.unit(plan.dose_cells[3], 2)
    assert (plan.system, unit.system, unit.arms) == ("ConstantVelocity", EXAMPLE, ("free",))
    of_dual = boundary_plan(SMOKE, "motion_blur", "mission", 0.5)
    assert of_dual.spec.unit(of_dual.dose_cells[3], 2).scenario == unit.scenario
    assert of_dual.spec.content_hash != plan.spec.content_hash
    with pytest.raises(InputError, match="recovery is a failure of recovery threads, which dso does not"):
        boundary_plan(SMOKE, "motion_blur", "recovery", 0.5, system="dso")
