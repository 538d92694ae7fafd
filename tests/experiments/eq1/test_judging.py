"""What a unit's record says of base and Dual-SLAM, on runs that break, drift and recover on cue."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from slam_fakes import fake_factory, make_sequence

from dslab.experiments.eq1 import judging
from dslab.experiments.eq1.arms import FreeArm
from dslab.experiments.eq1.judging import AUDITED, Fault, false_declarations, judge_free
from dslab.experiments.eq1.recovery_judging import Reference
from dslab.experiments.eq1.units import Exposure
from dslab.experiments.runs.execution import execute

SEQUENCE = make_sequence()
FIRST, LAST = 150, 180
EXPOSURE = Exposure(FIRST / 30, (LAST - FIRST + 1) / 30, FIRST, LAST, LAST + 15)


def run(kind, **script):
    return execute(SEQUENCE, kind, 0, build=fake_factory(SEQUENCE, **script))


def judged(base=None, dual=None, **script):
    """The columns of a free arm whose two runs follow one script, or are given."""
    base, dual = base or run("base", **script), dual or run("dual", **script)
    reference = Reference(SEQUENCE, EXPOSURE, dual.trajectories[0], 1)
    return judge_free(FreeArm(base, dual, None), reference)


@pytest.mark.parametrize(
    ("script", "broke", "relocalized", "failed"),
    [
        ({"breaks_at": 160}, True, False, True),
        ({"breaks_at": 160, "relocalizes_after": 10}, True, True, False),
        ({"breaks_at": 230}, False, None, False),
        ({}, False, None, False),
    ],
)
def test_the_base_fails_only_by_a_breakage_of_the_exposed_segment(script, broke, relocalized, failed):
    row = judged(**script)
    assert (row["breakage"], row["base_breakage"]) == (broke, broke)
    assert (row.get("relocalized"), row["base_failure"]) == (relocalized, failed)


def test_frames_tracked_are_those_with_a_final_pose_in_the_main_map_for_both():
    base, dual = run("base"), run("dual")
    (path,) = base.trajectories
    kept = replace(
        path, frames=path.frames[::2], stamps_s=path.stamps_s[::2], T_map_cam=path.T_map_cam[::2]
    )  # the other poses were withdrawn after they had been returned
    row = judged(replace(base, trajectories=[kept]), replace(dual, trajectories=[kept]))
    assert row["base_share_tracked"] == row["dual_share_tracked"] == len(kept.frames) / 300


def test_the_error_over_keyframes_is_not_that_over_frames():
    base = run("base")
    (path,) = base.trajectories
    T = path.T_map_cam.copy()
    T[~np.isin(path.frames, base.keyframes[0].frames), 1, 3] += 0.2
    row = judged(replace(base, trajectories=[replace(path, T_map_cam=T)]))
    assert row["base_keyframe_ate_m"] == pytest.approx(0, abs=1e-9) and row["base_ate_m"] > 0.05


def test_a_loss_is_silent_without_a_declaration_and_else_delayed():
    silent = judged(drift_from=155)
    assert (silent["breakage"], silent["silent_failure"]) == (False, True)
    assert [silent[name] for name in ("d1", "s1", "m1", "mission_cause")] == [
        *(False, False, True, "silent_failure")
    ]
    assert (silent["base_mission_failure"], silent["base_mission_cause"]) == (True, "silent_failure")
    late = judged(drift_from=155, breaks_at=178)
    assert late["silent_failure"] is False and 0.5 < late["declaration_delay_s"] <= 23 / 30
    assert [late[name] for name in ("d1", "s1", "m1", "mission_cause")] == [True, True, True, "dual_failure"]


def test_a_final_pose_out_of_bounds_fails_the_mission_though_the_segment_was_passed():
    row = judged(drift_from=230)
    assert (row["silent_failure"], row["m1"], row["mission_cause"]) == (False, True, "final_pose")
    assert (row["base_mission_failure"], row["base_mission_cause"]) == (True, "final_pose")


def test_a_false_declaration_fails_the_mission_and_is_its_cause_if_it_came_first(monkeypatch):
    for frame, cause in ((120, "false_loop"), (170, "dual_failure")):
        monkeypatch.setattr(
            judging, "false_declarations", lambda _, frame=frame: [Fault(frame, AUDITED, "false_loop")]
        )
        row = judged(breaks_at=160)
        assert (row["m1"], row["mission_cause"], row["base_mission_failure"]) == (True, cause, True)
    whole = judged()
    assert (whole["d1"], whole["s1"], whole["m1"], whole["mission_cause"]) == (
        False,
        False,
        True,
        "false_loop",
    )


def test_loops_relocalizations_and_fusions_count_if_the_audit_finds_them_false():
    def finding(frame, false):
        return SimpleNamespace(
            event=SimpleNamespace(frame=frame), audit=SimpleNamespace(false=false), false=false
        )

    findings = {
        name: [finding(first, True), finding(first + 1, False), finding(first + 2, None)]
        for name, first in (("loops", 10), ("fusions", 20), ("joins", 30), ("relocalizations", 40))
    }
    causes = {fault.frame: fault.cause for fault in false_declarations(SimpleNamespace(**findings))}
    assert causes == {10: "false_loop", 20: "false_fusion", 30: "false_fusion", 40: "false_relocalization"}


@pytest.mark.parametrize("script", [{}, {"drift_from": 155}, {"breaks_at": 160}, {"breaks_at": 230}])
def test_a_failed_mission_has_one_first_cause_and_another_none(script):
    row = judged(**script)
    assert row["m1"] == (row["mission_cause"] is not None) and row["m1"] >= row["s1"] >= row["d1"]
    assert row["base_mission_failure"] == (row["base_mission_cause"] is not None)
