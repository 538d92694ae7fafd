"""One way of running any system: ours, a class, a program."""

from dataclasses import replace
from pathlib import Path

from dslab.experiments.runs.execution import AtEnd, Observer, Progress, RunRecord, SystemFactory, execute
from dslab.experiments.runs.inputs import hashed, input_digests
from dslab.experiments.runs.pacing import RealTime
from dslab.experiments.runs.systems.command import CommandSystem, run_command
from dslab.experiments.runs.systems.framework import dual_builder
from dslab.experiments.runs.systems.own_class import ClassSystem
from dslab.experiments.runs.systems.registry import DualSystem, System, system_digest
from dslab.sim.sequence import Sequence


def run_system(
    system: System,
    sequence: Sequence,
    seed: int,
    build: SystemFactory | None = None,
    folder: Path | None = None,
    observer: Observer | None = None,
    progress: Progress | None = None,
    pace: RealTime | None = None,
    at_end: AtEnd | None = None,
    whole: Sequence | None = None,
) -> RunRecord:
    """Run a system over a sequence; its truth is not passed on.

    Args:
        system: what to run.
        sequence, seed, observer, progress: as of :func:`experiments.runs.execution.execute`.
        build: makes ours; None for ``slam.factory.build_system``.
        folder: of a program's log and settings; None for none that stays.
        pace: feeds ours and classes in real time.
        at_end: called with a finished system of ours.
        whole: what the sequence was taken from, of :func:`experiments.runs.inputs.hashed`: runs that begin at
            different frames of it have one input; None for the sequence itself.

    Raises:
        InputError: it cannot be started or made, or a frame cannot be read.
    """
    if whole is None:
        whole = sequence = hashed(sequence)
    if isinstance(system, CommandSystem):
        record = run_command(system, sequence, seed, folder, observer, progress)
        return replace(record, input=input_digests(whole))
    if isinstance(system, DualSystem):
        build, at_end = dual_builder(system, sequence, build), None
    if isinstance(system, ClassSystem):
        made = system
        build, at_end = (lambda name, camera, seed: made.build(camera, seed)), None
    record = execute(sequence, system.name, seed, observer, progress, build, pace, at_end)
    digest = system_digest(system)
    config = record.config | ({"code": digest} if digest else {})
    return replace(record, input=input_digests(whole), config=config)
