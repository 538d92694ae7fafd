"""One unit: declared, audited and void outcomes; branches equal runs from the start."""

import json
from dataclasses import replace

import numpy as np
import pytest
from rerun.chunk import RrdReader
from slam_fakes import FakeSystem
from unit_scenes import END, FRAMES, ONSET, run, synthetic, unit

from dslab.experiments.eq1 import arms, trial
from dslab.experiments.eq1.arms import run_crossing, run_free, run_lead_in
from dslab.experiments.eq1.records import columns, decided, thread_column
from dslab.experiments.eq1.units import unit_settings
from dslab.experiments.runs.execution import execute
from dslab.experiments.runs.slam_settings import factory_of
from dslab.scenarios.errors import InputError
from dslab.slam.core.events import RecoveryEnd
from dslab.slam.engine import SlamEngine
from dslab.slam.features.orb import OrbExtractor
from dslab.slam.features.sift_detector import SiftDetector

BROKEN = synthetic(range(85, 91))


@pytest.fixture(scope="module")
def broken():
    with pytest.MonkeyPatch.context() as monkeypatch:
        return run(monkeypatch, BROKEN, unit("orb,sift"))


def told(record, arm, thread, *names):
    return tuple(record[thread_column(arm, thread, name)] for name in names)


def trace(record):
    """Everything that a run returned, bit for bit, except CPU times."""
    events = [{k: v for k, v in e.record().items() if k != "cpu_ms"} for e in record.events]
    paths = [(p.map_id, p.frames.tobytes(), p.T_map_cam.tobytes()) for p in record.trajectories]
    poses = [None if r.T_map_cam is None else r.T_map_cam.tobytes() for r in record.results]
    states = [(r.frame, r.state, r.map_id, r.inliers) for r in record.results]
    return json.dumps(events), paths, poses, states


# -- outcomes ------------------------------------------------------------------------------------------------


def test_a_breakage_that_both_threads_cross(broken):
    assert broken["outcome"] == "completed" and broken["message"] == ""
    assert (broken["onset_frame"], broken["end_frame"]) == (ONSET, END)
    assert (broken["breakage"], broken["breakage_frame"]) == (True, 85)
    assert (broken["declaration_delay_s"], broken["silent_failure"]) == (0.0, False)
    # Half of the old view is still in the image: the base relocalizes, but it broke nevertheless.
    assert (broken["base_breakage"], broken["relocalized"], broken["base_failure"]) == (True, True, False)
    for thread in (1, 2):
        assert told(broken, "free", thread, "failed", "declared", "false", "stage") == (
            False,
            True,
            False,
            None,
        )
        scale_error, seam_m, frames = told(
            broken, "free", thread, "scale_error", "seam_error_m", "frames_covered"
        )
        assert abs(scale_error) < 0.05 and seam_m < 0.1 and 5 < frames < 40
    assert [broken[f"{failure}{n}"] for failure in "dsm" for n in (1, 2)] == [False] * 6
    assert (broken["mission_cause"], broken["base_mission_failure"]) == (None, False)
    assert 0.9 < broken["base_share_tracked"] <= broken["dual_share_tracked"]
    assert broken["dual_path_share"] > 0.9
    assert broken["dual_end_error_m"] < 0.2
    assert (broken["dual_false_fusions"], broken["dual_false_loops"], broken["dual_unjudged"]) == (0, 0, 0)
    assert broken["reinit_frame"] > 91 and 6 < broken["free_frames_to_cross"] < 20


def test_the_crossing_arm_crosses_all_of_the_segment(broken):
    assert broken["cross_reinit_frame"] > END
    assert broken["cross_frames_to_cross"] > END - ONSET
    for thread in (1, 2):
        assert told(broken, "cross", thread, "failed", "declared", "false") == (False, True, False)
        assert told(broken, "cross", thread, "frames_covered") > told(
            broken, "free", thread, "frames_covered"
        )


@pytest.mark.slow
def test_without_a_breakage_the_columns_of_the_free_arm_are_null(monkeypatch):
    record = run(monkeypatch, synthetic())
    assert (record["breakage"], record["silent_failure"], record["base_failure"]) == (False, False, False)
    assert [record[f"{failure}{n}"] for failure in "dsm" for n in (1, 2)] == [False] * 6
    free = [name for name in record if name.startswith("free_")]
    assert {record[name] for name in (*free, "reinit", "relocalized", "breakage_frame")} == {None}
    assert told(record, "cross", 1, "failed") == (False,)
    assert record["dual_share_tracked"] >= record["base_share_tracked"] > 0.95


