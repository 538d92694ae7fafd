"""The smoke experiment: seeds of one scenario through base and Dual-SLAM, counted against Eq. 1, free arm."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from experiments.output import new_directory
from experiments.provenance import commit
from experiments.smoke_trial import Outcome, empty_row, run_trial
from experiments.statistics.intervals import Proportion, clopper_pearson
from scenarios.spec import Scenario

TABLE_FILE = "units.parquet"
Trial = Callable[[Scenario, int], dict[str, Any]]

_BOOLEANS = (
    "breakage", "relocalized", "base_failure", "silent_failure", "recovery_ran", "recovered_declared",
    "false_recovery", "recovery_failure", "no_reinit", "dual_failure",
)  # fmt: skip
_INTEGERS = (
    "seed", "breakage_frame", "dual_breakage_frame", "frames_covered", "dual_breakages", "dual_recoveries",
    "dual_maps",
)  # fmt: skip
_TEXTS = (
    "scenario", "outcome", "message", "commit", "void_reason", "breakage_segment", "breakage_reason",
    "recovery_stage", "recovery_reason",
)  # fmt: skip


@dataclass(frozen=True)
class SmokeResult:
    """The counts of a smoke experiment.

    Attributes:
        units, void, errors: units run; void for an unhealthy lead-in; lost to infrastructure.
        p0: base breaks in an exposed segment, of all healthy units.
        pr_given_b: recovery fails, of the units that broke: conditional on breakage.
        predicted: the product of the two; by the chain rule the same as ``measured``, so no test of Eq. 1.
        measured: base breaks and recovery fails, of all healthy units.
        relocalized: the base relocalizes later, of the units that broke; it is a breakage all the same.
        base_failure: the base is not tracking at the end, of all healthy units.
        silent: an exposed segment corrupted the base's map and nothing was declared, of all healthy units.
        no_reinit, false_recovery: of the units that broke; of the fusions accepted and judged.
    """

    units: int
    void: int
    errors: int
    p0: Proportion
    pr_given_b: Proportion
    predicted: float | None
    measured: Proportion
    relocalized: Proportion
    base_failure: Proportion
    silent: Proportion
    no_reinit: Proportion
    false_recovery: Proportion


def run_smoke(
    scenarios: Sequence[Scenario],
    out_dir: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
    trial: Trial | None = None,
) -> tuple[SmokeResult, list[dict[str, Any]]]:
    """Run one unit per scenario, with its own seed, and write one row for each.

    Args:
        scenarios: what happens, all of one family.
        out_dir: result folder, absent or empty; gets units.parquet.
        workers: processes; rows do not depend on it.
        progress: called with (units done, units in all).
        trial: one unit; rendering and running by default.

    Raises:
        InputError: the folder is taken or not writable, or the disk is full.
    """
    rows: list[dict[str, Any]] = []
    with new_directory(out_dir) as folder:
        for row in _run(scenarios, workers, trial or rendered_trial):
            rows.append(row)
            if progress is not None:
                progress(len(rows), len(scenarios))
        rows.sort(key=lambda r: r["seed"])
        write_table(folder / TABLE_FILE, rows)
    return count(rows), rows


def rendered_trial(scenario: Scenario, seed: int) -> dict[str, Any]:
    """One unit, rendered or taken from the render cache."""
    import cv2

    cv2.setNumThreads(1)
    return run_trial(scenario, seed, _render)


def count(rows: Iterable[dict[str, Any]]) -> SmokeResult:
    """The counts and intervals of a table of units."""
    rows = list(rows)
    done = [r for r in rows if r["outcome"] == Outcome.COMPLETED]
    broken = [r for r in done if r["breakage"]]
    fused = [r for r in broken if r["false_recovery"] is not None]
    p0 = _share(done, "breakage")
    pr = _share(broken, "recovery_failure")
    predicted = None if p0.estimate is None else p0.estimate * (pr.estimate or 0.0)
    return SmokeResult(
        units=len(rows),
        void=sum(r["outcome"] == Outcome.VOID for r in rows),
        errors=sum(r["outcome"] == Outcome.INFRASTRUCTURE_ERROR for r in rows),
        p0=p0,
        pr_given_b=pr,
        predicted=predicted,
        measured=_share(done, "dual_failure"),
        relocalized=_share(broken, "relocalized"),
        base_failure=_share(done, "base_failure"),
        silent=_share(done, "silent_failure"),
        no_reinit=_share(broken, "no_reinit"),
        false_recovery=_share(fused, "false_recovery"),
    )


def write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write the units as Parquet, every column with the same type whatever the rows hold."""
    names = list(rows[0]) if rows else ["scenario", "seed", "outcome"]
    schema = pa.schema([(name, _type(name)) for name in names], metadata={"commit": commit() or ""})
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), path)


def _run(scenarios: Sequence[Scenario], workers: int, trial: Trial) -> Iterator[dict[str, Any]]:
    if workers == 1:
        yield from (trial(scenario, scenario.seed) for scenario in scenarios)
        return
    # Spawned, not forked: a process that holds a GL context must not fork.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(trial, scenario, scenario.seed): scenario for scenario in scenarios}
        for future in as_completed(futures):
            try:
                yield future.result()
            except BrokenProcessPool as error:
                # A worker was killed, by the system for want of memory as a rule.
                scenario = futures[future]
                yield empty_row(scenario, scenario.seed) | {"message": f"worker died: {error}"}


def _render(scenario: Scenario, seed: int):
    from sim.render import render_sequence

    return render_sequence(scenario, seed)


def _share(rows: list[dict[str, Any]], column: str) -> Proportion:
    return clopper_pearson(sum(bool(r[column]) for r in rows), len(rows))


def _type(name: str) -> pa.DataType:
    if name in _BOOLEANS:
        return pa.bool_()
    if name in _INTEGERS:
        return pa.int64()
    return pa.string() if name in _TEXTS else pa.float64()
