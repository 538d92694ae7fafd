"""Random scenarios through the systems, to find exceptions, hangs and inconsistent maps.

Accuracy is not judged. Every run is an item of the pool, whose process it may block or crash. The invariants
are checked at every frame with an event, and at the end.
"""

import hashlib
import json
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.jobs.pool import Ended, PoolSettings, open_pool
from dslab.experiments.runs.ending import EndKind
from dslab.experiments.runs.execution import (
    Mode,
    RunRecord,
    SystemFactory,
    SystemKind,
    execute,
    system_factory,
)
from dslab.experiments.runs.files import plain, to_json
from dslab.experiments.runs.provenance import commit
from dslab.scenarios.loading import dump_yaml
from dslab.scenarios.random_scenarios import random_scenario
from dslab.sim.io.folders import new_directory
from dslab.sim.sequence import Sequence as ImageSequence
from dslab.sim.sequence_rendering import render_sequence
from dslab.slam.core.events import Event
from dslab.slam.core.results import TrackingResult
from dslab.slam.core.seeds import rng_for
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.registry import ThreadSpec, parse_threads
from dslab.slam.factory import PAPERS
from dslab.slam.invariants import InvariantError, check_result, check_system
from dslab.slam.system import MonocularSystem

UNITS_FILE = "units.jsonl"
FAILED_DIR = "failed"
Row = dict[str, Any]
_KINDS = ("orb", "sift", "direct", "gms")  # those of the paper are the first two with other settings
_DRAWN = ("dual", "dual+")  # systems whose threads are drawn
_USUAL, _USUAL_SHARE, _MOST = "orb,sift", 0.3, 3


class FuzzOutcome(StrEnum):
    """Outcome of a run."""

    OK = "ok"
    EXCEPTION = "exception"
    INVARIANT = "invariant_broken"
    TIMEOUT = "timeout"
    DIED = "process_died"


@dataclass(frozen=True)
class FuzzUnit:
    """A scenario through a system.

    Attributes:
        seed: of the scenario, the images, the recovery threads and the system.
        system: the system.
        mode: threaded systems are checked only at the end.
    """

    seed: int
    system: SystemKind
    mode: Mode = "lockstep"


def run_fuzz(
    units: Sequence[FuzzUnit],
    out_dir: Path,
    workers: int = 1,
    timeout_s: float = 600.0,
    progress: Callable[[Row, int, int], None] | None = None,
    job: Callable[[FuzzUnit], Row] | None = None,
) -> list[Row]:
    """Run units and write a row of each.

    Args:
        units: the units to run.
        out_dir: absent or empty; gets units.jsonl, the same bytes for any number of processes, and under
            ``failed`` the scenario of every unit that failed.
        workers: number of processes.
        timeout_s: longest duration of a run and the rendering before it.
        progress: called with each new row, runs done and runs in all.
        job: runs a unit; :func:`fuzz_unit` by default.

    Returns:
        The rows, in the order of the units.

    Raises:
        InputError: the folder is taken or not writable, or the disk is full.
    """
    rows: dict[FuzzUnit, Row] = {}
    with new_directory(out_dir) as folder:
        with open_pool(job or fuzz_unit, PoolSettings(workers, None, timeout_s)) as pool:
            for ended in pool.run(deque(units)):
                row = rows[ended.item] = _row_of_failure(ended) if ended.value is None else ended.value
                if progress is not None:
                    progress(row, len(rows), len(units))
        in_order = [rows[unit] for unit in units]
        text = "".join(to_json(row) + "\n" for row in in_order)
        (folder / UNITS_FILE).write_text(text, encoding="utf-8")
        (folder / "commit.txt").write_text(f"{commit() or 'unknown'}\n")
        for seed in sorted({row["seed"] for row in failed(in_order)}):
            (folder / FAILED_DIR).mkdir(exist_ok=True)
            (folder / FAILED_DIR / f"{seed}.yaml").write_text(dump_yaml(random_scenario(seed)))
    return in_order


