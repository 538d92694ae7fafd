"""From the runs of a unit to the columns of its record: what they declare, held against the truth.

Mission failure M_J is what a user of the system gets: the failure of Dual-SLAM (S_J), a silent failure, a
false loop, relocalization or accepted fusion, or a final pose out of the bounds of the fusion audit.

The terms of a system without recovery threads are those of Dual-SLAM. B is the system's own word where it
declares losses, or that its run has ended; where it declares nothing, B is true loss by the audit. S is B
without coming back: by its own word where it declares what becomes of a loss, else by the truth.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dslab.experiments.eq1.arms import FreeArm
from dslab.experiments.eq1.branch_run import BranchRun
from dslab.experiments.eq1.records import dual_column, failure_column, thread_column
from dslab.experiments.eq1.recovery_judging import Reference, judge_recovery
from dslab.experiments.eq1.units import Exposure
from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Similarity, Undefined, align_poses
from dslab.experiments.evaluation.audit import RELATION_BOUNDS, audit_relation
from dslab.experiments.evaluation.audit_report import audit_loss_in, declaration_delay_s
from dslab.experiments.evaluation.breakages import BreakageOutcome, breakage_outcomes
from dslab.experiments.evaluation.declared_audit import DeclaredAudit, audit_declared
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.runs.ending import Declares, EndKind
from dslab.experiments.runs.execution import RunRecord
from dslab.sim.sequence import SegmentTruth
from dslab.slam.core.results import MapTrajectory

FINAL_S = 1.0
"""Time before the last pose over which the final pose is judged."""
NO_POSE, WRONG_POSE = "no_pose", "wrong_pose"
"""Reasons of a true loss that is not declared: it gives no poses, or wrong ones."""
DECLARED, AUDITED = 0, 1
"""Ranks of faults."""
_COUNTED = {
    "base": ("loops", "relocalizations"),
    "dual": ("loops", "relocalizations", "fusions", "joins"),
}
"""Declarations whose false ones have a column."""


class Fault(NamedTuple):
    """One cause of a failed mission; the least of several is the first.

    Attributes:
        frame: at which it began.
        rank: of two at one frame, what the system declared comes before what only the truth shows.
        cause: its name.
    """

    frame: int
    rank: int
    cause: str


def first_cause(faults: Iterable[Fault]) -> str | None:
    """Name of the first of the faults; None for none."""
    first = min(faults, default=None)
    return None if first is None else first.cause


# -- one run -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class JudgedRun:
    """A run, held against the truth.

    Attributes:
        broke: the first breakage declared in the exposed segment; None for none.
        is_judged: whether the pose was truly lost could be judged.
        lost: frame of the true loss, up to the declaration; None for none.
        faults: all that only the truth shows, except a loss that was not declared.
        columns: its accuracy and its false declarations.
    """

    broke: BreakageOutcome | None
    is_judged: bool
    lost: int | None
    faults: list[Fault]
    columns: dict[str, Any]

    def mission_faults(self, broke: bool) -> list[Fault]:
        """All that only the truth shows; ``broke``: there was a breakage, so no loss was silent."""
        silent = [] if broke or self.lost is None else [Fault(self.lost, AUDITED, "silent_failure")]
        return self.faults + silent


def judge_run(record: RunRecord, name: str, exposure: Exposure) -> JudgedRun:
    """Judge a whole run.

    Args:
        record: over a sequence with truth.
        name: of the system in the columns, ``base`` or ``dual``.
        exposure: the exposed segment.
    """
    stamps_s = record.sequence.stamps_s.tolist()
    segment = SegmentTruth("", {}, 0.0, 0.0, exposure.onset_frame, exposure.end_frame)
    outcomes = breakage_outcomes(record.events, [segment], stamps_s)
    broke = next((outcome for outcome in outcomes if outcome.segment is not None), None)
    end = exposure.last_frame if broke is None else broke.breakage.frame
    loss = audit_loss_in(record, exposure.onset_frame, end)
    declared = audit_declared(record)
    false = {f"{name}_false_{kind}": declared.false_counts[f"false_{kind}"] for kind in _COUNTED[name]}
    columns = {**_accuracy(record, name, exposure), **false, f"{name}_unjudged": declared.unjudged}
    faults = [*false_declarations(declared), *final_pose_faults(record, exposure)]
    if isinstance(loss, Undefined):
        return JudgedRun(broke, False, None, faults, columns)
    return JudgedRun(broke, True, loss.true_loss_frame, faults, columns)


def _accuracy(record: RunRecord, name: str, exposure: Exposure) -> dict[str, Any]:
    """ATE and coverage of the largest map, end-point error of the map that holds the lead-in."""
    truth, stamps_s = record.sequence.T_world_cam, record.sequence.stamps_s
    assert truth is not None
    figures = ("ate_m", "keyframe_ate_m", "end_error_m")
    row: dict[str, Any] = {f"{name}_{figure}": None for figure in figures}
    row |= {f"{name}_path_share": 0.0, f"{name}_share_tracked": 0.0}
    if not record.trajectories:
        return row
    main = record.trajectories[0]
    pairs = metrics.associate(main, stamps_s, truth)
    row[f"{name}_share_tracked"] = len(main.frames) / len(record.results)
    row[f"{name}_ate_m"] = _ate_m(pairs)
    keyframes = next((path for path in record.keyframes if path.map_id == main.map_id), None)
    if keyframes is not None:
        row[f"{name}_keyframe_ate_m"] = _ate_m(metrics.associate(keyframes, stamps_s, truth))
    share = metrics.coverage(pairs.frames, truth).share
    row[f"{name}_path_share"] = share if np.isfinite(share) else None
    holds = _holds_lead_in(record, exposure)
    if holds is not None:
        pairs = metrics.associate(holds, stamps_s, truth)
        lead_in = pairs.where(pairs.frames < exposure.onset_frame)
        alignment = align_poses(lead_in.T_map_cam, lead_in.T_world_cam)
        if isinstance(alignment, Similarity):
            last = pairs.where(pairs.frames == pairs.frames[-1])
            row[f"{name}_end_error_m"] = float(metrics.position_errors_m(last, alignment)[0])
    return row


def _ate_m(pairs: metrics.PosePairs) -> float | None:
    ate = metrics.ate(pairs)
    return None if isinstance(ate, Undefined) else ate.rmse_m


def _holds_lead_in(record: RunRecord, exposure: Exposure) -> MapTrajectory | None:
    return next((path for path in record.trajectories if exposure.onset_frame - 1 in path.frames), None)


def false_declarations(audit: DeclaredAudit) -> list[Fault]:
    """Loops, relocalizations and fusions that are false by the audit."""
    related = (("false_loop", audit.loops), ("false_fusion", (*audit.fusions, *audit.joins)))
    found = [(f.event.frame, cause) for cause, findings in related for f in findings if f.audit.false is True]
    found += [(f.event.frame, "false_relocalization") for f in audit.relocalizations if f.false is True]
    return [Fault(frame, AUDITED, cause) for frame, cause in found]


def final_pose_faults(record: RunRecord, exposure: Exposure) -> list[Fault]:
    """The final pose, if scale or place of the map that holds the lead-in are out of bounds at its end.

    Scale is judged over all poses after the exposed segment, the place over the last second of them. A map
    without a pose after the segment has no final pose to judge.
    """
    truth, stamps_s = record.sequence.T_world_cam, record.sequence.stamps_s
    holds = _holds_lead_in(record, exposure)
    if holds is None or truth is None or holds.frames[-1] <= exposure.end_frame:
        return []
    since_s = stamps_s[holds.frames[-1]] - FINAL_S
    tail = _part(holds, holds.frames > exposure.end_frame)
    end = _part(tail, stamps_s[tail.frames] > since_s)
    scale, place = (
        audit_relation(holds, part, stamps_s, truth, exposure.onset_frame) for part in (tail, end)
    )
    bounds = RELATION_BOUNDS
    off = (
        abs(scale.scale_error or 0.0) > bounds.scale_share
        or (place.seam_error_m or 0.0) > (place.seam_bound_m or np.inf)
        or (place.seam_rotation_deg or 0.0) > bounds.rotation_deg
    )
    return [Fault(int(holds.frames[-1]), AUDITED, "final_pose")] if off else []


def _part(path: MapTrajectory, kept: np.ndarray) -> MapTrajectory:
    return MapTrajectory(path.map_id, path.frames[kept], path.stamps_s[kept], path.T_map_cam[kept])


# -- base and Dual-SLAM --------------------------------------------------------------------------------------


def judge_free(arm: FreeArm, reference: Reference) -> dict[str, Any]:
    """The columns of base and dual and, after a breakage, of every recovery thread."""
    base = judge_run(arm.base, "base", reference.exposure)
    dual = judge_run(arm.dual, "dual", reference.exposure)
    broke = dual.broke
    row: dict[str, Any] = {
        "breakage": broke is not None,
        "silent_failure": broke is None and dual.lost is not None if dual.is_judged else None,
        **base.columns,
        **dual.columns,
        **_base_mission(base),
    }
    if broke is not None:
        at = broke.breakage.frame
        row |= {
            "breakage_frame": at,
            "breakage_reason": broke.breakage.reason,
            "declaration_delay_s": declaration_delay_s(reference.sequence.stamps_s, dual.lost, at),
        }
        # The old map's last correct pose is that of the frame before the loss.
        right = (at if dual.lost is None else dual.lost) - 1
        row |= judge_recovery("free", arm.dual.events, arm.first_new_frame, at, right, reference)
    return row | _dual_failures(dual, row, reference.threads)


def _dual_failures(dual: JudgedRun, row: dict[str, Any], threads: int) -> dict[str, Any]:
    """D_J, S_J and M_J for the first 1 to n threads, and the first cause with all of them.

    The run is that of all threads. Where its first n have S_J, so has the mission; where not, the one of them
    that declared success first did so in the run as well.
    """
    broke = dual.broke
    failed, declared = (
        [broke is not None and row[thread_column("free", n + 1, name)] is True for n in range(threads)]
        for name in ("failed", "declared")
    )
    of_threads, of_system = system_failures(broke is not None, failed, declared)
    faults = dual.mission_faults(broke is not None)
    found: dict[str, Any] = {}
    for n, (d, s) in enumerate(zip(of_threads, of_system, strict=True), 1):
        found |= {dual_column(n): d, failure_column("s", n): s, failure_column("m", n): s or bool(faults)}
    if broke is not None and of_system[-1]:
        faults.append(Fault(broke.breakage.frame, DECLARED, "dual_failure"))
    return found | {"mission_cause": first_cause(faults)}


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


def _base_mission(base: JudgedRun) -> dict[str, Any]:
    broke, faults = base.broke, base.mission_faults(base.broke is not None)
    failed = broke is not None and broke.relocalized is None
    if broke is not None and failed:
        faults.append(Fault(broke.breakage.frame, DECLARED, "base_failure"))
    return {
        "base_breakage": broke is not None,
        "base_failure": failed,
        "relocalized": None if broke is None else not failed,
        "base_mission_failure": bool(faults),
        "base_mission_cause": first_cause(faults),
    }


def judge_crossing(branch: BranchRun, reference: Reference) -> dict[str, Any]:
    """The columns of every recovery thread in the crossing arm."""
    onset, end = reference.exposure.onset_frame, reference.exposure.end_frame
    return judge_recovery("cross", branch.system.events, branch.first_new_frame, end, onset, reference)


# -- any other system ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Broken:
    """A breakage: its frame, its reason, and whether the system has said so itself."""

    frame: int
    reason: str
    declared: bool


def judge_other(record: RunRecord, exposure: Exposure, threads: int) -> dict[str, Any]:
    """The columns of a system without recovery threads.

    Args:
        record: of the whole unit.
        exposure: the exposed segment.
        threads: number of recovery threads of the experiment.
    """
    run = judge_run(record, "dual", exposure)
    broken = _breakage(record, exposure, run)
    silent = None
    if record.declares is not Declares.NOTHING and run.is_judged:
        silent = broken is None and run.lost is not None
    row = {"breakage": broken is not None, "silent_failure": silent, **run.columns}
    faults, failed = run.mission_faults(broken is not None), False
    if broken is not None:
        back = _came_back(record, exposure, run.broke, broken)
        failed = not back
        lost = run.lost if broken.declared else None
        row |= {
            "breakage_frame": broken.frame,
            "breakage_reason": broken.reason,
            "declaration_delay_s": declaration_delay_s(record.sequence.stamps_s, lost, broken.frame),
            "relocalized": back,
        }
        if failed:
            faults.append(Fault(broken.frame, DECLARED, "system_failure"))
    for n in range(1, threads + 1):
        row |= {failure_column("s", n): failed, failure_column("m", n): bool(faults)}
    return row | {"mission_cause": first_cause(faults)}


def _breakage(record: RunRecord, exposure: Exposure, run: JudgedRun) -> _Broken | None:
    """The breakage in the exposed segment: declared, by the end of the run, or by the audit."""
    tracked = [result.frame for result in record.results if is_tracked(result)]
    last = max(tracked, default=-1)
    declared = []
    if run.broke is not None:
        declared.append(_Broken(run.broke.breakage.frame, run.broke.breakage.reason, declared=True))
    if record.ending.kind is not EndKind.FINISHED and last <= exposure.last_frame:
        frame = max(last + 1, exposure.onset_frame)
        declared.append(_Broken(frame, record.ending.kind.value, declared=True))
    if declared:
        return min(declared, key=lambda broken: broken.frame)
    if exposure.onset_frame - 1 not in tracked:  # a program, whose lead-in was judged in another run
        return _Broken(exposure.onset_frame, NO_POSE, declared=False)
    if record.declares is not Declares.NOTHING or run.lost is None:
        return None
    gives = any(run.lost <= f <= exposure.last_frame for f in tracked)
    return _Broken(run.lost, WRONG_POSE if gives else NO_POSE, declared=False)


def _came_back(record: RunRecord, exposure: Exposure, word: BreakageOutcome | None, broken: _Broken) -> bool:
    """True if it is in use again: by its own word, or with final poses behind the segment within bounds."""
    if record.declares is Declares.EVENTS and word is not None:
        return word.repair is not None
    behind = max(exposure.end_frame, broken.frame)
    holds = _holds_lead_in(record, exposure)
    has_poses = holds is not None and int(holds.frames[-1]) > behind
    return has_poses and not final_pose_faults(record, exposure)
