"""Random scenarios through the systems: does anything raise, hang, or leave an inconsistent map behind?

What the systems make of a scenario is not judged here. Every run is in a process that it may hang or bring
down, and the invariants are proved at every frame that something happened at, and at the end.
"""

import hashlib
import json
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from experiments.fuzz.isolation import Death, run_isolated
from experiments.runs.execution import Mode, RunRecord, SystemFactory, SystemKind, execute, system_factory
from experiments.runs.files import plain
from experiments.runs.output import new_directory
from experiments.runs.provenance import commit
from scenarios.loading import dump_yaml
from scenarios.random_scenarios import random_scenario
from scenarios.spec import Scenario
from sim.sequence import Sequence as ImageSequence
from sim.sequence_rendering import render_sequence
from slam.core.events import Event
from slam.core.results import TrackingResult
from slam.invariants import InvariantError, check_result, check_system
from slam.system import MonocularSlam

UNITS_FILE = "units.jsonl"
TIMES_FILE = "times.jsonl"
FAILED_DIR = "failed"


class FuzzOutcome(StrEnum):
    """How a run ended."""

    OK = "ok"
    EXCEPTION = "exception"
    INVARIANT = "invariant_broken"
    TIMEOUT = "timeout"
    DIED = "process_died"


@dataclass(frozen=True)
class FuzzUnit:
    """One scenario, rendered once, through one or more systems.

    Attributes:
        seed: of the scenario, the images and the systems.
        systems: in this order.
        mode: threaded systems are checked at the end only.
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

    Args:
        units: what to run.
        out_dir: absent or empty; gets units.jsonl, the same bytes for any number of processes; times.jsonl;
            and under ``failed`` the scenario of every unit that failed.
        workers: processes.
        timeout_s: the longest that one run, or the rendering before it, may take.
        progress: called with each row as it comes, runs done and runs in all.
        job: one unit; :func:`fuzz_unit` by default.

    Returns:
        The rows, in order of seed and system.

    Raises:
        InputError: the folder is taken or not writable, or the disk is full.
    """
    order = {(unit.seed, kind): at for unit in units for at, kind in enumerate(unit.systems)}
    rows: list[dict[str, Any]] = []
    with new_directory(out_dir) as folder:
        for row in run_isolated(job or fuzz_unit, units, workers, timeout_s, _owed):
            rows.append(row)
            if progress is not None:
                progress(row, len(rows), len(order))
        rows.sort(key=lambda row: (row["seed"], order[row["seed"], row["system"]]))
        _write(folder, rows)
    return rows


def fuzz_unit(unit: FuzzUnit, build: SystemFactory | None = None) -> Iterator[dict[str, Any]]:
    """Render a unit and run each of its systems over it; one row each. Never raises.

    Args:
        unit: what to run.
        build: makes the systems; those of the project by default.
    """
    import cv2

    cv2.setNumThreads(1)
    started = time.process_time()
    scenario = random_scenario(unit.seed)
    # Nobody asks for these frames again: they are not kept in the cache.
    with tempfile.TemporaryDirectory(prefix="dslab-") as cache:
        try:
            sequence = render_sequence(scenario, cache_dir=Path(cache))
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
    """One system over the frames of a unit, proved; its row. Never raises."""
    row = empty_row(unit, kind, scenario)
    checks = _Checks(each_frame=unit.mode == "lockstep")
    started = time.process_time()
    try:
        record = execute(
            sequence, kind, unit.seed, observer=checks, at_end=lambda system, _: check_system(system),
            build=build or system_factory(unit.mode),
        )  # fmt: skip
        row |= {"outcome": FuzzOutcome.OK.value, **_figures(record)}
    except Exception as error:  # whatever it is, it is what this is looking for
        row |= _failure(error, f"frame {checks.frames}")
    row["slam_cpu_s"] = time.process_time() - started
    return row


def empty_row(unit: FuzzUnit, kind: SystemKind, scenario: Scenario | None = None) -> dict[str, Any]:
    """Every column, nothing known yet of the run."""
    scenario = scenario or random_scenario(unit.seed)
    counts = ("frames", "tracked", "maps", "digest", *_COUNTED)
    return {
        "seed": unit.seed,
        "system": kind,
        "mode": unit.mode,
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
    """The rows that did not end well."""
    return [row for row in rows if row["outcome"] != FuzzOutcome.OK]


def replay_command(row: dict[str, Any]) -> str:
    """The command that runs one row again."""
    return (
        f"dslab experiment fuzz --start {row['seed']} --units 1 --system {row['system']} "
        f"--mode {row['mode']} --out out/fuzz-{row['seed']}"
    )


class _Checks:
    """Proves the invariants while a system runs: its answers always, the whole where something happened."""

    def __init__(self, each_frame: bool) -> None:
        self.frames = 0
        self._each_frame = each_frame
        self._events = 0

    def frame(self, image: np.ndarray, result: TrackingResult, system: MonocularSlam) -> None:
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
    """Of all poses and events, bit by bit, times of computing left out."""
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


def _owed(death: Death[FuzzUnit]) -> tuple[list[dict[str, Any]], FuzzUnit | None]:
    """The row of the run that a process died in; the systems after it have their turn in another one."""
    unit = death.item
    kind, left = unit.systems[death.rows], unit.systems[death.rows + 1 :]
    outcome = FuzzOutcome.TIMEOUT if death.timed_out else FuzzOutcome.DIED
    row = empty_row(unit, kind) | {"outcome": outcome.value, "traceback": death.report}
    row["message"] = death.report.splitlines()[0]
    return [row], replace(unit, systems=left) if left else None


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
