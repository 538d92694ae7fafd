"""Any system in the free arm: what it does, crashes and hangs included, is the outcome of the unit."""

from pathlib import Path

import numpy as np
import pytest
from system_programs import write_program
from unit_scenes import END, ONSET, run, synthetic, unit

from dslab.experiments.eq1 import arms
from dslab.experiments.eq1.records import decided
from dslab.experiments.eq1.trial import run_unit
from dslab.experiments.runs.systems.command_spec import Limits

SEQUENCE = synthetic()
EXAMPLE = Path(__file__).parents[3] / "examples" / "own_slam.py"
# Gives the truth beside it, at half the scale; EDIT is done before, with the number f of the frame.
CLASS = """
import os, pathlib, time
import numpy as np
class Replay:
    def __init__(self, camera, seed):
        self.truth = np.load(pathlib.Path(__file__).with_name("truth.npy"))
        self.f, DECLARES
    def process(self, image, stamp_s):
        self.f += 1
        f, T = self.f, self.truth[self.f].copy()
        T[:3, 3] *= 0.5
        EDIT
        return T
"""


def replay(folder: Path, edit: str = "pass", declares: bool = False) -> str:
    """Name of a class that does something at a frame."""
    np.save(folder / "truth.npy", SEQUENCE.T_world_cam)
    said = "self.events = -1, []" if declares else "_ = -1, None"
    text = CLASS.replace("EDIT", edit.replace("\n", "\n        ")).replace("DECLARES", said)
    (folder / "own.py").write_text(text)
    return f"{folder / 'own.py'}:Replay"


def judged(monkeypatch, system: str, **options) -> dict:
    return run(monkeypatch, SEQUENCE, unit(system=system, arms=("free",)), **options)


def test_a_system_that_goes_on_neither_breaks_nor_fails(monkeypatch, tmp_path):
    record = judged(monkeypatch, replay(tmp_path))
    assert (record["outcome"], record["system"], record["declares"]) == ("completed", "Replay", "nothing")
    assert (record["breakage"], record["s1"], record["m2"]) == (False, False, False)
    # It has no word against which it could be silent, no threads, and no base beside.
    assert {record[name] for name in ("silent_failure", "d1", "d2", "base_failure", "cross_r1_failed")} == {
        None
    }
    assert record["dual_ate_m"] < 0.01 and record["dual_share_tracked"] == 1


@pytest.mark.parametrize(
    ("edit", "reason", "frame"),
    [
        ("if 85 <= f: return None", "no_pose", 85),
        ("if 85 <= f: T[:3, 3] += 3", "wrong_pose", 85),
        ("if f == 85: raise ValueError('no')", "crashed", 85),
        ("if f == 85: os.kill(os.getpid(), 11)", "crashed", 85),
        ("if f == 85: time.sleep(60)", "timed_out", 85),
        ("if 85 <= f: T[:] = np.nan", "not_finite", 85),
        ("if 85 <= f: return 'garbage'", "unreadable", 85),
    ],
)
@pytest.mark.slow
def test_whatever_it_does_is_a_breakage_and_a_failed_mission(monkeypatch, tmp_path, edit, reason, frame):
    monkeypatch.setattr(arms, "LIMITS", Limits(start_s=10, slow_down=0.1))
    record = judged(monkeypatch, replay(tmp_path, edit))
    assert record["outcome"] == "completed" and record["message"] == ""
    assert (record["breakage"], record["breakage_frame"], record["breakage_reason"]) == (True, frame, reason)
    assert (record["relocalized"], record["s1"], record["m1"]) == (False, True, True)
    assert record["mission_cause"] == "system_failure"
    assert record["ended"] == (reason if reason not in ("no_pose", "wrong_pose") else "finished")


def test_a_declared_loss_is_a_breakage_from_which_it_may_come_back(monkeypatch, tmp_path):
    edit = "if f == 85: self.events.append((stamp_s, 'dark'))\nif 85 <= f < 95: return None"
    record = judged(monkeypatch, replay(tmp_path, edit, declares=True))
    assert (record["declares"], record["breakage_reason"], record["breakage_frame"]) == ("losses", "dark", 85)
    assert (record["relocalized"], record["s1"], record["m1"]) == (True, False, False)
    assert record["silent_failure"] is False and record["declaration_delay_s"] == 0