def test_without_a_new_map_every_thread_fails(monkeypatch):
    record = run(monkeypatch, synthetic(range(85, FRAMES)))
    assert (record["breakage"], record["reinit"], record["cross_reinit"]) == (True, False, False)
    for arm in ("free", "cross"):
        for thread in (1, 2):
            assert told(record, arm, thread, "failed", "stage", "reason") == (True, "no_reinit", "no_new_map")
    assert [record[f"{failure}{n}"] for failure in "dsm" for n in (1, 2)] == [True] * 6
    assert (record["mission_cause"], record["base_mission_cause"]) == ("dual_failure", "base_failure")


def test_a_false_recovery_fails_by_the_audit(monkeypatch):
    lying = BROKEN.T_world_cam.copy()
    lying[END:, 0, 3] += 5.0  # the truth is elsewhere after the segment
    record = run(monkeypatch, replace(BROKEN, T_world_cam=lying), unit("orb", arms=("crossing",)))
    assert told(record, "cross", 1, "failed", "declared", "false", "stage") == (True, True, True, "audit")
    assert told(record, "cross", 1, "seam_error_m")[0] > 3
    assert record["breakage"] is None and record["d1"] is None  # the free arm was not run


@pytest.mark.parametrize(
    ("blank", "why"),
    [
        ((range(40, 46),), "broke in the lead-in"),
        ((range(50),), "tracked for"),
        ((range(75),), "not tracking at the onset"),
    ],
)
def test_an_unhealthy_lead_in_voids_the_unit(monkeypatch, blank, why):
    record = run(monkeypatch, synthetic(*blank))
    assert record["outcome"] == "void" and why in record["void_reason"]
    assert record["breakage"] is None and record["d1"] is None and record["cross_r1_failed"] is None


def test_a_map_too_young_to_be_kept_voids_the_unit(monkeypatch):
    record = run(monkeypatch, BROKEN, unit(settings={"min_map_keyframes": 50}))
    assert record["outcome"] == "void" and "keyframes only" in record["void_reason"]


def test_an_error_in_the_programs_is_an_infrastructure_error(monkeypatch):
    def refuse(*_):
        raise InputError("GL", "no headless OpenGL here", "install libegl1")

    monkeypatch.setattr(trial, "frames_of", refuse)
    record = trial.run_unit(unit())
    assert record["outcome"] == "infrastructure_error" and "libegl1" in record["message"]
    monkeypatch.setattr(arms, "run_lead_in", None)
    record = run(monkeypatch, synthetic(frames=ONSET + 3))  # ends within the exposed segment
    assert record["outcome"] == "infrastructure_error" and "units.py" in record["message"]
    assert record["d1"] is None and record["wall_s"] > 0


# -- records -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_runs_give_the_same_record_except_for_times(broken, monkeypatch):
    again = run(monkeypatch, BROKEN, unit("orb,sift"))
    assert decided(again) == decided(broken)
    assert decided(broken).keys() < broken.keys()


@pytest.mark.slow
def test_features_kept_between_arms_change_no_record(broken, monkeypatch):
    found = []

    def count(owner, method, kind):
        find = getattr(owner, method)
        monkeypatch.setattr(owner, method, lambda self, image: found.append(kind) or find(self, image))

    count(OrbExtractor, "_found", "orb")
    count(SiftDetector, "detect", "sift")
    monkeypatch.setattr(arms, "_lead_ins", {})
    run(monkeypatch, BROKEN, unit("orb,sift"))
    kept = found.copy()
    monkeypatch.setattr(SlamEngine, "remember_features", lambda *_: None)
    monkeypatch.setattr(arms, "_lead_ins", {})
    record = run(monkeypatch, BROKEN, unit("orb,sift"))
    assert decided(record) == decided(broken)
    for kind in ("orb", "sift"):
        assert kept.count(kind) < 0.8 * (found.count(kind) - kept.count(kind))


def test_every_record_has_the_same_columns_of_plain_values(broken, monkeypatch):
    records = [broken, run(monkeypatch, synthetic(range(70)), unit("orb,sift"))]
    for record in records:
        assert list(record) == list(columns(2))
        for name, kind in columns(2).items():
            plain = {"bool": bool, "int": int, "float": (int, float), "text": str}[kind]
            assert record[name] is None or type(record[name]) in np.atleast_1d(plain), name
    json.dumps(records, allow_nan=False)


