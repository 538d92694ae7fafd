"""The lead-in of a unit: run once for all cells of a replicate, and checked to leave a healthy map.

Whatever a lead-in depends on is in its key: a unit's record is the same with or without an earlier one.
"""

import hashlib
from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from typing import Any

from dslab.experiments.eq1.arms import CpuClock, Exposure, SavedBranch, run_lead_in
from dslab.experiments.eq1.units import UnitSpec, content_hash
from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Undefined, align_poses
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.runs.execution import live_trajectories, slam_camera
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import Breakage, Event
from dslab.slam.core.results import MapTrajectory, TrackingResult

LEAD_IN_HEALTHY_S = 1.0
"""Time before the exposed segment for which the map must have been tracked without a gap."""
LEAD_IN_ERROR_SHARE = 0.05
"""Largest position error (RMS) on the lead-in, as a share of its path, of a healthy map."""
KEPT = 2
"""Lead-ins that are kept: that of the system, and that of a plain one beside it."""


@dataclass(frozen=True)
class LeadIn:
    """A lead-in that was run.

    Attributes:
        branch: its end, from which arms resume; None if the map is not healthy there.
        path: poses of the lead-in in its map.
        fault: reason why the map is not healthy; empty if it is.
    """

    branch: SavedBranch | None
    path: MapTrajectory | None
    fault: str


_kept: dict[str, LeadIn] = {}


def lead_in_of(
    unit: UnitSpec, sequence: Sequence, exposure: Exposure, clock: CpuClock, system: str | None = None
) -> LeadIn:
    """The lead-in of a unit, run now unless that of the same replicate in another cell is at hand.

    Args:
        unit: its spec.
        sequence: its frames.
        exposure: the exposed segment.
        clock: sums the CPU time.
        system: None for the unit's own.
    """
    system = system or unit.system
    key = lead_in_key(unit, sequence, exposure, system)
    found = _kept.pop(key, None) or _run(unit, sequence, exposure, clock, system)
    _kept[key] = found
    while len(_kept) > KEPT:
        del _kept[next(iter(_kept))]
    if found.branch is None:
        return found
    return replace(found, branch=replace(found.branch, sequence=sequence, clock=clock))


def _run(unit: UnitSpec, sequence: Sequence, exposure: Exposure, clock: CpuClock, kind: str) -> LeadIn:
    branch = run_lead_in(unit, sequence, exposure, clock, kind)
    system = branch.system
    fault = lead_in_fault(branch.results, system.events, sequence, exposure.onset_frame)
    keyframes = len(system.current_map.keyframes()) if fault is None else 0
    if fault is None and keyframes <= system.config.min_map_keyframes:
        fault = f"{keyframes} keyframes only at the onset: a breakage would drop the map"
    if fault is not None:
        return LeadIn(None, None, fault)
    current = system.current_map_id
    path = next(path for path in system.trajectories() if path.map_id == current)
    return LeadIn(branch.save(), path, "")


def lead_in_key(unit: UnitSpec, sequence: Sequence, exposure: Exposure, system: str) -> str:
    """Hash of all that a lead-in depends on: its frames, their times and truth, the system and its seed."""
    onset = exposure.onset_frame
    images = hashlib.sha256()
    for frame in range(onset):
        images.update(sequence.frames[frame])
    truth = None if sequence.T_world_cam is None else sequence.T_world_cam[:onset].tobytes().hex()
    told: dict[str, Any] = {
        "images": images.hexdigest(),
        "stamps_s": sequence.stamps_s[:onset].tolist(),
        "truth": truth,
        "camera": repr(slam_camera(sequence.camera)),
        "system": system,
        "seed": unit.repeat_seed,
        "settings": unit.settings,
        "threads": [thread.model_dump(mode="json") for thread in unit.threads],
    }
    return content_hash(told)


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