def test_what_declares_losses_and_not_this_one_fails_silently(monkeypatch, tmp_path):
    record = judged(monkeypatch, replay(tmp_path, "if 85 <= f: T[:3, 3] += 3", declares=True))
    assert (record["breakage"], record["silent_failure"]) == (False, True)
    assert (record["m1"], record["mission_cause"]) == (True, "silent_failure")


@pytest.mark.slow
def test_an_unhealthy_lead_in_is_void_and_says_how_it_ended(monkeypatch, tmp_path):
    record = judged(monkeypatch, replay(tmp_path, "if f == 30: raise ValueError('no')"))
    assert record["outcome"] == "void" and "crashed: ValueError: no" in record["void_reason"]
    assert (record["ended"], record["breakage"]) == ("crashed", None)
    never_looks = judged(monkeypatch, f"{EXAMPLE}:ConstantVelocity")
    assert never_looks["outcome"] == "void" and "lead-in" in never_looks["void_reason"]


def test_a_program_that_leaves_nothing_under_stress_is_not_void(monkeypatch, tmp_path):
    """Its lead-in is judged in a run of its own, once for all cells of a replicate."""
    monkeypatch.setattr(arms, "_program_lead_ins", {})
    runs, once = [], arms.run_command
    monkeypatch.setattr(arms, "run_command", lambda *a: runs.append(len(a[1])) or once(*a))
    write_program(tmp_path, SEQUENCE, f"if len(stamps) > {END}: sys.exit(3)")
    for _ in range(2):
        record = judged(monkeypatch, "copy", folders=(tmp_path,))
        assert (record["outcome"], record["breakage"], record["m1"]) == ("completed", True, True)
        assert (record["breakage_reason"], record["breakage_frame"]) == ("crashed", ONSET)
        assert record["system_digest"]
    assert runs == [ONSET, len(SEQUENCE), len(SEQUENCE)]


@pytest.mark.slow
def test_the_base_alone_is_the_base_beside_dual_slam(monkeypatch):
    blank = synthetic(range(85, 130), frames=130)
    alone = run(monkeypatch, blank, unit("orb", system="base", arms=("free",)))
    beside = run(monkeypatch, blank, unit("orb", arms=("free",)))
    for own, of_base in (
        ("breakage", "base_breakage"),
        ("s1", "base_failure"),
        ("m1", "base_mission_failure"),
    ):
        assert alone[own] is beside[of_base] is True
    assert alone["dual_ate_m"] == beside["base_ate_m"] and beside["declares"] == "events"


@pytest.mark.slow
def test_a_class_gives_the_same_record_again(monkeypatch, tmp_path):
    system = replay(tmp_path, "if 85 <= f: return None")
    first, again = (judged(monkeypatch, system) for _ in range(2))
    assert decided(first) == decided(again)


def test_an_unknown_system_is_an_error_of_the_programs(monkeypatch):
    record = run_unit(unit(system="orbslam33", arms=("free",)))
    assert record["outcome"] == "infrastructure_error" and "orbslam3" in record["message"]


def test_recoveries_of_dual_slam_over_a_system_are_judged_in_both_arms(monkeypatch):
    of = unit("orb", system="dual(base)", settings={"framework": {"start_poses": 20}})
    calm = run(monkeypatch, SEQUENCE, of)
    assert (calm["outcome"], calm["breakage"], calm["free_r1_failed"]) == ("completed", False, None)
    crossed = {name: calm[f"cross_r1_{name}"] for name in ("failed", "declared", "false")}
    assert crossed == {"failed": False, "declared": True, "false": False}
    assert abs(calm["cross_r1_scale_error"]) < 0.05 and calm["cross_frames_to_cross"] > END - ONSET
    blind = run(monkeypatch, synthetic(range(ONSET + 5, END)), of)
    assert (blind["breakage"], blind["free_r1_failed"]) == (True, True)
    # In the free arm the base finds back by itself; where it is cut, only the recovery can, behind the gap.
    assert (blind["free_r1_stage"], blind["cross_r1_failed"]) == ("no_reinit", False)
