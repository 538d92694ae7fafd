"""From the arms of a unit to the columns of its record: the declared and the audited outcome."""

from typing import Any

import numpy as np

from experiments.eq1.arms import BranchRun, Exposure, FreeArm
from experiments.eq1.records import dual_column, thread_column
from experiments.eq1.recovery_judging import Reference, judge_recovery
from experiments.evaluation import metrics
from experiments.evaluation.alignment import Similarity, Undefined, align_poses
from experiments.evaluation.audit import LossAudit
from experiments.evaluation.audit_report import audit_loss_in, declaration_delay_s
from experiments.evaluation.breakages import BreakageOutcome, breakage_outcomes
from experiments.evaluation.declared_audit import audit_declared
from experiments.evaluation.summary import is_tracked, main_map_pairs, posed_frames
from experiments.runs.execution import RunRecord


def judge_free(arm: FreeArm, reference: Reference) -> dict[str, Any]:
    """The columns of base and dual and, after a breakage, of every recovery thread."""
    exposure, threads = reference.exposure, reference.threads
    base_first = _first_exposed(arm.base, reference)
    loss = _loss(arm.base, exposure, base_first)
    row = {
        "breakage": base_first is not None,
        "silent_failure": None if loss is None else base_first is None and loss.true_loss_frame is not None,
        "base_failure": not is_tracked(arm.base.results[-1]),
        "base_share_tracked": float(np.mean([is_tracked(r) for r in arm.base.results])),
        "dual_share_tracked": float(posed_frames(arm.dual).mean()),
        **_accuracy(arm.base, "base", exposure),
        **_accuracy(arm.dual, "dual", exposure),
        **declared_columns(arm.base, "base", ("loops", "relocalizations")),
        **declared_columns(arm.dual, "dual", ("loops", "relocalizations", "fusions", "joins")),
        **{dual_column(n): False for n in range(1, threads + 1)},
        "dual_failure": False,
    }
    dual_first = _first_exposed(arm.dual, reference)
    if base_first is None or dual_first is None:
        return row
    breakage = base_first.breakage
    lost = loss.true_loss_frame if loss is not None else None
    recovery = judge_recovery("free", arm.dual.events, arm.first_frame_of, breakage.frame, reference)
    row |= {
        "breakage_frame": breakage.frame,
        "breakage_reason": breakage.reason,
        "declaration_delay_s": declaration_delay_s(reference.sequence.stamps_s, lost, breakage.frame),
        "relocalized": base_first.relocalized is not None,
        "dual_relocalized": dual_first.relocalized is not None,
        "reinit": recovery.reinit_frame is not None,
        "reinit_frame": recovery.reinit_frame,
        # The old map's last correct pose is that of the frame before the loss.
        "free_frames_to_cross": recovery.frames_from((breakage.frame if lost is None else lost) - 1),
        **recovery.columns,
    }
    return row | _whole(recovery.columns, threads)


def judge_crossing(branch: BranchRun, reference: Reference) -> dict[str, Any]:
    """The columns of every recovery thread in the crossing arm."""
    exposure = reference.exposure
    recovery = judge_recovery(
        "cross", branch.system.events, branch.first_frame_of, exposure.end_frame, reference
    )
    return {
        "cross_reinit": recovery.reinit_frame is not None,
        "cross_reinit_frame": recovery.reinit_frame,
        "cross_frames_to_cross": recovery.frames_from(exposure.onset_frame),
        **recovery.columns,
    }


def declared_columns(record: RunRecord, name: str, kinds: tuple[str, ...]) -> dict[str, int]:
    """The columns of a run's false declarations.

    Args:
        record: of base or dual.
        name: of the system in the columns.
        kinds: of declarations that have a column: loops, relocalizations, fusions, joins.
    """
    audit = audit_declared(record)
    false = {f"{name}_false_{kind}": audit.false_counts[f"false_{kind}"] for kind in kinds}
    return {**false, f"{name}_unjudged": audit.unjudged}


def _whole(columns: dict[str, Any], threads: int) -> dict[str, Any]:
    """D_n for every n, and the failure of the system that stops at the first successful thread."""
    failed = [columns[thread_column("free", j, "failed")] for j in range(1, threads + 1)]
    declared = [columns[thread_column("free", j, "declared")] for j in range(1, threads + 1)]
    first = declared.index(True) if any(declared) else None
    row = {dual_column(n): all(failed[:n]) for n in range(1, threads + 1)}
    return row | {"dual_failure": True if first is None else failed[first]}


# -- base and dual -------------------------------------------------------------------------------------------


def _first_exposed(record: RunRecord, reference: Reference) -> BreakageOutcome | None:
    """The first breakage in the exposed segment."""
    segments = [reference.exposure.as_segment(reference.kind)]
    outcomes = breakage_outcomes(record.events, segments, list(record.sequence.stamps_s))
    return next((o for o in outcomes if o.segment is not None), None)


def _loss(record: RunRecord, exposure: Exposure, first: BreakageOutcome | None) -> LossAudit | None:
    """True loss of the pose, up to the declaration; None if it cannot be judged."""
    end = exposure.last_frame if first is None else first.breakage.frame
    audit = audit_loss_in(record, exposure.onset_frame, end)
    return None if isinstance(audit, Undefined) else audit


def _accuracy(record: RunRecord, name: str, exposure: Exposure) -> dict[str, Any]:
    """ATE and coverage of the largest map, end-point error of the map that holds the lead-in."""
    truth, pairs = record.sequence.T_world_cam, main_map_pairs(record)
    assert truth is not None
    row: dict[str, Any] = {f"{name}_ate_m": None, f"{name}_path_share": 0.0, f"{name}_end_error_m": None}
    if pairs is None:
        return row
    ate = metrics.ate(pairs)
    row[f"{name}_ate_m"] = None if isinstance(ate, Undefined) else ate.rmse_m
    share = metrics.coverage(pairs.frames, truth).share
    row[f"{name}_path_share"] = share if np.isfinite(share) else None
    row[f"{name}_end_error_m"] = _end_error_m(record, exposure)
    return row


def _end_error_m(record: RunRecord, exposure: Exposure) -> float | None:
    sequence, before = record.sequence, exposure.onset_frame - 1
    assert sequence.T_world_cam is not None
    holds = next((path for path in record.trajectories if before in path.frames), None)
    if holds is None:
        return None
    pairs = metrics.associate(holds, sequence.stamps_s, sequence.T_world_cam)
    lead_in = pairs.where(pairs.frames <= before)
    alignment = align_poses(lead_in.T_map_cam, lead_in.T_world_cam)
    if not isinstance(alignment, Similarity):
        return None
    last = pairs.where(pairs.frames == pairs.frames[-1])
    return float(metrics.position_errors_m(last, alignment)[0])
