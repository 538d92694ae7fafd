"""Lead-ins of this process: all cells of a replicate run from one snapshot.

Whatever a lead-in depends on is in its key: a unit's record is the same with or without an earlier one.
"""

import hashlib
from dataclasses import dataclass, replace
from typing import Any

from dslab.experiments.eq1.arms import CpuClock, Exposure, SavedBranch, run_lead_in
from dslab.experiments.eq1.lead_in import lead_in_fault
from dslab.experiments.eq1.units import UnitSpec, content_hash
from dslab.experiments.runs.execution import slam_camera
from dslab.sim.sequence import Sequence
from dslab.slam.core.results import MapTrajectory

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
