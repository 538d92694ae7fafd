"""Random scenarios through the systems, to find exceptions, hangs and inconsistent maps.

Accuracy is not judged. Every unit runs in a worker process, which it may block or crash. The invariants are
checked at every frame with an event, and at the end.
"""

import hashlib
import json
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.fuzz.drawn_threads import drawn_kinds, drawn_settings
from dslab.experiments.jobs.pool import Ended, Pool, PoolSettings, open_pool
from dslab.experiments.runs.ending import EndKind
from dslab.experiments.runs.execution import (
    Mode,
    RunRecord,
    SystemFactory,
    SystemKind,
    execute,
    system_factory,
)
from dslab.experiments.runs.files import plain
from dslab.experiments.runs.provenance import commit
from dslab.scenarios.loading import dump_yaml
from dslab.scenarios.random_scenarios import random_scenario
from dslab.scenarios.spec import Scenario
from dslab.sim.io.folders import new_directory
from dslab.sim.sequence import Sequence as ImageSequence
from dslab.sim.sequence_rendering import render_sequence
from dslab.sim.unfinished import scratch_folder
from dslab.slam.core.events import Event
from dslab.slam.core.results import TrackingResult
from dslab.slam.invariants import InvariantError, check_result, check_system
from dslab.slam.system import MonocularSystem

UNITS_FILE = "units.jsonl"
TIMES_FILE = "times.jsonl"
FAILED_DIR = "failed"


class FuzzOutcome(StrEnum):
    """Outcome of a run."""

    OK = "ok"
    EXCEPTION = "exception"
    INVARIANT = "invariant_broken"
    TIMEOUT = "timeout"
    DIED = "process_died"


@dataclass(frozen=True)
class FuzzUnit:
    """One scenario, rendered once, through one or more systems.

    Attributes:
        seed: of the scenario, the images, the recovery threads and the systems.
        systems: the systems, in the order of their runs.
        mode: threaded systems are checked only at the end.
    """

    seed: int
    systems: tuple[SystemKind, ...]
    mode: Mode = "lockstep"


def run_fuzz(
    units: Sequence[FuzzUnit],
    out_dir: Path,
    workers: int = 1,
    timeout_s: float = 600.0,
    progress: Callable[[dict[str, Any], int, int], None] | None = None,
    job: Callable[[FuzzUnit], Iterator[dict[str, Any]]] | None = None,
) -> list[dict[str, Any]]:
    """Run units and write one row per system of each.

    A unit whose process dies or is late is run again one system at a time, so that only the system at fault
    fails.

    Args:
        units: the units to run.
        out_dir: absent or empty; gets units.jsonl, the same bytes for any number of processes; times.jsonl;
            and under ``failed`` the scenario of every unit that failed.
        workers: number of processes.
        timeout_s: longest duration of one system's run and the rendering before it.
        progress: called with each new row, runs done and runs in all.
        job: runs one unit; :func:`fuzz_unit` by default.

    Returns:
        The rows, in order of seed and system.

    Raises:
        InputError: the folder is taken or not writable, or the disk is full.
    """
    order = {(unit.seed, kind): at for unit in units for at, kind in enumerate(unit.systems)}
    rows: list[dict[str, Any]] = []
    with new_directory(out_dir) as folder:
        with open_pool(partial(_rows_of, job or fuzz_unit), PoolSettings(workers, None, timeout_s)) as pool:
            for row in _run(pool, units):
                rows.append(row)
                if progress is not None:
                    progress(row, len(rows), len(order))
        rows.sort(key=lambda row: (row["seed"], order[row["seed"], row["system"]]))
        _write(folder, rows)
    return rows


def fuzz_unit(unit: FuzzUnit, build: SystemFactory | None = None) -> Iterator[dict[str, Any]]:
    """Render a unit and run each of its systems over it; one row each. Never raises.

    Args:
        unit: the unit to run.
        build: makes the systems; those of the project by default.
    """
    started = time.process_time()
    scenario = random_scenario(unit.seed)
    # These frames are used once: they are not kept in the cache.
    with scratch_folder() as cache:
        try:
            sequence = render_sequence(scenario, cache_dir=cache)
        except Exception as error:
            for kind in unit.systems:
                yield empty_row(unit, kind, scenario) | _failure(error, "render")
            return
        render_cpu_s = time.process_time() - started
        for kind in unit.systems:
            yield fuzz_run(unit, kind, scenario, sequence, build) | {"render_cpu_s": render_cpu_s}


def fuzz_run(
    unit: FuzzUnit,
    kind: SystemKind,
    scenario: Scenario,
    sequence: ImageSequence,
    build: SystemFactory | None = None,
) -> dict[str, Any]:
    """Run one checked system over the frames of a unit and return its row. Never raises."""
    row = empty_row(unit, kind, scenario)
    checks = _Checks(each_frame=unit.mode == "lockstep")
    started = time.process_time()
    try:
        record = execute(
            sequence, kind, unit.seed, observer=checks, at_end=lambda system, _: check_system(system),
            build=build or system_factory(unit.mode, drawn_settings(unit.seed, kind)),
        )  # fmt: skip
        row |= {"outcome": FuzzOutcome.OK.value, **_figures(record)}
    except Exception as error:  # any error is a finding
        row |= _failure(error, f"frame {checks.frames}")
    row["slam_cpu_s"] = time.process_time() - started
    return row


