"""Hold-ups by fusions, and frames dropped beside recoveries, of made-up records."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from dslab.experiments.benchmarks.tracker import fusion_figures
from dslab.slam.core.events import Fusion, RecoveryEnd, RecoveryStart

FED = [0, 1, 2, 3, 5, 6, 9, 10, 11]  # three frames were dropped


def event(kind, frame, **fields):
    """An event of map 1; fields that do not matter are None."""
    names = [field.name for field in dataclasses.fields(kind) if field.init and field.name != "relation"]
    return kind(**{**dict.fromkeys(names), "frame": frame, "map_id": 1, **fields})


def record(events, fusion_ms=None):
    results = [SimpleNamespace(ms={"other": 50.0}) for _ in FED]
    for frame, ms in (fusion_ms or {}).items():
        results[frame].ms["fusion"] = ms
    sequence = SimpleNamespace(stamps_s=np.array(FED) / 30.0)
    return SimpleNamespace(results=results, events=events, sequence=sequence)


def test_the_longest_hold_up_of_all_runs_counts():
    fused = event(Fusion, 5, accepted=True, new_map_id=1)
    refused = event(Fusion, 7, accepted=False, new_map_id=1)
    found = fusion_figures([record([fused], {5: 3.0}), record([fused, refused], {5: 7.0, 7: 1.0})])
    assert (found["count"], found["hold_up_ms_max"]) == (2, pytest.approx(7.0))
    assert fusion_figures([record([])])["hold_up_ms_max"] is None


@pytest.mark.parametrize(
    ("events", "beside", "dropped"),
    [
        ([], 0, 0),
        ([event(RecoveryStart, 1), event(RecoveryEnd, 4)], 4, 1),
        # The fusion comes later than the end of its recovery, and the frame dropped after it is its own.
        (
            [event(RecoveryStart, 1), event(RecoveryEnd, 4), event(Fusion, 5, accepted=True, new_map_id=1)],
            5,
            3,
        ),
        ([event(Fusion, 5, accepted=True, new_map_id=1)], 1, 2),
    ],
)
def test_dropped_frames_are_told_apart_by_what_ran_beside(events, beside, dropped):
    found = fusion_figures([record(events)])
    assert (found["beside_frames"], found["beside_dropped"]) == (beside, dropped)
    assert (found["other_frames"], found["other_dropped"]) == (len(FED) - beside, 3 - dropped)
