"""Mission failure M_J: what a user of the system gets, and what went wrong first.

A mission fails by the failure of Dual-SLAM (S_J), a silent failure, a false loop, relocalization or accepted
fusion, or a final pose out of the bounds of the fusion audit.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dslab.experiments.eq1.arms import Exposure
from dslab.experiments.evaluation.audit import RELATION_BOUNDS, audit_relation
from dslab.experiments.evaluation.declared_audit import DeclaredAudit
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.results import MapTrajectory

FINAL_S = 1.0
"""Time before the last pose over which the final pose is judged."""
_DECLARED, _AUDITED = 0, 1


@dataclass(frozen=True, order=True)
class Fault:
    """One cause of a failed mission; the least of several is the first.

    Attributes:
        frame: at which it began.
        rank: of two at one frame, what the system declared comes first.
        cause: its name.
    """

    frame: int
    rank: int
    cause: str

    @classmethod
    def declared(cls, frame: int, cause: str) -> "Fault":
        """A fault that the system declared itself."""
        return cls(frame, _DECLARED, cause)

    @classmethod
    def audited(cls, frame: int, cause: str) -> "Fault":
        """A fault that only the truth shows."""
        return cls(frame, _AUDITED, cause)


def first_cause(faults: Iterable[Fault]) -> str | None:
    """Name of the first of the faults; None for none."""
    first = min(faults, default=None)
    return None if first is None else first.cause


def false_declarations(audit: DeclaredAudit) -> list[Fault]:
    """Loops, relocalizations and fusions that are false by the audit."""
    related = (("false_loop", audit.loops), ("false_fusion", (*audit.fusions, *audit.joins)))
    found = [(f.event.frame, cause) for cause, findings in related for f in findings if f.audit.false is True]
    found += [(f.event.frame, "false_relocalization") for f in audit.relocalizations if f.false is True]
    return [Fault.audited(frame, cause) for frame, cause in found]


def final_pose_faults(record: RunRecord, exposure: Exposure) -> list[Fault]:
    """The final pose, if scale or place of the map that holds the lead-in are out of bounds at its end.

    Scale is judged over all poses after the exposed segment, the place over the last second of them. A map
    without a pose after the segment has no final pose to judge.
    """
    truth, stamps_s = record.sequence.T_world_cam, record.sequence.stamps_s
    holds = next((path for path in record.trajectories if exposure.onset_frame - 1 in path.frames), None)
    if holds is None or truth is None or holds.frames[-1] <= exposure.end_frame:
        return []
    last = stamps_s[holds.frames[-1]]
    tail = _part(holds, holds.frames > exposure.end_frame)
    end = _part(tail, stamps_s[tail.frames] > last - FINAL_S)
    scale, place = (
        audit_relation(holds, part, stamps_s, truth, exposure.onset_frame) for part in (tail, end)
    )
    bounds = RELATION_BOUNDS
    off = (
        abs(scale.scale_error or 0.0) > bounds.scale_share
        or (place.seam_error_m or 0.0) > (place.seam_bound_m or np.inf)
        or (place.seam_rotation_deg or 0.0) > bounds.rotation_deg
    )
    return [Fault.audited(int(holds.frames[-1]), "final_pose")] if off else []


def _part(path: MapTrajectory, kept: np.ndarray) -> MapTrajectory:
    return MapTrajectory(path.map_id, path.frames[kept], path.stamps_s[kept], path.T_map_cam[kept])
