"""One unit of an experiment: its frames, one lead-in, its arms and their judgement, as one flat record."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dslab.experiments.eq1.arms import (
    PLAIN,
    LeadIn,
    cross,
    lead_in_fault,
    lead_in_of,
    run_crossing,
    run_free,
    run_lead_in,
    run_other,
)
from dslab.experiments.eq1.conditioning import judge_pairs
from dslab.experiments.eq1.dual_arms import judge_dual_crossing, judge_free_recovery
from dslab.experiments.eq1.judging import judge_crossing, judge_free, judge_other
from dslab.experiments.eq1.records import Outcome, empty_record, error_message
from dslab.experiments.eq1.recovery_judging import Reference
from dslab.experiments.eq1.shared_runs import forward_of
from dslab.experiments.eq1.units import ArmName, Exposure, UnitSpec, unit_settings
from dslab.experiments.evaluation.view_overlap import best_overlap
from dslab.experiments.runs.ending import FINISHED, Declares
from dslab.experiments.runs.execution import RunRecord, live_trajectories, slam_camera
from dslab.experiments.runs.memory import peak_rss_mb, reset_peak
from dslab.experiments.runs.provenance import code_hash, commit
from dslab.experiments.runs.slam_settings import SlamSettings, factory_of
from dslab.experiments.runs.systems.framework import dual_builder
from dslab.experiments.runs.systems.registry import (
    DualSystem,
    OwnSystem,
    Registry,
    System,
    programs_of,
    system_digest,
)
from dslab.experiments.runs.systems.run import run_system
from dslab.scenarios.spec import Scenario
from dslab.sim.sequence import Sequence
from dslab.slam.core.results import MapTrajectory

Row = dict[str, Any]
CROSSING = "crossing"
"""Name of the crossing arm in a recording."""


def run_unit(unit: UnitSpec, cache_dir: Path | None = None, folders: Iterable[Path] = ()) -> Row:
    """Run one unit: a pure function of its spec, except for the measured times. Never raises.

    Args:
        unit: everything that determines the record.
        cache_dir: folder of rendered sequences; None for the default one.
        folders: of descriptions of systems, beside ours and those of ``DSLAB_SYSTEMS``.

    Returns:
        The columns of ``experiments.eq1.records``. An error in the programs gives the outcome
        ``infrastructure_error`` with its message, never a failure of the SLAM.
    """
    row = empty_record(unit)
    started, cpu_started = time.perf_counter(), time.process_time()
    reset_peak()
    try:
        cv2.setNumThreads(1)
        row |= {"code": code_hash(), "commit": commit()}
        system = Registry.open(folders).find(unit.system)
        row["system_digest"] = system_digest(system) or None
        settings = unit_settings(unit.settings, unit.threads)
        with _timed(row, "render_s"):
            sequence = frames_of(unit.scenario, unit.start_frame, cache_dir)
            if unit.scenario.segments:
                row["exposed"] = any(segment.first_frame >= 0 for segment in sequence.segments)
            if unit.recovers or isinstance(system, DualSystem):
                _, dual = settings.of("dual", slam_camera(sequence.camera))
                buffer_s = dual.buffer_s if unit.recovers else settings.framework.buffer_s
                row |= overlap_columns(unit.scenario, sequence, buffer_s, cache_dir)
        exposure = Exposure.of(unit.onset_s, unit.exposed_s, sequence.stamps_s)
        row |= exposure.columns
        case = Case(system, settings, unit.repeat_seed, len(unit.threads), sequence, exposure)
        if unit.recovers:
            _run_recovering(row, case, unit.arms)
        else:
            _run_other(row, case, unit.arms)
    except Exception as error:  # a broken unit must not end the experiment
        row |= {"outcome": Outcome.INFRASTRUCTURE_ERROR.value, "message": error_message(error)}
    return row | {
        "cpu_s": time.process_time() - cpu_started,
        "wall_s": time.perf_counter() - started,
        "peak_rss_mb": peak_rss_mb(),
    }


def record_unit(
    unit: UnitSpec, path: Path, folders: Iterable[Path] = (), cache_dir: Path | None = None
) -> list[RunRecord]:
    """Run and record the base and the unit's system from the start; ours behave as in the unit.

    A unit with a crossing arm has it recorded too, under the name ``CROSSING``, unless its lead-in is not
    healthy. It goes on to the last frame; what the unit's record has of it is its first recovery.

    Args:
        unit, cache_dir, folders: as of :func:`run_unit`.
        path: of the recording.

    Returns:
        The runs of the two; one of the base alone.
    """
    from dslab.experiments.recording import Recording

    system = Registry.open(folders).find(unit.system)
    sequence = frames_of(unit.scenario, unit.start_frame, cache_dir)
    settings, seed = unit_settings(unit.settings, unit.threads), unit.repeat_seed
    systems = {"base": OwnSystem("base"), system.name: system}
    names = [*systems, *([CROSSING] if unit.recovers and "crossing" in unit.arms else [])]
    with Recording(path, sequence, names) as recorded:
        runs = [
            run_system(each, sequence, seed, factory_of(settings), observer=recorded.watch(kind))
            for kind, each in systems.items()
        ]
        onset = Exposure.of(unit.onset_s, unit.exposed_s, sequence.stamps_s)
        crossing = []
        if CROSSING in names and not lead_in_fault(
            runs[-1].results, runs[-1].events, sequence, onset.onset_frame
        ):
            watcher = recorded.watch(CROSSING)
            branch = run_lead_in(unit.system, sequence, onset.onset_frame, seed, settings, watcher)
            cross(branch, onset.end_frame)
            branch.run_out()
            crossing = [branch.record(CROSSING, seed)]
        recorded.finish([*runs, *crossing])
    return runs


def frames_of(scenario: Scenario, start_frame: int, cache_dir: Path | None = None) -> Sequence:
    """The frames of a scenario from one on, rendered or from the cache."""
    from dslab.sim.sequence_rendering import render_sequence

    whole = render_sequence(scenario, cache_dir=cache_dir)
    return whole.only(np.arange(start_frame, len(whole))) if start_frame else whole


def overlap_columns(
    scenario: Scenario, sequence: Sequence, buffer_s: float, cache_dir: Path | None = None
) -> Row:
    """The columns of the view overlap about the stress, from truth and exact depth; none without stress.

    Usable are frames on which the stress does not act: as many before it as Dual-SLAM's buffer holds, and all
    behind it.

    Args:
        scenario: of the frames.
        sequence: the frames.
        buffer_s: length of the buffer.
        cache_dir: folder of rendered sequences; None for the default one.
    """
    acting = [segment for segment in sequence.segments if segment.first_frame >= 0]
    if not acting or sequence.T_world_cam is None:
        return {}
    first = min(segment.first_frame for segment in acting)
    last = max(segment.last_frame for segment in acting)
    before = np.flatnonzero(sequence.stamps_s[:first] >= sequence.stamps_s[first] - buffer_s)
    after = range(last + 1, len(sequence))
    found = best_overlap(scenario, sequence.T_world_cam, before, after, cache_dir=cache_dir)
    return {"view_overlap": found.overlap, "rescuable": found.is_rescuable}


@dataclass(frozen=True)
class Case:
    """What the arms of a unit run over, and by what they are judged.

    Attributes:
        system: that is run.
        settings: of it, if it is ours, and of the base.
        seed: of the systems.
        threads: number of recovery threads of the experiment.
        sequence: the frames with their truth.
        exposure: the exposed segment.
    """

    system: System
    settings: SlamSettings
    seed: int
    threads: int
    sequence: Sequence
    exposure: Exposure

    def lead_in(self, system: str) -> LeadIn | str:
        """The lead-in of one of our systems, or why it is not healthy."""
        return lead_in_of(system, self.sequence, self.exposure.onset_frame, self.seed, self.settings)

    def reference(self, lead_in: LeadIn) -> Reference:
        """By what its recoveries are judged."""
        return Reference(self.sequence, self.exposure, lead_in.path, self.threads)


def _run_recovering(row: Row, case: Case, arms: Iterable[ArmName]) -> None:
    """Run the arms of a system with recovery threads, and put their columns into the row of the unit."""
    row |= {"declares": Declares.EVENTS.value, "ended": FINISHED.kind.value}
    of_base = PLAIN.get(case.system.name) if "free" in arms else None
    with _timed(row, "slam_s"):
        lead_in = case.lead_in(case.system.name)
        plain = None if of_base is None else case.lead_in(of_base)
    if isinstance(lead_in, str) or isinstance(plain, str):
        row |= _void(lead_in if isinstance(lead_in, str) else f"{of_base}: {plain}")
        return
    for arm in arms:
        _ARMS[arm](row, case, lead_in, plain)
    row["outcome"] = Outcome.COMPLETED.value


def _free(row: Row, case: Case, lead_in: LeadIn, plain: LeadIn | None) -> None:
    beside = None if plain is None else plain.saved
    with _timed(row, "slam_s"):
        arm = run_free(lead_in.saved, case.sequence, case.system.name, case.seed, beside)
    row |= judge_free(arm, case.reference(lead_in))


def _crossing(row: Row, case: Case, lead_in: LeadIn, plain: LeadIn | None) -> None:
    with _timed(row, "slam_s"):
        branch = run_crossing(lead_in.saved, case.sequence, case.exposure.end_frame)
    row |= judge_crossing(branch, case.reference(lead_in))


def _pairs(row: Row, case: Case, lead_in: LeadIn, plain: LeadIn | None) -> None:
    row |= judge_pairs(case.sequence, case.exposure.onset_frame, case.seed)


_ARMS: dict[ArmName, Callable[[Row, Case, LeadIn, LeadIn | None], None]] = {
    "free": _free,
    "crossing": _crossing,
    "pairs": _pairs,
}


def _run_other(row: Row, case: Case, arms: Iterable[ArmName]) -> None:
    """Run any other system in the free arm; Dual-SLAM over one in the crossing arm too."""
    with _timed(row, "slam_s"):
        onset = case.exposure.onset_frame
        run, fault = run_other(case.system, case.sequence, onset, case.seed, case.settings)
    if not isinstance(case.system, OwnSystem):  # its time is not that of this process
        row["slam_s"] = sum(sum(result.cpu_ms.values()) for result in run.results) / 1e3
    ending = run.ending
    row |= {"declares": run.declares.value, "ended": ending.kind.value, "ended_message": ending.message}
    if fault:
        row |= _void(fault)
    else:
        row |= judge_other(run, case.exposure, case.threads) | {"outcome": Outcome.COMPLETED.value}
    if isinstance(case.system, DualSystem) and not fault:
        threads = min(case.threads, max(1, len(case.system.recoveries)))
        row |= judge_free_recovery(run, _lead_in_path(run, onset), row, case.exposure, threads)
        if "crossing" in arms and not programs_of(case.system):
            begun = forward_of(case.system, case.sequence, onset, case.seed, case.settings, whole=False)
            build = dual_builder(case.system, case.sequence, factory_of(case.settings), begun)
            row |= judge_dual_crossing(build, case.sequence, case.exposure, case.seed, threads)


def _lead_in_path(run: RunRecord, onset: int) -> MapTrajectory:
    """Poses of the lead-in as they were given."""
    path = live_trajectories(run.results[:onset])[run.results[onset - 1].map_id]
    return path.where(path.frames < onset)


def _void(fault: str) -> Row:
    return {"outcome": Outcome.VOID.value, "void_reason": fault}


@contextmanager
def _timed(row: Row, column: str) -> Iterator[None]:
    """Add the CPU time of a block to a column."""
    started = time.process_time()
    try:
        yield
    finally:
        row[column] = (row[column] or 0.0) + time.process_time() - started
