"""Units become rows, rows become counts; nothing that goes wrong is counted as a failure of the SLAM."""

from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from slam_fakes import fake_factory, make_sequence

from experiments.smoke import count, run_smoke
from experiments.smoke_trial import empty_row, run_trial
from scenarios.errors import InputError
from scenarios.spec import RoomWorld, Scenario

SCENARIO = Scenario(name="made-up", world=RoomWorld(), seed=0)
SEQUENCE = make_sequence()


def trial(seed: int = 0, sequence=SEQUENCE, **script) -> dict:
    return run_trial(SCENARIO, seed, lambda scenario, s: sequence, build=fake_factory(SEQUENCE, **script))


def test_a_unit_that_holds_is_no_breakage_and_no_failure():
    row = trial()
    assert row["outcome"] == "completed"
    assert (row["breakage"], row["dual_failure"], row["silent_failure"]) == (False, False, False)
    assert row["recovery_failure"] is None and row["breakage_frame"] is None


def test_a_recovered_breakage():
    row = trial(breaks_at=160)
    assert (row["breakage"], row["recovered_declared"], row["false_recovery"]) == (True, True, False)
    assert (row["recovery_failure"], row["dual_failure"], row["no_reinit"]) == (False, False, False)
    assert row["base_failure"] is True and row["relocalized"] is False
    assert row["breakage_segment"] == "low_texture" and row["breakage_frame"] == 160
    assert row["declaration_delay_s"] == 0.0


def test_a_relocalized_breakage_is_a_breakage_all_the_same():
    row = trial(breaks_at=160, relocalizes_after=40)
    assert (row["breakage"], row["relocalized"], row["base_failure"]) == (True, True, False)
    assert row["breakage_frame"] == 160 and row["recovery_failure"] is False
    counted = count([row, trial(breaks_at=160), trial()])
    assert (counted.p0.events, counted.p0.units) == (2, 3)
    assert (counted.relocalized.events, counted.relocalized.units) == (1, 2)
    assert (counted.base_failure.events, counted.base_failure.units) == (1, 3)


def test_a_recovery_that_fails_is_a_dual_failure_with_its_reason():
    row = trial(breaks_at=160, recovers=False)
    assert (row["recovery_failure"], row["dual_failure"], row["recovered_declared"]) == (True, True, False)
    assert row["recovery_stage"] == "overlap" and "no_common_points" in row["recovery_reason"]
    assert row["false_recovery"] is None


def test_a_false_recovery_fails_by_the_audit_though_the_system_says_otherwise():
    row = trial(breaks_at=160, new_map_scale=1.5)
    assert row["recovered_declared"] is True and row["false_recovery"] is True
    assert row["recovery_failure"] is True and row["dual_failure"] is True
    assert row["fusion_scale_error"] == pytest.approx(0.5, abs=0.01)


def test_a_new_map_that_never_stands_is_a_failure():
    row = trial(breaks_at=160, reinit_after=10_000)
    assert (row["no_reinit"], row["dual_failure"], row["recovery_ran"]) == (True, True, False)


def test_a_breakage_outside_the_exposure_is_not_b():
    row = trial(breaks_at=260)
    assert row["breakage"] is False and row["base_failure"] is True


@pytest.mark.parametrize(
    ("script", "why"),
    [
        ({"starts_at": 140}, "tracked for"),
        ({"starts_at": 200}, "not tracking"),
        ({"drift_from": 30}, "position error"),
        ({"breaks_at": 100}, "not tracking"),
    ],
)
def test_an_unhealthy_lead_in_voids_the_unit(script, why):
    row = trial(**script)
    assert row["outcome"] == "void" and why in row["void_reason"]
    assert row["dual_failure"] is None


def test_no_acting_segment_voids_the_unit():
    assert trial(sequence=replace(SEQUENCE, segments=()))["outcome"] == "void"


def test_a_crash_is_an_infrastructure_error_and_does_not_raise():
    row = trial(fails_at=50)
    assert row["outcome"] == "infrastructure_error"
    assert "told to fail" in row["message"] and "slam_fakes.py" in row["message"]
    assert row["dual_failure"] is None


def test_bad_input_while_rendering_is_an_infrastructure_error():
    def render(scenario, seed):
        raise InputError("GL", "no headless OpenGL here", "install libegl1")

    row = run_trial(SCENARIO, 0, render)
    assert row["outcome"] == "infrastructure_error" and "libegl1" in row["message"]


def test_every_unit_has_the_same_columns():
    columns = list(empty_row(SCENARIO, 0))
    for script in ({}, {"breaks_at": 160}, {"starts_at": 200}, {"fails_at": 3}):
        assert list(trial(**script)) == columns


SCRIPTS = [
    {}, {"breaks_at": 160}, {"breaks_at": 170, "recovers": False}, {"breaks_at": 165, "new_map_scale": 1.6},
    {"starts_at": 200}, {"fails_at": 9}, {}, {"drift_from": 160},
]  # fmt: skip


UNITS = [SCENARIO.model_copy(update={"seed": seed}) for seed in range(len(SCRIPTS))]


def scripted(scenario: Scenario, seed: int) -> dict:
    return trial(seed, **SCRIPTS[seed])


def test_the_counts_of_a_known_set_of_units(tmp_path):
    told = []
    result, rows = run_smoke(UNITS, tmp_path / "out", progress=lambda *p: told.append(p), trial=scripted)
    assert (result.units, result.void, result.errors) == (8, 1, 1)
    assert (result.p0.events, result.p0.units) == (3, 6)
    assert (result.pr_given_b.events, result.pr_given_b.units) == (2, 3)
    assert (result.measured.events, result.measured.units) == (2, 6)
    assert (result.silent.events, result.false_recovery.events, result.false_recovery.units) == (1, 1, 2)
    assert result.predicted == pytest.approx(result.measured.estimate)  # the chain rule, no test of Eq. 1
    assert told[-1] == (8, 8)
    assert [r["seed"] for r in rows] == list(range(8))


def test_the_table_keeps_types_whatever_the_rows_hold(tmp_path):
    for name, seeds in (("few", 1), ("all", len(SCRIPTS))):
        run_smoke(UNITS[:seeds], tmp_path / name, trial=scripted)
    few = pq.read_table(tmp_path / "few" / "units.parquet")
    whole = pq.read_table(tmp_path / "all" / "units.parquet")
    assert few.schema.equals(whole.schema)
    assert whole.num_rows == len(SCRIPTS)
    assert whole.schema.field("dual_failure").type == "bool"
    assert whole["dual_failure"].to_pylist() == [False, False, True, True, None, None, False, False]
    assert np.isfinite(whole["wall_s"].to_numpy()).all()


def test_no_units_counted_gives_no_estimate():
    result = count([empty_row(SCENARIO, 0)])
    assert result.p0.estimate is None and result.predicted is None and result.errors == 1
