"""From the run of a system without recovery threads to the columns of its record.

The terms are those of Dual-SLAM. B is the system's own word where it declares losses, or that its run has
ended; where it declares nothing, B is true loss by the audit. S is B without coming back: by its own word
where it declares what becomes of a loss, else by the truth.
"""

from dataclasses import dataclass
from typing import Any

from dslab.experiments.eq1.arms import Exposure
from dslab.experiments.eq1.judging import (
    accuracy_columns,
    audited_faults,
    declared_columns,
    first_exposed,
    silent_frame,
    true_loss,
)
from dslab.experiments.eq1.mission import Fault, final_pose_faults, first_cause
from dslab.experiments.eq1.records import failure_column
from dslab.experiments.evaluation.audit import LossAudit
from dslab.experiments.evaluation.audit_report import declaration_delay_s
from dslab.experiments.evaluation.breakages import BreakageOutcome
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.runs.ending import Declares, EndKind
from dslab.experiments.runs.execution import RunRecord

NO_POSE, WRONG_POSE = "no_pose", "wrong_pose"
"""Reasons of a true loss that is not declared: it gives no poses, or wrong ones."""


@dataclass(frozen=True)
class _Broken:
    """A breakage: its frame, its reason, and whether the system has said so itself."""

    frame: int
    reason: str
    declared: bool


def judge_system(record: RunRecord, exposure: Exposure, kind: str, threads: int) -> dict[str, Any]:
    """The columns of a system's free arm.

    Args:
        record: of the whole unit.
        exposure: the exposed segment.
        kind: of the degradation.
        threads: number of recovery threads of the experiment, which this system does not have.
    """
    word = first_exposed(record, exposure, kind)
    loss = true_loss(record, exposure, word)
    broken = _breakage(record, exposure, word, loss)
    silent = None
    if record.declares is not Declares.NOTHING and loss is not None:
        silent = broken is None and loss.true_loss_frame is not None
    row: dict[str, Any] = {
        "breakage": broken is not None,
        "silent_failure": silent,
        **accuracy_columns(record, "dual", exposure),
        **declared_columns(record, "dual", ("loops", "relocalizations", "fusions", "joins")),
    }
    faults = audited_faults(record, exposure, silent_frame(loss, broken is not None))
    failed = False
    if broken is not None:
        back = _came_back(record, exposure, word, broken)
        failed = not back
        lost = loss.true_loss_frame if loss is not None and broken.declared else None
        delay_s = declaration_delay_s(record.sequence.stamps_s, lost, broken.frame)
        row |= {
            "breakage_frame": broken.frame,
            "breakage_reason": broken.reason,
            "declaration_delay_s": delay_s,
            "relocalized": back,
        }
        if failed:
            faults.append(Fault.declared(broken.frame, "system_failure"))
    for n in range(1, threads + 1):
        row |= {failure_column("s", n): failed, failure_column("m", n): bool(faults)}
    return row | {"mission_cause": first_cause(faults)}


def ending_columns(record: RunRecord) -> dict[str, str]:
    """What the system says of itself, and how its run has ended."""
    ending = record.ending
    return {
        "declares": record.declares.value,
        "ended": ending.kind.value,
        "ended_message": ending.message,
    }


def _breakage(
    record: RunRecord, exposure: Exposure, word: BreakageOutcome | None, loss: LossAudit | None
) -> _Broken | None:
    """The breakage in the exposed segment: declared, by the end of the run, or by the audit."""
    tracked = [result.frame for result in record.results if is_tracked(result)]
    last = max(tracked, default=-1)
    declared = []
    if word is not None:
        declared.append(_Broken(word.breakage.frame, word.breakage.reason, declared=True))
    if record.ending.kind is not EndKind.FINISHED and last <= exposure.last_frame:
        frame = max(last + 1, exposure.onset_frame)
        declared.append(_Broken(frame, record.ending.kind.value, declared=True))
    if declared:
        return min(declared, key=lambda broken: broken.frame)
    if exposure.onset_frame - 1 not in tracked:  # a program, whose lead-in was judged in another run
        return _Broken(exposure.onset_frame, NO_POSE, declared=False)
    if record.declares is not Declares.NOTHING or loss is None or loss.true_loss_frame is None:
        return None
    frame = loss.true_loss_frame
    gives = any(frame <= f <= exposure.last_frame for f in tracked)
    return _Broken(frame, WRONG_POSE if gives else NO_POSE, declared=False)


def _came_back(record: RunRecord, exposure: Exposure, word: BreakageOutcome | None, broken: _Broken) -> bool:
    """True if it is in use again: by its own word, or with final poses behind the segment within bounds."""
    if record.declares is Declares.EVENTS and word is not None:
        return word.repair is not None
    before, behind = exposure.onset_frame - 1, max(exposure.end_frame, broken.frame)
    holds = next((path for path in record.trajectories if before in path.frames), None)
    has_poses = holds is not None and int(holds.frames[-1]) > behind
    return has_poses and not final_pose_faults(record, exposure)
