"""One unit of an experiment: one lead-in, its arms and their judgement, as one flat record."""

import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from experiments.eq1.arms import PLAIN, CpuClock, Exposure, run_crossing, run_free, settings_of
from experiments.eq1.conditioning import judge_pairs
from experiments.eq1.judging import judge_crossing, judge_free
from experiments.eq1.records import Outcome, empty_record, error_message
from experiments.eq1.recovery_judging import Reference
from experiments.eq1.rescuable import overlap_columns
from experiments.eq1.shared_lead_ins import lead_in_of
from experiments.eq1.units import UnitSpec
from experiments.runs.execution import RunRecord, execute
from experiments.runs.memory import peak_rss_mb, reset_peak
from experiments.runs.provenance import code_hash, commit
from experiments.runs.slam_settings import factory_of
from sim.sequence import Sequence


def run_unit(unit: UnitSpec, cache_dir: Path | None = None, recording: Path | None = None) -> dict[str, Any]:
    """Run one unit: a pure function of its spec, except for the measured times. Never raises.

    Args:
        unit: everything that determines the record.
        cache_dir: folder of rendered sequences; None for the default one.
        recording: file for a recording of base and Dual-SLAM, which takes two more runs.

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
        with render.running():
            sequence = _render(unit, cache_dir)
            record |= overlap_columns(unit, sequence, cache_dir)
        record |= _judged(unit, sequence, slam)
        if recording is not None:
            record_runs(unit, sequence, recording)
    except Exception as error:  # a broken unit must not end the experiment
        record |= {"outcome": Outcome.INFRASTRUCTURE_ERROR.value, "message": error_message(error)}
    return record | {
        "render_s": render.seconds,
        "slam_s": slam.seconds,
        "cpu_s": time.process_time() - cpu_started,
        "wall_s": time.perf_counter() - started,
        "peak_rss_mb": peak_rss_mb(),
    }


def record_runs(unit: UnitSpec, sequence: Sequence, path: Path) -> list[RunRecord]:
    """Run and record base and Dual-SLAM from the start; they behave as in the unit."""
    from experiments.recording import Recording

    kinds = ("base", unit.system)
    build = factory_of(settings_of(unit))
    with Recording(path, sequence, kinds) as recorded:
        runs = [
            execute(sequence, kind, unit.repeat_seed, recorded.watch(kind), build=build) for kind in kinds
        ]
        recorded.finish(runs)
    return runs


def _render(unit: UnitSpec, cache_dir: Path | None) -> Sequence:
    from sim.sequence_rendering import render_sequence

    whole = render_sequence(unit.scenario, cache_dir=cache_dir)
    return whole.only(np.arange(unit.start_frame, len(whole))) if unit.start_frame else whole


def _judged(unit: UnitSpec, sequence: Sequence, clock: CpuClock) -> dict[str, Any]:
    exposure = Exposure.of(unit, sequence)
    row: dict[str, Any] = {
        "onset_s": exposure.onset_s,
        "exposed_s": exposure.exposed_s,
        "onset_frame": exposure.onset_frame,
        "end_frame": exposure.end_frame,
    }
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
