"""Mission failure: what counts, and which cause was first."""

from dataclasses import replace

import numpy as np
import pytest
from unit_scenes import END, FPS, FRAMES, ONSET, run, synthetic, unit

from dslab.experiments.eq1 import arms, trial
from dslab.experiments.eq1.judging import (
    AUDITED,
    DECLARED,
    Fault,
    final_pose_faults,
    first_cause,
    system_failures,
)
from dslab.experiments.eq1.records import decided
from dslab.experiments.eq1.units import Exposure
from dslab.experiments.evaluation.view_overlap import BestOverlap
from dslab.slam.core.results import MapTrajectory

EXPOSURE = Exposure(ONSET / FPS, (END - ONSET + 1) / FPS, ONSET, END, END + 7)


class Run:
    """What the judgement of the final pose sees of a run: one map, whose poses are the truth, scaled."""

    def __init__(self, scale_after: float = 1.0, off_m: float = 0.0, until: int = FRAMES) -> None:
        self.sequence = synthetic()
        T = self.sequence.T_world_cam[:until].copy()
        after = np.arange(until) > END
        seam = T[min(END, until - 1), :3, 3]
        T[after, :3, 3] = seam + scale_after * (T[after, :3, 3] - seam)
        T[-15:, 0, 3] += off_m
        self.trajectories = [MapTrajectory(0, np.arange(until), self.sequence.stamps_s[:until], T)]


@pytest.mark.parametrize(
    ("run_of", "off"),
    [
        (Run(), False),
        (Run(scale_after=1.05), False),
        (Run(scale_after=1.3), True),
        (Run(off_m=3.0), True),
        (Run(off_m=3.0, until=END), False),  # the map ends in the segment: it has no final pose
    ],
)
def test_the_final_pose_is_out_of_bounds_by_scale_or_place(run_of, off):
    found = final_pose_faults(run_of, EXPOSURE)
    assert [fault.cause for fault in found] == (["final_pose"] if off else [])


def test_the_first_cause_is_the_earliest_and_what_was_declared_before_what_was_audited():
    late, early = Fault(90, AUDITED, "false_loop"), Fault(80, AUDITED, "silent_failure")
    assert first_cause([late, early]) == "silent_failure"
    assert first_cause([early, Fault(80, DECLARED, "dual_failure")]) == "dual_failure"
    assert first_cause([]) is None


def test_a_false_first_success_fails_the_system_though_a_later_thread_is_right():
    """Planted: thread 1 declares success falsely, thread 2 rightly; so S_2 without D_2."""
    assert system_failures(True, failed=[True, False], declared=[True, True]) == ([True, False], [True, True])
    assert system_failures(True, failed=[True, False], declared=[False, True]) == (
        [True, False],
        [True, False],
    )
    assert system_failures(True, failed=[False, True], declared=[True, True]) == (
        [False, False],
        [False, False],
    )
    assert system_failures(False, failed=[True, True], declared=[False, False]) == ([False] * 2, [False] * 2)


@pytest.mark.slow
def test_cells_of_a_replicate_share_one_lead_in_and_change_no_record(monkeypatch):
    sequence, of = synthetic(range(85, 91)), unit("orb")
    monkeypatch.setattr(arms, "_lead_ins", {})
    alone = run(monkeypatch, sequence, of)
    runs, once = [], arms.run_lead_in
    monkeypatch.setattr(arms, "run_lead_in", lambda *a: runs.append(a) or once(*a))
    again = run(monkeypatch, sequence, of)
    assert decided(again) == decided(alone) and not runs
    other = run(monkeypatch, synthetic(range(95, 99)), of)  # another cell: the same images before the onset
    assert other["breakage_frame"] != alone["breakage_frame"] and not runs
    run(monkeypatch, sequence, of.model_copy(update={"repeat_seed": 9}))
    assert len(runs) == 1  # another replicate


@pytest.mark.slow
def test_beside_a_system_with_its_own_initialisation_stands_the_plain_base(monkeypatch):
    sequence = synthetic(range(85, 91))
    plain = run(monkeypatch, sequence, unit("orb", arms=("free",)))
    plus = run(monkeypatch, sequence, unit("orb", arms=("free",), system="dual+"))
    names = [name for name in plain if name.startswith("base_")]
    assert [plus[name] for name in names] == [plain[name] for name in names]
    assert plus["base_breakage"] is True and plus["outcome"] == "completed"


def test_a_sham_is_judged_over_the_same_frames_without_a_segment(monkeypatch):
    sham = unit("orb", arms=("free",), kind="sham", onset_s=ONSET / FPS, exposed_s=(END - ONSET + 1) / FPS)
    sham = sham.model_copy(update={"scenario": sham.scenario.model_copy(update={"segments": ()})})
    record = run(monkeypatch, replace(synthetic(), segments=()), sham)
    assert (record["outcome"], record["onset_frame"], record["end_frame"]) == ("completed", ONSET, END)
    assert (record["breakage"], record["m1"]) == (False, False)


def test_the_overlap_is_of_frames_without_stress_within_the_buffer(monkeypatch):
    asked = []

    def best(scenario, T_world_cam, before, after, cache_dir):
        asked.append((list(before), list(after)))
        return BestOverlap(0.15, (70, 110))

    monkeypatch.setattr(trial, "best_overlap", best)
    scenario = unit().scenario
    found = trial.overlap_columns(scenario, synthetic(), 1.0)
    assert found == {"view_overlap": 0.15, "rescuable": False}
    assert asked == [(list(range(ONSET - round(FPS), ONSET)), list(range(END + 1, FRAMES)))]
    assert trial.overlap_columns(scenario, replace(synthetic(), segments=()), 1.0) == {}
