"""One unit of an experiment: one lead-in, its arms and their judgement, as one flat record."""

import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dslab.experiments.eq1.arms import PLAIN, CpuClock, Exposure, run_crossing, run_free, settings_of
from dslab.experiments.eq1.conditioning import judge_pairs
from dslab.experiments.eq1.free_arm import ending_columns, judge_system, run_free_system
from dslab.experiments.eq1.judging import judge_crossing, judge_free
from dslab.experiments.eq1.lead_in import lead_in_of
from dslab.experiments.eq1.records import Outcome, empty_record, error_message
from dslab.experiments.eq1.recovery_judging import Reference
from dslab.experiments.eq1.units import UnitSpec
from dslab.experiments.evaluation.view_overlap import best_overlap
from dslab.experiments.runs.ending import FINISHED, Declares
from dslab.experiments.runs.execution import RunRecord, slam_camera
from dslab.experiments.runs.memory import peak_rss_mb, reset_peak
from dslab.experiments.runs.provenance import code_hash, commit
from dslab.experiments.runs.slam_settings import factory_of
from dslab.experiments.runs.systems.registry import OwnSystem, Registry, System, system_digest
from dslab.experiments.runs.systems.run import run_system
from dslab.sim.sequence import Sequence


def run_unit(
    unit: UnitSpec,
    cache_dir: Path | None = None,
    recording: Path | None = None,
    folders: tuple[Path, ...] = (),
) -> dict[str, Any]:
    """Run one unit: a pure function of its spec, except for the measured times. Never raises.

    Args:
        unit: everything that determines the record.
        cache_dir: folder of rendered sequences; None for the default one.
        recording: file for a recording of the base and the unit's system, which takes two more runs.
        folders: of descriptions of systems, beside ours and those of ``DSLAB_SYSTEMS``.

    Returns:
        The columns of ``experiments.eq1.records``. An error in the programs gives the outcome
        ``infrastructure_error`` with its message, never a failure of the SLAM.
    """
    record = empty_record(unit)
    started, cpu_started = time.perf_counter(), time.process_time()
    render, slam = CpuClock(), CpuClock()
    reset_peak()
    try:
        cv2.setNumThreads(1)
        record |= {"code": code_hash(), "commit": commit()}
        system = Registry.open(folders).find(unit.system)
        record["system_digest"] = system_digest(system) or None
        with render.running():
            sequence = _render(unit, cache_dir)
            if unit.scenario.segments:
                record["exposed"] = any(segment.first_frame >= 0 for segment in sequence.segments)
            record |= overlap_columns(unit, sequence, cache_dir)
        record |= _judged(unit, system, sequence, slam)
        if recording is not None:
            record_runs(unit, system, sequence, recording)
    except Exception as error:  # a broken unit must not end the experiment
        record |= {"outcome": Outcome.INFRASTRUCTURE_ERROR.value, "message": error_message(error)}
    return record | {
        "render_s": render.seconds,
        "slam_s": slam.seconds,
        "cpu_s": time.process_time() - cpu_started,
        "wall_s": time.perf_counter() - started,
        "peak_rss_mb": peak_rss_mb(),
    }


def record_runs(unit: UnitSpec, system: System, sequence: Sequence, path: Path) -> list[RunRecord]:
    """Run and record the base and the unit's system from the start; ours behave as in the unit."""
    from dslab.experiments.recording import Recording

    systems = {"base": OwnSystem("base"), system.name: system}
    build, seed, runs = factory_of(settings_of(unit)), unit.repeat_seed, []
    with Recording(path, sequence, list(systems)) as recorded:
        for kind, each in systems.items():
            runs.append(run_system(each, sequence, seed, build, observer=recorded.watch(kind)))
        recorded.finish(runs)
    return runs


def _render(unit: UnitSpec, cache_dir: Path | None) -> Sequence:
    from dslab.sim.sequence_rendering import render_sequence

    whole = render_sequence(unit.scenario, cache_dir=cache_dir)
    return whole.only(np.arange(unit.start_frame, len(whole))) if unit.start_frame else whole


def overlap_columns(unit: UnitSpec, sequence: Sequence, cache_dir: Path | None = None) -> dict[str, Any]:
    """The columns of the view overlap about the stress, from truth and exact depth.

    Usable are frames on which the stress does not act: as many before it as Dual-SLAM's buffer holds, and all
    behind it.

    Args:
        unit: its spec; null columns for a sham, which has no stress, and a system without recovery.
        sequence: its frames.
        cache_dir: folder of rendered sequences; None for the default one.
    """
    acting = [segment for segment in sequence.segments if segment.first_frame >= 0]
    if not acting or sequence.T_world_cam is None or not unit.recovers:
        return {"view_overlap": None, "rescuable": None}
    _, dual = settings_of(unit).of(unit.system, slam_camera(sequence.camera))
    first = min(segment.first_frame for segment in acting)
    last = max(segment.last_frame for segment in acting)
    since_s = sequence.stamps_s[first] - dual.buffer_s
    before = np.flatnonzero(sequence.stamps_s[:first] >= since_s)
    after = range(last + 1, len(sequence))
    found = best_overlap(unit.scenario, sequence.T_world_cam, before, after, cache_dir=cache_dir)
    return {"view_overlap": found.overlap, "rescuable": found.is_rescuable}


def _judged(unit: UnitSpec, system: System, sequence: Sequence, clock: CpuClock) -> dict[str, Any]:
    exposure = Exposure.of(unit, sequence)
    row: dict[str, Any] = {
        "onset_s": exposure.onset_s,
        "exposed_s": exposure.exposed_s,
        "onset_frame": exposure.onset_frame,
        "end_frame": exposure.end_frame,
    }
    if not unit.recovers:
        run = run_free_system(unit, system, sequence, exposure, clock)
        row |= ending_columns(run.record)
        if run.fault:
            return row | {"outcome": Outcome.VOID.value, "void_reason": run.fault}
        judged = judge_system(run.record, exposure, unit.kind, len(unit.threads))
        return row | judged | {"outcome": Outcome.COMPLETED.value}
    row |= {"declares": Declares.EVENTS.value, "ended": FINISHED.kind.value}
    lead_in = lead_in_of(unit, sequence, exposure, clock)
    of_base = PLAIN.get(unit.system) if "free" in unit.arms else None
    plain = None if of_base is None else lead_in_of(unit, sequence, exposure, clock, of_base)
    faults = [f"{of_base}: {plain.fault}"] if plain is not None and plain.fault else []
    if lead_in.branch is None or lead_in.path is None or faults:
        return row | {"outcome": Outcome.VOID.value, "void_reason": lead_in.fault or faults[0]}
    reference = Reference(sequence, exposure, lead_in.path, unit.kind, len(unit.threads))
    if "free" in unit.arms:
        beside = None if plain is None else plain.branch
        row |= judge_free(run_free(lead_in.branch, unit, beside), reference)
    if "crossing" in unit.arms:
        row |= judge_crossing(run_crossing(lead_in.branch, exposure), reference)
    if "pairs" in unit.arms:
        row |= judge_pairs(sequence, exposure.onset_frame, unit.repeat_seed)
    return row | {"outcome": Outcome.COMPLETED.value}
