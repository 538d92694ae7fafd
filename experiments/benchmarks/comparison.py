"""Comparison with a peer: the same figures of both systems, from the same code, and their ratios."""

from collections.abc import Sequence as Many
from typing import Any

import numpy as np

from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.runs.execution import RunRecord
from dslab.sim.sequence import Sequence
from dslab.slam.core.results import MapTrajectory

FIGURES = ("cpu_ms_median", "ate_m", "share_tracked", "share_with_pose", "first_tracked_frame")


def compare(sequence: Sequence, ours: Many[RunRecord], peers: Many[RunRecord]) -> dict[str, Any]:
    """Medians over the runs of both, their ratios, and every run.

    Args:
        sequence: all frames, including dropped ones; shares refer to these.
        ours, peers: runs in the order they were made.

    Returns:
        ``ours``, ``peer`` and ``ratio`` (ours over the peer's), each with ``FIGURES``, null if undetermined;
        ``ate_reasons``, the reasons for a missing ATE; ``runs``, one row each, in turn. ``share_tracked``
        counts the frames with a live pose, ``share_with_pose`` those with a pose in the final trajectory of
        the main map: frames before the map may get one afterwards, frames of other maps have none.
    """
    rows = [
        {"run": number, "system": name, **row}
        for number, (record, peer) in enumerate(zip(ours, peers, strict=True))
        for name, row in (("ours", _row(record, sequence)), ("peer", _row(peer, sequence)))
    ]
    medians = {
        name: {figure: _median([r[figure] for r in rows if r["system"] == name]) for figure in FIGURES}
        for name in ("ours", "peer")
    }
    ratio = {figure: _ratio(medians["ours"][figure], medians["peer"][figure]) for figure in FIGURES}
    reasons = sorted({r["ate_reason"] for r in rows if r["ate_reason"]})
    return {**medians, "ratio": ratio, "ate_reasons": reasons, "runs": rows}


def _row(record: RunRecord, all_frames: Sequence) -> dict[str, Any]:
    tracked = [r.stamp_s for r in record.results if is_tracked(r)]
    first = int(np.searchsorted(all_frames.stamps_s, tracked[0])) if tracked else None
    path = record.trajectories[0] if record.trajectories else None
    ate_m, reason = _ate(path, record.sequence)
    return {
        "cpu_ms_median": _median([sum(r.cpu_ms.values()) for r in record.results if r.cpu_ms]),
        "ate_m": ate_m,
        "ate_reason": reason,
        "share_tracked": len(tracked) / len(all_frames),
        "share_with_pose": _share_with_pose(path, all_frames),
        "first_tracked_frame": first,
        "dropped_frames": record.dropped_frames,
    }


def _share_with_pose(trajectory: MapTrajectory | None, all_frames: Sequence) -> float:
    return len(trajectory.frames) / len(all_frames) if trajectory is not None else 0.0


def _ate(trajectory: MapTrajectory | None, sequence: Sequence) -> tuple[float | None, str]:
    """RMSE after Sim(3) alignment, metres, or the reason why there is none."""
    if sequence.T_world_cam is None:
        return None, "no ground truth"
    if trajectory is None:
        return None, "no map"
    ate = metrics.ate(metrics.associate(trajectory, sequence.stamps_s, sequence.T_world_cam))
    return (None, ate.reason) if isinstance(ate, Undefined) else (ate.rmse_m, "")


def _median(values: Many[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def _ratio(ours: float | None, peer: float | None) -> float | None:
    return ours / peer if ours is not None and peer else None