@pytest.mark.slow
def test_a_recorded_unit_shows_base_and_dual_and_the_crossing_arm(monkeypatch, tmp_path):
    path = tmp_path / "unit.rrd"
    monkeypatch.setattr(trial, "frames_of", lambda *_: BROKEN)
    runs = trial.record_unit(unit("orb"), path)
    assert [run.system_kind for run in runs] == ["base", "dual"] and path.stat().st_size > 100_000
    found = {chunk.entity_path: chunk for chunk in RrdReader(path).stream() if not chunk.is_static}
    cut = found["/slam/crossing/breakages"].to_record_batch().to_pydict()
    assert (cut["frame"][0], cut["StateChange:state"][0]) == (ONSET - 1, ["cut"])
    assert "/slam/crossing/repairs" in found and "/world/crossing/map_1/path" in found


def test_a_unit_without_a_crossing_arm_or_a_healthy_lead_in_is_recorded_without(monkeypatch, tmp_path):
    monkeypatch.setattr(trial, "frames_of", lambda *_: BROKEN)
    monkeypatch.setattr(trial, "run_system", lambda *_, **__: runs.pop(0))
    monkeypatch.setattr(trial, "cross", lambda *_: pytest.fail("there is nothing to cross"))
    lost = FakeSystem(BROKEN.T_world_cam, starts_at=len(BROKEN))
    blind = [execute(BROKEN, kind, 0, build=lambda *_: replace(lost)) for kind in ("base", "dual")]
    for of in (unit("orb"), unit("orb").model_copy(update={"arms": ("free",)})):
        runs = [*blind]
        trial.record_unit(of, tmp_path / "unit.rrd")


# -- branches and modes --------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "sequence", [pytest.param(BROKEN, id="broken"), pytest.param(synthetic(), id="whole")]
)
def test_branches_equal_runs_from_the_start(sequence):
    of = unit()
    settings = unit_settings({}, of.threads)
    lead_in = run_lead_in("dual", sequence, ONSET, of.repeat_seed, settings).save()
    free = run_free(lead_in, sequence, "dual", of.repeat_seed)
    crossing = run_crossing(lead_in, sequence, END)
    build = factory_of(settings)
    for kind, branched in (("base", free.base), ("dual", free.dual)):
        assert trace(branched) == trace(execute(sequence, kind, of.repeat_seed, build=build))
    whole = run_lead_in("dual", sequence, ONSET, of.repeat_seed, settings)
    whole.system.cut()
    whole.feed(END + 1)
    whole.system.restart()
    whole.run_out()

    def ends(branch):
        found = [e.record() for e in branch.system.events if isinstance(e, RecoveryEnd)]
        return [{k: v for k, v in e.items() if k not in ("frame", "stamp_s", "cpu_ms")} for e in found]

    assert ends(crossing) == ends(whole) and len(ends(whole)) == 2


@pytest.mark.slow
@pytest.mark.parametrize("blank", [range(85, 91), range(80, 103)], ids=["crossed", "not crossed"])
def test_both_modes_give_the_same_failure_for_every_n(monkeypatch, blank):
    sequence = synthetic(blank)
    record = run(monkeypatch, sequence, unit("orb,gms", arms=("free",)))
    for n, kinds in ((1, "orb"), (2, "orb,gms")):
        of = unit_settings({}, unit(kinds).threads)
        usual = replace(of, dual_options={**of.dual_options, "exhaustive": False})
        shipped = execute(sequence, "dual", 2, build=factory_of(usual))
        ends = [e for e in shipped.events if isinstance(e, RecoveryEnd) and e.stage != "cancelled"]
        assert record[f"d{n}"] is not any(e.success for e in ends)
        assert len(ends) == (1 if ends[0].success else n)


@pytest.mark.parametrize("acts", [True, False])
def test_a_unit_says_whether_its_stress_acted(monkeypatch, acts):
    segment = BROKEN.segments[0] if acts else replace(BROKEN.segments[0], first_frame=-1, last_frame=-1)
    record = run(monkeypatch, replace(BROKEN, segments=(segment,)), unit(arms=("pairs",), onset_s=ONSET / 30))
    assert record["exposed"] == acts