def fuzz_unit(
    unit: FuzzUnit, build: SystemFactory | None = None, sequence: ImageSequence | None = None
) -> Row:
    """Render a unit's scenario and run its system, which is checked. Never raises.

    Args:
        unit: the unit to run.
        build: makes the system; None for that of the project, with the threads of the seed.
        sequence: frames to run over instead.
    """
    row, checks = empty_row(unit), _Checks(each_frame=unit.mode == "lockstep")
    try:
        frames = sequence or render_sequence(random_scenario(unit.seed))
        checks.stage = "frame 0"
        dual = None if unit.system in PAPERS else DualConfig(recovery_threads=drawn_threads(unit.seed))
        record = execute(
            frames, unit.system, unit.seed, observer=checks, at_end=lambda system, _: check_system(system),
            build=build or system_factory(unit.mode, dual),
        )  # fmt: skip
        return row | {"outcome": FuzzOutcome.OK.value} | _figures(record)
    except Exception as error:  # any error is a finding
        broken = isinstance(error, InvariantError)
        return row | {
            "outcome": (FuzzOutcome.INVARIANT if broken else FuzzOutcome.EXCEPTION).value,
            "stage": checks.stage,
            "message": f"{type(error).__name__}: {error}",
            "traceback": "".join(traceback.format_exception(error)),
        }


def empty_row(unit: FuzzUnit) -> Row:
    """A row with every column, before the run."""
    scenario = random_scenario(unit.seed)
    threads = drawn_threads(unit.seed) if unit.system in _DRAWN else ()
    return {
        "seed": unit.seed,
        "system": unit.system,
        "mode": unit.mode,
        "recovery": ",".join(spec.kind for spec in threads),
        "scenario": scenario.name,
        "segments": len(scenario.segments),
        "outcome": FuzzOutcome.DIED.value,
        **dict.fromkeys(("stage", "message", "traceback"), ""),
        **dict.fromkeys(("frames", "tracked", "maps", "digest", *_COUNTED)),
    }


def drawn_threads(seed: int) -> tuple[ThreadSpec, ...]:
    """Draw the recovery threads of a seed: often those of Algorithm 1, else one to three in any order."""
    rng = rng_for(seed, "random", "recovery threads")
    if rng.random() < _USUAL_SHARE:
        return parse_threads(_USUAL)
    count = int(rng.integers(1, _MOST + 1))
    return parse_threads(",".join(rng.permutation(_KINDS)[:count]))


def failed(rows: Sequence[Row]) -> list[Row]:
    """The rows of failed runs."""
    return [row for row in rows if row["outcome"] != FuzzOutcome.OK]


def replay_command(row: Row) -> str:
    """The command that repeats the run of a row."""
    return (
        f"dslab experiment fuzz --start {row['seed']} --units 1 --system {row['system']} "
        f"--mode {row['mode']} --out out/fuzz-{row['seed']}"
    )


class _Checks:
    """Checks invariants during a run: of every result, and of the whole system after an event."""

    def __init__(self, each_frame: bool) -> None:
        self.stage = "render"
        self._each_frame = each_frame
        self._events = 0

    def frame(self, image: np.ndarray, result: TrackingResult, system: MonocularSystem) -> None:
        check_result(result)
        if self._each_frame and len(system.events) > self._events:
            self._events = len(system.events)
            check_system(system)
        self.stage = f"frame {result.frame + 1}"


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


def _figures(record: RunRecord) -> Row:
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


def _row_of_failure(ended: Ended) -> Row:
    outcome = FuzzOutcome.TIMEOUT if ended.fault is EndKind.TIMED_OUT else FuzzOutcome.DIED
    trace = ended.report or ended.message
    return empty_row(ended.item) | {"outcome": outcome.value, "message": ended.message, "traceback": trace}
