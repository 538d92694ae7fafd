"""Check that the map is healthy at the start of the exposed segment."""

from collections.abc import Sequence as Many

from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Undefined, align_poses
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.runs.execution import live_trajectories
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import Breakage, Event
from dslab.slam.core.results import MapTrajectory, TrackingResult

LEAD_IN_HEALTHY_S = 1.0
"""Time before the exposed segment for which the map must have been tracked without a gap."""
LEAD_IN_ERROR_SHARE = 0.05
"""Largest position error (RMS) on the lead-in, as a share of its path, of a healthy map."""


def lead_in_fault(
    results: Many[TrackingResult], events: Many[Event], sequence: Sequence, onset: int
) -> str | None:
    """Reason why the map is not healthy at the onset; None if it is healthy.

    Args:
        results: of the frames before the onset at least.
        events: of the same run.
        sequence: the input of the run.
        onset: first frame of the exposed segment.
    """
    before = results[onset - 1]
    if not is_tracked(before):
        return "not tracking at the onset"
    if any(isinstance(e, Breakage) and e.frame < onset for e in events):
        return "broke in the lead-in"
    live = live_trajectories(results[:onset])[before.map_id]
    lead_s = before.stamp_s - live.stamps_s[0]
    if lead_s < LEAD_IN_HEALTHY_S:
        return f"tracked for {lead_s:.2f} s only before the onset"
    return _error(live, sequence)


def _error(live: MapTrajectory, sequence: Sequence) -> str | None:
    truth = sequence.T_world_cam
    if truth is None:
        return "no ground truth"
    pairs = metrics.associate(live, sequence.stamps_s, truth)
    path_m = metrics.coverage(pairs.frames, truth).path_m
    alignment = align_poses(pairs.T_map_cam, pairs.T_world_cam)
    if isinstance(alignment, Undefined):
        return f"the lead-in cannot be judged: {alignment.reason}"
    error_m = metrics.rms(metrics.position_errors_m(pairs, alignment))
    if error_m > LEAD_IN_ERROR_SHARE * path_m:
        return f"position error {error_m:.3f} m on {path_m:.2f} m of lead-in"
    return None
