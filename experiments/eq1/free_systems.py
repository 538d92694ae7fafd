"""The free arm of a system without recovery threads: the base, DSO, or one of someone else's.

It sees the frames that Dual-SLAM sees. What is not ours runs in a process of its own, so that a crash or a
hang is its outcome.
"""

from dataclasses import dataclass

import numpy as np

from dslab.experiments.eq1.arms import CpuClock, Exposure, settings_of
from dslab.experiments.eq1.lead_in import lead_in_fault
from dslab.experiments.eq1.shared_lead_ins import lead_in_key
from dslab.experiments.eq1.units import UnitSpec
from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.audit_report import audit_loss_in
from dslab.experiments.runs.ending import EndKind
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
