"""From the arms of a unit to the columns of its record: the declared and the audited outcome."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dslab.experiments.eq1.arms import BranchRun, Exposure, FreeArm
from dslab.experiments.eq1.mission import Fault, false_declarations, final_pose_faults, first_cause
from dslab.experiments.eq1.records import dual_column, failure_column, thread_column
from dslab.experiments.eq1.recovery_judging import Recovery, Reference, judge_recovery
from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Similarity, Undefined, align_poses
from dslab.experiments.evaluation.audit import LossAudit
from dslab.experiments.evaluation.audit_report import audit_loss_in, declaration_delay_s
from dslab.experiments.evaluation.breakages import BreakageOutcome, breakage_outcomes
from dslab.experiments.evaluation.declared_audit import audit_declared
from dslab.experiments.evaluation.summary import main_map_pairs
from dslab.experiments.runs.execution import RunRecord


def judge_free(arm: FreeArm, reference: Reference) -> dict[str, Any]:
    """The columns of base and dual and, after a breakage, of every recovery thread."""
    exposure = reference.exposure
    first, base_first = (first_exposed(record, exposure, reference.kind) for record in (arm.dual, arm.base))
    loss = true_loss(arm.dual, exposure, first)
    silent = None if loss is None else first is None and loss.true_loss_frame is not None
    row = {
        "breakage": first is not None,
        "silent_failure": silent,
        "base_breakage": base_first is not None,
        "base_failure": base_first is not None and base_first.relocalized is None,
        **accuracy_columns(arm.base, "base", exposure),
        **accuracy_columns(arm.dual, "dual", exposure),
        **declared_columns(arm.base, "base", ("loops", "relocalizations")),
        **declared_columns(arm.dual, "dual", ("loops", "relocalizations", "fusions", "joins")),
    }
    if base_first is not None:
        row["relocalized"] = base_first.relocalized is not None
    recovery = None
    if first is not None:
        breakage = first.breakage
        lost = loss.true_loss_frame if loss is not None else None
        recovery = judge_recovery("free", arm.dual.events, arm.first_frame_of, breakage.frame, reference)
        row |= {
            "breakage_frame": breakage.frame,
            "breakage_reason": breakage.reason,
            "declaration_delay_s": declaration_delay_s(reference.sequence.stamps_s, lost, breakage.frame),
            "reinit": recovery.reinit_frame is not None,
            "reinit_frame": recovery.reinit_frame,
            # The old map's last correct pose is that of the frame before the loss.
            "free_frames_to_cross": recovery.frames_from((breakage.frame if lost is None else lost) - 1),
            **recovery.columns,
        }
    failures = _dual_failures(arm, reference, first, recovery, silent_frame(loss, first is not None))
    return row | failures | _base_mission(arm, exposure, base_first)


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


def _dual_failures(
    arm: FreeArm,
    reference: Reference,
    broke: BreakageOutcome | None,
    recovery: Recovery | None,
    silent: int | None,
) -> dict[str, Any]:
    """D_J, S_J and M_J for the first 1 to n threads, and the first cause with all of them.

    The run is that of all threads. Where its first n have S_J, so has the mission; where not, the one of them
    that declared success first did so in the run as well.
    """
    numbers = range(1, reference.threads + 1)
    failed, declared = (
        [recovery is not None and recovery.columns[thread_column("free", j, name)] is True for j in numbers]
        for name in ("failed", "declared")
    )
    faults = audited_faults(arm.dual, reference.exposure, silent)
    threads, system = system_failures(broke is not None, failed, declared)
    row: dict[str, Any] = {}
    for n in numbers:
        row |= {
            dual_column(n): threads[n - 1],
            failure_column("s", n): system[n - 1],
            failure_column("m", n): system[n - 1] or bool(faults),
        }
    if broke is not None and row[failure_column("s", reference.threads)]:
        faults.append(Fault.declared(broke.breakage.frame, "dual_failure"))
    return row | {"mission_cause": first_cause(faults)}


def system_failures(
    broke: bool, failed: Sequence[bool], declared: Sequence[bool]
) -> tuple[list[bool], list[bool]]:
    """D_J and S_J for the first 1 to n threads.

    Args:
        broke: B.
        failed: of every thread.
        declared: of every thread, that it declared success.
    """
    threads, system = [], []
    for n in range(1, len(failed) + 1):
        first = next((j for j in range(n) if declared[j]), None)
        threads.append(broke and all(failed[:n]))
        system.append(broke and (first is None or failed[first]))
    return threads, system


def _base_mission(arm: FreeArm, exposure: Exposure, broke: BreakageOutcome | None) -> dict[str, Any]:
    loss = true_loss(arm.base, exposure, broke)
    faults = audited_faults(arm.base, exposure, silent_frame(loss, broke is not None))
    if broke is not None and broke.relocalized is None:
        faults.append(Fault.declared(broke.breakage.frame, "base_failure"))
    return {"base_mission_failure": bool(faults), "base_mission_cause": first_cause(faults)}


def audited_faults(record: RunRecord, exposure: Exposure, silent: int | None) -> list[Fault]:
    """All that only the truth shows: a silent failure, false declarations, a final pose out of bounds.

    Args:
        record: a run.
        exposure: the exposed segment.
        silent: frame of a true loss that was not declared; None for none.
    """
    faults = [*false_declarations(audit_declared(record)), *final_pose_faults(record, exposure)]
    return faults if silent is None else [*faults, Fault.audited(silent, "silent_failure")]


def silent_frame(loss: LossAudit | None, broke: bool) -> int | None:
    """Frame of the true loss if there was no breakage; None for none."""
    return None if loss is None or broke else loss.true_loss_frame


# -- of any run ----------------------------------------------------------------------------------------------


def first_exposed(record: RunRecord, exposure: Exposure, kind: str) -> BreakageOutcome | None:
    """The first breakage that was declared in the exposed segment, of this kind of degradation."""
    outcomes = breakage_outcomes(record.events, [exposure.as_segment(kind)], list(record.sequence.stamps_s))
    return next((o for o in outcomes if o.segment is not None), None)


def true_loss(record: RunRecord, exposure: Exposure, first: BreakageOutcome | None) -> LossAudit | None:
    """True loss of the pose, up to the declaration; None if it cannot be judged."""
    end = exposure.last_frame if first is None else first.breakage.frame
    audit = audit_loss_in(record, exposure.onset_frame, end)
    return None if isinstance(audit, Undefined) else audit


def accuracy_columns(record: RunRecord, name: str, exposure: Exposure) -> dict[str, Any]:
    """ATE and coverage of the largest map, end-point error of the map that holds the lead-in."""
    truth, pairs = record.sequence.T_world_cam, main_map_pairs(record)
    assert truth is not None
    figures = ("ate_m", "keyframe_ate_m", "end_error_m")
    row: dict[str, Any] = {f"{name}_{figure}": None for figure in figures}
    row |= {f"{name}_path_share": 0.0, f"{name}_share_tracked": 0.0}
    if pairs is None:
        return row
    main = record.trajectories[0]
    row[f"{name}_share_tracked"] = len(main.frames) / len(record.results)
    row[f"{name}_ate_m"] = _ate_m(pairs)
    keyframes = next((path for path in record.keyframes if path.map_id == main.map_id), None)
    if keyframes is not None:
        row[f"{name}_keyframe_ate_m"] = _ate_m(metrics.associate(keyframes, record.sequence.stamps_s, truth))
    share = metrics.coverage(pairs.frames, truth).share
    row[f"{name}_path_share"] = share if np.isfinite(share) else None
    row[f"{name}_end_error_m"] = _end_error_m(record, exposure)
    return row


def _ate_m(pairs: metrics.PosePairs) -> float | None:
    ate = metrics.ate(pairs)
    return None if isinstance(ate, Undefined) else ate.rmse_m


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
