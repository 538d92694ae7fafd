"""The arms of Dual-SLAM over any system: its recoveries judged as those of ours are."""

from typing import Any

from dslab.experiments.eq1.arms import lead_in_fault
from dslab.experiments.eq1.branch_run import BranchRun
from dslab.experiments.eq1.recovery_judging import Reference, judge_recovery
from dslab.experiments.eq1.units import Exposure
from dslab.experiments.runs.execution import RunRecord, SystemFactory, slam_camera
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import Event, RecoveryEnd, RecoveryStart, ReinitDone
from dslab.slam.core.results import MapTrajectory
from dslab.slam.framework.dual_of import DualOf


def judge_free_recovery(
    record: RunRecord, lead_in: MapTrajectory, row: dict[str, Any], exposure: Exposure, threads: int
) -> dict[str, Any]:
    """The columns of the recovery after the breakage of a unit; none without one.

    Args:
        record: of the whole unit.
        lead_in: poses of the lead-in in its map.
        row: of the unit so far.
        exposure: the exposed segment.
        threads: number of recovery threads that are judged.
    """
    if not row["breakage"] or row["breakage_frame"] is None:
        return {}
    at = row["breakage_frame"]
    reference = Reference(record.sequence, exposure, lead_in, threads)
    events = [event for event in record.events if event.frame >= at]
    return judge_recovery("free", events, _first_new_frame(events), at, at - 1, reference)


def judge_dual_crossing(
    build: SystemFactory, sequence: Sequence, exposure: Exposure, seed: int, threads: int
) -> dict[str, Any]:
    """The columns of the crossing arm: the map is saved at the onset, and a new one begun behind the segment.

    The run ends with the first recovery, all of whose threads that are to run have run.

    Args:
        build: makes the system.
        sequence: the frames.
        exposure: the exposed segment.
        seed: of the system.
        threads: number of recovery threads that are judged.

    Raises:
        ValueError: the lead-in leaves no healthy map; it does in the free arm, whose frames are the same.
    """
    system = build("", slam_camera(sequence.camera), seed)
    assert isinstance(system, DualOf)
    branch: Any = BranchRun(system, sequence)  # type: ignore[arg-type]
    branch.feed(exposure.onset_frame)
    fault = lead_in_fault(branch.results, system.events, sequence, exposure.onset_frame)
    if fault:
        raise ValueError(fault)
    lead_in = system.trajectories()[0]
    system.cut()
    branch.feed(exposure.end_frame + 1)
    system.restart()
    while not (branch.at_end or any(isinstance(event, RecoveryEnd) for event in system.events)):
        branch.step()
    system.finish()
    reference = Reference(sequence, exposure, lead_in, threads)
    first, onset = _first_new_frame(system.events), exposure.onset_frame
    return judge_recovery("cross", system.events, first, exposure.end_frame, onset, reference)


def _first_new_frame(events: list[Event]) -> int | None:
    """First frame of the new map from which the first recovery started."""
    start = next((e for e in events if isinstance(e, RecoveryStart)), None)
    if start is None:
        return None
    begun = [e.frame for e in events if isinstance(e, ReinitDone) and e.map_id == start.map_id]
    return begun[0] if begun else None
