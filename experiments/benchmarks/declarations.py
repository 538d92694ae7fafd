"""What systems declare over many sequences, judged by the truth: loops, relocalizations, joins, fusions."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from dslab.experiments.benchmarks.kept_rows import keep_rows
from dslab.experiments.evaluation.declared_audit import audit_declared
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.jobs.ledger import Row
from dslab.experiments.runs.execution import RunRecord, SystemKind, execute
from dslab.experiments.runs.sources import open_sequence
from dslab.scenarios.errors import InputError
from dslab.slam.core.events import Fusion, LoopRefused, RelocalizationWithdrawn, Relocalized

KEY = ("scenario", "seed", "system")
COUNTS = ("loops", "relocalizations", "joins", "fusions")


def measure_declarations(
    scenarios: Sequence[str],
    seeds: Sequence[int],
    systems: Sequence[SystemKind],
    folder: Path,
    workers: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> pd.DataFrame:
    """Run systems over sequences of scenarios; one row per run, kept in a folder.

    Rows that the folder has already are not made again, so that a long measurement can be stopped and
    resumed. A seed is that of the sequence and of the system.

    Args:
        scenarios: names or files.
        seeds: of each scenario.
        systems: run over the same frames.
        folder: see :func:`experiments.benchmarks.kept_rows.keep_rows`.
        workers: number of processes.
        progress: called with (step, runs done, runs in all).

    Raises:
        InputError: the folder is of something else or other code; a sequence has no ground truth.
    """
    jobs = [(scenario, seed, system) for seed in seeds for scenario in scenarios for system in systems]
    return keep_rows(folder, "declarations", KEY, {job: job for job in jobs}, run_sequence, workers, progress)


def run_sequence(job: tuple[str, int, SystemKind]) -> list[Row]:
    """The row of a system over a sequence."""
    scenario, seed, system = job
    sequence = open_sequence(scenario, seed)
    if sequence.T_world_cam is None:
        raise InputError(scenario, "has no ground truth", "name a sequence or scenario with ground truth")
    return [dict(zip(KEY, job, strict=True)) | declaration_row(execute(sequence, system, seed))]


def declaration_row(record: RunRecord) -> Row:
    """Figures of a run; all that it declared, how much of it is false or cannot be judged."""
    summary, audit = summarise(record), audit_declared(record)
    lost_s = [e.lost_s for e in record.events if isinstance(e, Relocalized)]
    refused = [e for e in record.events if isinstance(e, Fusion) and not e.accepted]
    counted = ("frames", "tracked", "posed", "breakages", "ate_m", "true_path_m", "scale_first_over_last")
    return {
        **{name: summary[name] for name in counted},
        **{name: len(getattr(audit, name)) for name in COUNTS},
        **audit.false_counts,
        "unjudged": audit.unjudged,
        "loops_refused": sum(isinstance(e, LoopRefused) for e in record.events),
        "relocalizations_withdrawn": sum(isinstance(e, RelocalizationWithdrawn) for e in record.events),
        "fusions_refused": len(refused),
        "lost_s_median": float(np.median(lost_s)) if lost_s else None,
    }
