"""The free arm of a system without recovery threads: the base, DSO, or one of someone else's.

It sees the frames that Dual-SLAM sees. What is not ours runs in a process of its own, so that a crash or a
hang is its outcome.

The terms of its columns are those of Dual-SLAM. B is the system's own word where it declares losses, or that
its run has ended; where it declares nothing, B is true loss by the audit. S is B without coming back: by its
own word where it declares what becomes of a loss, else by the truth.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dslab.experiments.eq1.arms import CpuClock, Exposure, settings_of
from dslab.experiments.eq1.judging import (
    accuracy_columns,
    audited_faults,
    declared_columns,
    first_exposed,
    silent_frame,
    true_loss,
)
from dslab.experiments.eq1.lead_in import lead_in_fault, lead_in_key
from dslab.experiments.eq1.mission import Fault, final_pose_faults, first_cause
from dslab.experiments.eq1.records import failure_column
from dslab.experiments.eq1.units import UnitSpec
from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.audit import LossAudit
from dslab.experiments.evaluation.audit_report import audit_loss_in, declaration_delay_s
from dslab.experiments.evaluation.breakages import BreakageOutcome
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.runs.ending import Declares, EndKind
from dslab.experiments.runs.execution import RunRecord, execute
from dslab.experiments.runs.slam_settings import factory_of
from dslab.experiments.runs.systems.class_process import run_class_apart
from dslab.experiments.runs.systems.command import CommandSystem, run_command
from dslab.experiments.runs.systems.command_spec import Limits
from dslab.experiments.runs.systems.own_class import ClassSystem
from dslab.experiments.runs.systems.registry import System, system_digest
from dslab.sim.sequence import Sequence

LIMITS = Limits()
"""What a class may take, as a program whose description does not say."""
_KEPT = 16
"""Lead-ins of programs that are kept: all cells of a replicate share them."""
NO_POSE, WRONG_POSE = "no_pose", "wrong_pose"
"""Reasons of a true loss that is not declared: it gives no poses, or wrong ones."""


@dataclass(frozen=True)
class FreeRun:
    """A run of such a system.

    Attributes:
        record: of the whole unit; of the lead-in alone, if that is at fault and the rest was not run.
        fault: why the lead-in is not healthy; empty if it is.
    """

    record: RunRecord
    fault: str


_lead_ins: dict[str, FreeRun] = {}


def run_free_system(
    unit: UnitSpec, system: System, sequence: Sequence, exposure: Exposure, clock: CpuClock
) -> FreeRun:
    """Run a system over a unit. Whether its lead-in is healthy never depends on what comes after it.

    What gives poses frame by frame is judged by them. Of a program only what it leaves is known, which its
    end decides: its lead-in has a run of its own.

    Args:
        unit: its spec.
        system: of the unit.
        sequence: its frames.
        exposure: the exposed segment.
        clock: sums the CPU time, of a program as far as it says.
    """
    if isinstance(system, CommandSystem):
        lead_in = _lead_in_of_program(unit, system, sequence, exposure, clock)
        if lead_in.fault:
            return lead_in
        return FreeRun(_run_program(unit, system, sequence, clock), "")
    if isinstance(system, ClassSystem):
        record = run_class_apart(unit.system, system, sequence, unit.repeat_seed, LIMITS)
        _add_cpu(record, clock)
    else:
        with clock.running():
            record = execute(sequence, system.name, unit.repeat_seed, build=factory_of(settings_of(unit)))
    return FreeRun(record, _fault(record, sequence, exposure))


def _lead_in_of_program(
    unit: UnitSpec, system: CommandSystem, sequence: Sequence, exposure: Exposure, clock: CpuClock
) -> FreeRun:
    key = lead_in_key(unit, sequence, exposure, f"{system.name} {system_digest(system)}")
    if key not in _lead_ins:
        record = _run_program(unit, system, sequence.only(np.arange(exposure.onset_frame)), clock)
        _lead_ins[key] = FreeRun(record, _fault(record, sequence, exposure))
        while len(_lead_ins) > _KEPT:
            del _lead_ins[next(iter(_lead_ins))]
    return _lead_ins[key]


def _run_program(unit: UnitSpec, system: CommandSystem, sequence: Sequence, clock: CpuClock) -> RunRecord:
    record = run_command(system, sequence, unit.repeat_seed)
    _add_cpu(record, clock)
    return record


def _add_cpu(record: RunRecord, clock: CpuClock) -> None:
    clock.seconds += sum(sum(result.cpu_ms.values()) for result in record.results) / 1e3


def _fault(record: RunRecord, sequence: Sequence, exposure: Exposure) -> str:
    onset = exposure.onset_frame
    fault = lead_in_fault(record.results, record.events, sequence, onset)
    if fault is None:
        # Only the poses before the onset decide whether a loss after it can be judged.
        judged = audit_loss_in(record, onset, onset) if len(record.results) > onset else None
        fault = f"a loss could not be judged: {judged.reason}" if isinstance(judged, Undefined) else ""
    elif record.ending.kind is not EndKind.FINISHED:
        fault += f"; {record.ending.kind.value.replace('_', ' ')}: {record.ending.message}"
    return fault


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
