"""What systems declare over many sequences, judged by the truth: loops, relocalizations, joins, fusions."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from dslab.experiments.benchmarks.kept_rows import Row, extend_rows, read_rows
from dslab.experiments.evaluation.declared_audit import audit_declared
from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.runs.execution import RunRecord, SystemKind, execute
from dslab.experiments.runs.provenance import code_hash, commit
from dslab.experiments.runs.sources import open_sequence
from dslab.scenarios.errors import InputError
from dslab.slam.core.events import Fusion, LoopRefused, RelocalizationWithdrawn, Relocalized

KEY = ("scenario", "seed", "system")
COUNTS = ("loops", "relocalizations", "joins", "fusions")


def measure_declarations(
    scenarios: Sequence[str],
    seeds: Sequence[int],
    systems: Sequence[SystemKind],
    table: Path,
    workers: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> pd.DataFrame:
    """Run systems over sequences of scenarios; one row per run, kept in a Parquet file.

    Rows that the file has already, from the same code, are not run again, so that a long measurement can be
    stopped and resumed. A seed is that of the sequence and of the system.

    Args:
        scenarios: names or files.
        seeds: of each scenario.
        systems: run over the same frames.
        table: the file; made if there is none, written anew after every sequence.
        workers: number of processes.
        progress: called with (step, sequences done, sequences in all).

    Raises:
        InputError: the file is no such table, or is of other code.
    """
    code = code_hash()
    rows = read_rows(table, "declarations", code)
    done = {tuple(row[name] for name in KEY) for row in rows}
    jobs = [
        (scenario, seed, missing, code)
        for seed in seeds
        for scenario in scenarios
        if (missing := [s for s in systems if (scenario, seed, s) not in done])
    ]
    n_done = len(seeds) * len(scenarios) - len(jobs)
    rows = extend_rows(rows, table, KEY, jobs, run_sequence, workers, progress, n_done)
    frame = pd.DataFrame(rows)
    wanted = frame.scenario.isin(scenarios) & frame.seed.isin(seeds) & frame.system.isin(systems)
    return frame[wanted].sort_values(list(KEY)).reset_index(drop=True)


def run_sequence(scenario: str, seed: int, systems: Sequence[SystemKind], code: str) -> list[Row]:
    """One row per system over one sequence."""
    sequence = open_sequence(scenario, seed)
    if sequence.T_world_cam is None:
        raise InputError(scenario, "has no ground truth", "name a sequence or scenario with ground truth")
    records = {system: execute(sequence, system, seed) for system in systems}
    about = {"scenario": scenario, "seed": seed}
    return [
        {**about, "system": s, **declaration_row(r), "code": code, "commit": commit()}
        for s, r in records.items()
    ]


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