def empty_row(unit: FuzzUnit, kind: SystemKind, scenario: Scenario | None = None) -> dict[str, Any]:
    """A row with every column, before the run."""
    scenario = scenario or random_scenario(unit.seed)
    counts = ("frames", "tracked", "maps", "digest", *_COUNTED)
    return {
        "seed": unit.seed,
        "system": kind,
        "mode": unit.mode,
        "recovery": drawn_kinds(unit.seed, kind),
        "scenario": scenario.name,
        "segments": len(scenario.segments),
        "outcome": FuzzOutcome.DIED.value,
        "stage": "",
        "message": "",
        "traceback": "",
        **dict.fromkeys(counts),
        "render_cpu_s": None,
        "slam_cpu_s": None,
    }


def failed(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of failed runs."""
    return [row for row in rows if row["outcome"] != FuzzOutcome.OK]


def replay_command(row: dict[str, Any]) -> str:
    """The command that repeats the run of a row."""
    return (
        f"dslab experiment fuzz --start {row['seed']} --units 1 --system {row['system']} "
        f"--mode {row['mode']} --out out/fuzz-{row['seed']}"
    )


class _Checks:
    """Checks invariants during a run: of every result, and of the whole system after an event."""

    def __init__(self, each_frame: bool) -> None:
        self.frames = 0
        self._each_frame = each_frame
        self._events = 0

    def frame(self, image: np.ndarray, result: TrackingResult, system: MonocularSystem) -> None:
        check_result(result)
        if self._each_frame and len(system.events) > self._events:
            self._events = len(system.events)
            check_system(system)
        self.frames += 1


_COUNTED: dict[str, Callable[[Event], bool]] = {
    "breakages": lambda e: e.kind == "breakage",
    "relocalizations": lambda e: e.kind == "relocalized",
    "loops": lambda e: e.kind == "loop_closed",
    "dropped_maps": lambda e: e.kind == "map_dropped",
    "recoveries_begun": lambda e: e.kind == "recovery_start",
    "recoveries_ended": lambda e: e.kind == "recovery_end",
    "recovered": lambda e: e.kind == "recovery_end" and e.record()["success"],
    "fusions": lambda e: e.kind == "fusion" and e.record()["accepted"],
}


def _figures(record: RunRecord) -> dict[str, Any]:
    return {
        "frames": len(record.results),
        "tracked": sum(result.T_map_cam is not None for result in record.results),
        "maps": len(record.trajectories),
        "digest": _digest(record),
        **{name: sum(map(counts, record.events)) for name, counts in _COUNTED.items()},
    }


def _digest(record: RunRecord) -> str:
    """Hash of all poses and events, bit by bit, without computing times."""
    digest = hashlib.sha256()
    for path in (*record.trajectories, *record.keyframes):
        for array in (path.frames, path.stamps_s, path.T_map_cam):
            digest.update(np.ascontiguousarray(array).tobytes())
    for event in record.events:
        fields = {name: value for name, value in event.record().items() if name != "cpu_ms"}
        digest.update(json.dumps(plain(fields), sort_keys=True).encode())
    return digest.hexdigest()[:16]


def _failure(error: Exception, stage: str) -> dict[str, Any]:
    broken = isinstance(error, InvariantError)
    return {
        "outcome": (FuzzOutcome.INVARIANT if broken else FuzzOutcome.EXCEPTION).value,
        "stage": stage,
        "message": f"{type(error).__name__}: {error}",
        "traceback": "".join(traceback.format_exception(error)),
    }


def _rows_of(job: Callable[[FuzzUnit], Iterator[dict[str, Any]]], unit: FuzzUnit) -> list[dict[str, Any]]:
    return list(job(unit))


def _run(pool: Pool, units: Sequence[FuzzUnit]) -> Iterator[dict[str, Any]]:
    waiting = deque(units)
    for ended in pool.run(waiting):
        unit: FuzzUnit = ended.item
        if ended.value is not None:
            yield from ended.value
        elif len(unit.systems) > 1:
            waiting.extendleft(replace(unit, systems=(kind,)) for kind in reversed(unit.systems))
        else:
            yield _row_of_failure(ended)


def _row_of_failure(ended: Ended) -> dict[str, Any]:
    outcome = FuzzOutcome.TIMEOUT if ended.fault is EndKind.TIMED_OUT else FuzzOutcome.DIED
    trace = ended.report or ended.message
    found = {"outcome": outcome.value, "message": ended.message, "traceback": trace}
    return empty_row(ended.item, ended.item.systems[0]) | found


def _write(folder: Path, rows: list[dict[str, Any]]) -> None:
    times = ("render_cpu_s", "slam_cpu_s")
    lasting = [{name: value for name, value in row.items() if name not in times} for row in rows]
    taken = [{name: row[name] for name in ("seed", "system", *times)} for row in rows]
    for name, table in ((UNITS_FILE, lasting), (TIMES_FILE, taken)):
        lines = [json.dumps(plain(row), allow_nan=False) + "\n" for row in table]
        (folder / name).write_text("".join(lines), encoding="utf-8")
    (folder / "commit.txt").write_text(f"{commit() or 'unknown'}\n")
    for seed in sorted({row["seed"] for row in failed(rows)}):
        (folder / FAILED_DIR).mkdir(exist_ok=True)
        (folder / FAILED_DIR / f"{seed}.yaml").write_text(dump_yaml(random_scenario(seed)))
