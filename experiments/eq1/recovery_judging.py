"""Outcome of the recovery threads of a unit, as declared and as audited."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dslab.experiments.eq1.records import thread_column
from dslab.experiments.eq1.units import Exposure
from dslab.experiments.evaluation.audit import FusionAudit, audit_relation
from dslab.sim.sequence import Sequence as ImageSequence
from dslab.slam.core.events import Event, Fusion, MapDropped, RecoveryEnd, RecoveryStart, ReinitDone
from dslab.slam.core.results import MapTrajectory

Arm = Literal["free", "cross"]


@dataclass(frozen=True)
class Reference:
    """Reference by which the arms of a unit are judged.

    Attributes:
        sequence: images with their truth.
        exposure: the exposed segment.
        lead_in: poses of the lead-in in its map at the onset.
        threads: number of recovery threads.
    """

    sequence: ImageSequence
    exposure: Exposure
    lead_in: MapTrajectory
    threads: int


def judge_recovery(
    arm: Arm, events: Sequence[Event], first_frame: int | None, since: int, after: int, reference: Reference
) -> dict[str, Any]:
    """The columns of the first recovery of the saved map, and of each of its threads.

    Args:
        arm: the arm of the run.
        events: all events of the system.
        first_frame: of the new map from which the first recovery started; None if none did.
        since: frame after which a new map was attempted.
        after: frame from which those to cross are counted.
        reference: truth and lead-in.
    """
    reinit = next((e.frame for e in events if isinstance(e, ReinitDone) and e.frame > since), None)
    attempt = next((e.map_id for e in events if isinstance(e, RecoveryStart)), None)
    prefix = "" if arm == "free" else "cross_"
    columns: dict[str, Any] = {
        f"{prefix}reinit": reinit is not None,
        f"{prefix}reinit_frame": reinit,
        f"{arm}_frames_to_cross": None if first_frame is None else first_frame - after,
    }
    if attempt is None:
        reason = _why_no_recovery(events, reinit)
        none = {"failed": True, "declared": False, "stage": "no_reinit", "reason": reason}
        each = range(1, reference.threads + 1)
        return columns | {thread_column(arm, j, name): value for j in each for name, value in none.items()}
    for end in _ends(events, attempt):
        judged = _thread(end, _audit(end, reference), _refused(events, end))
        columns |= {thread_column(arm, end.thread, name): value for name, value in judged.items()}
    return columns


def _audit(end: RecoveryEnd, reference: Reference) -> FusionAudit | None:
    truth = reference.sequence.T_world_cam
    if not end.placed or truth is None:
        return None
    placed = MapTrajectory(
        end.old_map_id,
        np.array([k.frame for k in end.placed]),
        np.array([k.stamp_s for k in end.placed]),
        np.array([k.T_old_cam for k in end.placed]),
    )
    onset = reference.exposure.onset_frame
    return audit_relation(reference.lead_in, placed, reference.sequence.stamps_s, truth, onset)


def _ends(events: Sequence[Event], attempt: int) -> list[RecoveryEnd]:
    ends: dict[int, RecoveryEnd] = {}
    for event in events:
        if isinstance(event, RecoveryEnd) and event.map_id == attempt and event.stage != "cancelled":
            ends.setdefault(event.thread, event)
    return list(ends.values())


def _thread(end: RecoveryEnd, audit: FusionAudit | None, refused: str) -> dict[str, Any]:
    declared = end.success and not refused
    false = audit.false if audit is not None and declared else None
    stage, reason = end.stage, end.reason
    if refused:
        stage, reason = "fusion", refused
    elif false and audit is not None:
        stage, reason = "audit", _off(audit)
    return {
        "failed": not declared or false is True,
        "declared": declared,
        "false": false,
        "stage": stage or None,
        "reason": reason or None,
        "frames_covered": end.frames_covered,
        "scale_error": audit.scale_error if audit is not None else None,
        "seam_error_m": audit.seam_error_m if audit is not None else None,
        "cpu_ms": end.cpu_ms,
        "inliers": end.inliers,
    }


def _off(audit: FusionAudit) -> str:
    parts = []
    if audit.scale_error is not None:
        parts.append(f"scale {audit.scale_error:+.3f}")
    if audit.seam_error_m is not None:
        parts.append(f"seam {audit.seam_error_m:.2f} m, {audit.seam_rotation_deg:.1f} deg")
    return ", ".join(parts)


def _refused(events: Sequence[Event], end: RecoveryEnd) -> str:
    """Reason why the thread's fusion was rejected; empty if it was not, or if there was no fusion."""
    refusals = [
        e.reason
        for e in events
        if isinstance(e, Fusion) and not e.accepted and (e.frame, e.new_map_id) == (end.frame, end.map_id)
    ]
    return refusals[0] if refusals and end.success else ""


def _why_no_recovery(events: Sequence[Event], reinit: int | None) -> str:
    if any(isinstance(e, MapDropped) and e.reason == "too_few_keyframes" for e in events):
        return "map_dropped"
    return "no_new_map" if reinit is None else "new_map_not_fit"
