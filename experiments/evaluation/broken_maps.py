"""A map that broke: was it right until then, what did each thread come to, is its fusion false."""

import numpy as np

from dslab.experiments.evaluation.alignment import Undefined, align_poses
from dslab.experiments.evaluation.breakages import BreakageOutcome
from dslab.experiments.evaluation.metrics import Truth, path_length_m, position_errors_m, rms
from dslab.experiments.runs.execution import RunRecord
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import RecoveryStart

_BEFORE_S, _LEAST_POSES = 5.0, 15
_LEAST_BOUND_M, _BOUND_SHARE = 0.1, 0.05  # of the path in that time


def breakage_figures(record: RunRecord, outcome: BreakageOutcome, audit: dict | None) -> dict:
    """Figures of a breakage beside its events.

    Args:
        record: of a run.
        outcome: of the breakage.
        audit: of the run's summary; None without truth.

    Returns:
        ``healthy``: the map's live poses of the last 5 s lie within ``bound_m`` (0.1 m, or 5 % of the path),
        after a similarity, ``error_m`` off; ``false_fusion``; ``to_fusion_s`` from the recovery's start, at
        the new map's fifth keyframe; ``thread_<k>``, whether it succeeded, and ``thread_<k>_reason``. None
        where undetermined.
    """
    before = _error_before(record, outcome)
    error_m, bound_m = before or (None, None)
    fusion = outcome.fusion if outcome.recovered else None
    false = since_s = None
    if fusion is not None:
        of, maps = (
            (fusion.frame, fusion.old_map_id, fusion.new_map_id),
            (fusion.old_map_id, fusion.new_map_id),
        )
        if audit is not None:
            judged = {(f["frame"], f["old_map_id"], f["new_map_id"]): f["false"] for f in audit["fusions"]}
            false = judged[of]
        starts = [e for e in record.events if isinstance(e, RecoveryStart) and e.frame <= fusion.frame]
        times_s = [fusion.stamp_s - e.stamp_s for e in starts if (e.old_map_id, e.map_id) == maps]
        since_s = max(times_s, default=None)
    ends = {end.thread: end for end in outcome.recoveries}
    return {
        "error_m": error_m,
        "bound_m": bound_m,
        "healthy": None if before is None else before[0] <= before[1],
        "false_fusion": false,
        "to_fusion_s": since_s,
        **{f"thread_{k}": end.success for k, end in ends.items()},
        **{f"thread_{k}_reason": f"{end.stage}: {end.reason}".strip(": ") for k, end in ends.items()},
    }


def usable_frames(
    sequence: Sequence, first: int, segment: int | None, buffer_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Frames on which no stress acts, before and after what broke the map.

    Before: as many as a recovery's buffer holds. Without a stress the two sides meet at the breakage.

    Args:
        sequence: its frames, with segments.
        first: frame of the breakage.
        segment: index of the segment that it counts for, None for none.
        buffer_s: span of the frames before a breakage that a recovery has.
    """
    frames, stamps_s, last = np.arange(len(sequence)), np.asarray(sequence.stamps_s), first - 1
    acts = np.zeros(len(sequence), bool)
    for acting in sequence.segments:
        acts |= acting.mask(len(sequence))
    if segment is not None:
        first, last = sequence.segments[segment].first_frame, sequence.segments[segment].last_frame
    before = (frames < first) & (stamps_s >= stamps_s[first] - buffer_s) & ~acts
    return frames[before], frames[(frames > last) & ~acts]


def _error_before(record: RunRecord, outcome: BreakageOutcome) -> tuple[float, float] | None:
    """Error of the broken map's live poses in the last seconds, and its bound, m; None if too few."""
    broke, live = outcome.breakage, record.live.get(outcome.breakage.map_id)
    if live is None or record.sequence.T_world_cam is None:
        return None
    truth = Truth.of(record.sequence)
    recent = (live.frames < broke.frame) & (truth.stamps_s[live.frames] >= broke.stamp_s - _BEFORE_S)
    pairs = truth.pairs(live.where(recent))
    if len(pairs) < _LEAST_POSES:
        return None
    aligned = align_poses(pairs.T_map_cam, pairs.T_world_cam)
    if isinstance(aligned, Undefined):
        return None
    path_m = path_length_m(truth.T_world_cam[pairs.frames[0] : pairs.frames[-1] + 1])
    return rms(position_errors_m(pairs, aligned)), max(_LEAST_BOUND_M, _BOUND_SHARE * path_m)
