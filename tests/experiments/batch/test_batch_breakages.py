"""What recoveries rescue: which breakages count, what each thread came to, whether images could."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from slam_fakes import fake_factory, make_sequence

from dslab.experiments.batch import breakages as of_batch
from dslab.experiments.batch.breakages import add_overlaps, breakages, rescues
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.evaluation.view_overlap import BestOverlap
from dslab.experiments.runs.execution import execute
from dslab.experiments.runs.files import to_json
from dslab.slam.core.events import RecoveryStart


def record(breaks_at=160, **script):
    sequence = make_sequence()
    return execute(sequence, "dual", 0, build=fake_factory(sequence, breaks_at=breaks_at, **script))


def listed(run):
    return summarise(run)["breakage_list"]


def test_a_breakage_says_the_state_of_its_map_and_the_end_of_each_thread():
    run = record()
    fused = next(e for e in run.events if e.kind == "fusion")
    start = RecoveryStart(
        frame=170, stamp_s=fused.stamp_s - 0.25, map_id=fused.new_map_id, thread=1, method="orb",
        old_map_id=fused.old_map_id, buffered_frames=9,
    )  # fmt: skip
    waited = replace(start, stamp_s=fused.stamp_s, thread=2)  # for the first thread's end
    (row,) = listed(replace(run, events=(*run.events, start, waited)))
    assert row["healthy"] and row["error_m"] < 1e-6 and row["bound_m"] >= 0.1
    assert row["false_fusion"] is False and row["to_fusion_s"] == pytest.approx(0.25)
    assert row["thread_1"] is True and row["thread_1_reason"] == ""
    (lost,) = listed(record(recovers=False))
    assert lost["healthy"] and not lost["recovered"] and lost["false_fusion"] is None
    (wrong,) = listed(record(new_map_scale=2.0))
    assert wrong["recovered"] and wrong["false_fusion"] is True
    (blind,) = listed(replace(run, sequence=replace(run.sequence, T_world_cam=None)))
    assert blind["recovered"] and blind["healthy"] is blind["false_fusion"] is None


def test_a_map_that_went_wrong_before_it_broke_is_not_healthy():
    right = record()
    live = dict(right.live)
    bent = live[0].T_map_cam.copy()
    last = np.flatnonzero(live[0].frames < 160)[-60:]
    bent[last, :3, 3] += np.sin(np.linspace(0, 9, 60))[:, None] * (0.0, 3.0, 3.0)
    live[0] = replace(live[0], T_map_cam=bent)
    (row,) = listed(replace(right, live=live))
    assert row["healthy"] is False and row["error_m"] > row["bound_m"]


def test_sums_are_of_healthy_maps_by_cause():
    row = {"source": "a", "dose": 0.5, "system": "dual", "segment": "fog", "healthy": True, "thread_2": None}
    none = {"recovered": False, "thread_1": None, "false_fusion": None, "to_fusion_s": None}
    right = {"recovered": True, "thread_1": True, "false_fusion": True, "to_fusion_s": 0.4}
    rows = [right, none, right | {"healthy": False, "to_fusion_s": 2}, none | {"healthy": None}]
    (found,) = rescues(pd.DataFrame([row | other for other in rows])).to_dict("records")
    assert found == {
        "source": "a", "dose": 0.5, "system": "dual", "cause": "fog", "views": "unknown", "breakages": 2,
        "recovered": 1, "thread_1": 1, "thread_2": 0, "false_fusion": 1, "to_fusion_s_median": 0.4,
        "to_fusion_s_p95": 0.4,
    }  # fmt: skip


def test_overlap_is_of_frames_without_stress_that_a_recovery_has(monkeypatch):
    """The stress of frames 150 to 180 broke the map at 160; a buffer of 2 s holds 60 frames."""
    asked = []

    def of(scenario, T_world_cam, before, after):
        asked.append((scenario, before.tolist(), after.tolist()))
        return BestOverlap(0.1, None)

    monkeypatch.setattr(of_batch, "best_overlap", of)
    run = replace(record(recovers=False), config={"dual": {"buffer_s": 2.0}})
    (row,) = found = listed(run)
    add_overlaps(run, found, "its scenario")
    assert asked == [("its scenario", list(range(90, 150)), list(range(181, 300)))]
    assert row["view_overlap"] == 0.1
    rows = [
        row | {"source": "a", "dose": None, "system": "dual", "view_overlap": share}
        for share in (0.1, 0.3, 0.5)
    ]
    sums = rescues(pd.DataFrame(rows))
    assert dict(zip(sums.views, sums.breakages, strict=True)) == {"hopeless": 1, "shared": 2}


def test_breakages_are_read_from_the_runs_that_have_any(tmp_path):
    for name, run in (("broken", record(recovers=False)), ("whole", record(breaks_at=None))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "summary.json").write_text(to_json(summarise(run)))
    about = {"source": "a", "dose": None, "system": "dual", "run": 0, "seed": 7}
    runs = [("broken", 1), ("whole", 0), ("died", None)]
    rows = pd.DataFrame([about | {"folder": name, "breakages": count} for name, count in runs])
    found = breakages(rows, tmp_path)
    assert found[["seed", "breakage", "frame"]].to_numpy().tolist() == [[7, 1, 160]]
    (sums,) = rescues(found).to_dict("records")
    assert (sums["breakages"], sums["recovered"]) == (1, 0) and np.isnan(sums["to_fusion_s_median"])
    assert rescues(breakages(rows[1:], tmp_path)).empty
