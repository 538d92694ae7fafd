"""The record of a unit: one flat row with the same columns for every unit of an experiment.

Booleans are null if they do not apply: a recovery that was never due has neither failed nor succeeded. Names
follow Eq. 1: B a breakage, R_j the failure of recovery thread j, D_n the failure of Dual-SLAM with n threads.
"""

import traceback
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

from experiments.eq1.units import UnitSpec
from scenarios.errors import InputError

ColumnType = Literal["bool", "int", "float", "text"]


class Outcome(StrEnum):
    """Outcome of a unit."""

    COMPLETED = "completed"
    VOID = "void"
    INFRASTRUCTURE_ERROR = "infrastructure_error"


UNIT_COLUMNS: dict[str, tuple[ColumnType, str]] = {
    "unit_id": ("text", "content hash of the unit's spec"),
    "experiment": ("text", "name of the experiment"),
    "cell": ("text", "name of the cell"),
    "kind": ("text", "kind of the degradation"),
    "severity": ("float", "its dose"),
    "index": ("int", "number of the unit in its cell"),
    "world": ("text", "kind of the world"),
    "world_seed": ("int", "seed of the world: units that share it are a cluster"),
    "nuisance_seed": ("int", "seed of all else"),
    "code": ("text", "hash of the sources of sim, scenarios and slam"),
    "commit": ("text", "commit of the code"),
    "outcome": ("text", "completed, void or infrastructure_error"),
    "message": ("text", "of an infrastructure error"),
    "attempts": ("int", "number of tries, above 1 only after infrastructure errors"),
    "void_reason": ("text", "reason why the lead-in was not healthy"),
    "onset_s": ("float", "start of the exposed segment"),
    "exposed_s": ("float", "its length"),
    "onset_frame": ("int", "first frame of the exposed segment"),
    "end_frame": ("int", "last frame of the exposed segment"),
    # Base, and the dual up to the breakage.
    "breakage": ("bool", "B: tracking was declared lost in the exposed segment"),
    "breakage_frame": ("int", "frame of the declaration"),
    "breakage_reason": ("text", "as declared"),
    "declaration_delay_s": ("float", "from the true loss to the declaration"),
    "silent_failure": ("bool", "the segment corrupted the map and no breakage was declared"),
    "relocalized": ("bool", "given B: the base relocalized"),
    "base_failure": ("bool", "the base ends without an intact map"),
    "base_share_tracked": ("float", "share of frames tracked"),
    "base_ate_m": ("float", "ATE of the largest map"),
    "base_path_share": ("float", "share of the path that this map covers"),
    "base_end_error_m": ("float", "position error of the last pose, aligned on the lead-in"),
    # Free arm, given B.
    "reinit": ("bool", "given B: a new map was initialized before the end"),
    "reinit_frame": ("int", "its frame"),
    "free_frames_to_cross": ("int", "frames from the old map's last correct pose to the new map's first"),
    "dual_share_tracked": ("float", "share of frames with a final pose, of the dual with all its threads"),
    "dual_ate_m": ("float", "ATE of its largest map"),
    "dual_path_share": ("float", "share of the path that this map covers"),
    "dual_end_error_m": ("float", "position error of the last pose, aligned on the lead-in"),
    "dual_failure": ("bool", "B, and the first thread to declare success was false, or none declared it"),
    "dual_relocalized": ("bool", "given B: the dual continued in the broken map by relocalization"),
    # Crossing arm.
    "cross_reinit": ("bool", "a new map was initialized after the exposed segment"),
    "cross_reinit_frame": ("int", "its frame"),
    "cross_frames_to_cross": ("int", "frames from the onset to the new map's first"),
    # Costs.
    "render_s": ("float", "CPU time of rendering"),
    "slam_s": ("float", "CPU time within the systems"),
    "cpu_s": ("float", "CPU time of the unit"),
    "wall_s": ("float", "elapsed"),
    "peak_rss_mb": ("float", "largest resident memory of the process during the unit"),
}

THREAD_COLUMNS: dict[str, tuple[ColumnType, str]] = {
    "failed": ("bool", "R_j: it did not relate the maps, or its fusion is false by the audit"),
    "declared": ("bool", "it declared that it related the maps"),
    "false": ("bool", "given declared: out of bounds by the audit (false recovery)"),
    "stage": ("text", "stage of its failure: propagation, overlap, sim3, fusion, audit, no_reinit"),
    "reason": ("text", "reason of its failure"),
    "frames_covered": ("int", "number of frames that it went back"),
    "scale_error": ("float", "given declared: scale over the true one, minus 1"),
    "seam_error_m": ("float", "given declared: position error of the new map in the old one"),
    "cpu_ms": ("float", "its CPU time; less in an arm that runs later and reuses features"),
    "inliers": ("int", "of its alignment"),
}
"""Per arm and thread, named ``free_r1_failed``, ``cross_r2_cpu_ms`` and so on; ``free_`` only given B."""

PAIR_GAPS = (1, 3, 9, 27)
"""Gaps, in frames, between the two frames of a pair, for the columns below."""

PAIRS_PER_GAP = 8
"""Number of pairs of each gap; fewer in a short lead-in."""

PAIR_COLUMNS: dict[str, tuple[ColumnType, str]] = {
    "count": ("int", "pairs of the lead-in whose relative pose was estimated, of ``PAIRS_PER_GAP``"),
    "matches": ("float", "matches of a pair"),
    "baseline_m": ("float", "true distance of its two cameras"),
    "rotation_deg": ("float", "error of its rotation"),
    "direction_deg": ("float", "angle between estimated and true direction of translation"),
}
"""Per gap, named ``pairs1_count``, ``pairs27_direction_deg`` and so on: medians over the pairs of the gap."""

DUAL_COLUMN = "d{n}"
"""``d1`` … ``dn`` (bool): Dual-SLAM failed with the first n threads: B and R_1 … R_n of the free arm."""


MEASURED_COLUMNS = ("attempts", "render_s", "slam_s", "cpu_s", "wall_s", "peak_rss_mb")
"""Columns that may differ between two runs of a unit, besides the threads' ``cpu_ms``."""


def decided(record: dict[str, Any]) -> dict[str, Any]:
    """The columns of a record that unit and code determine, bit for bit, in every run."""
    return {k: v for k, v in record.items() if k not in MEASURED_COLUMNS and not k.endswith("_cpu_ms")}


def thread_column(arm: Literal["free", "cross"], thread: int, name: str) -> str:
    """The name of a thread's column; threads count from 1."""
    return f"{arm}_r{thread}_{name}"


def pair_column(gap: int, name: str) -> str:
    """The name of a column of the pairs of frames with this gap."""
    return f"pairs{gap}_{name}"


def dual_column(threads: int) -> str:
    """The name of the column of D_n."""
    return DUAL_COLUMN.format(n=threads)


def columns(threads: int) -> dict[str, ColumnType]:
    """Every column of an experiment with this many recovery threads, in order, with its type."""
    named: dict[str, ColumnType] = {name: kind for name, (kind, _) in UNIT_COLUMNS.items()}
    for arm in ("free", "cross"):
        for thread in range(1, threads + 1):
            named |= {thread_column(arm, thread, n): kind for n, (kind, _) in THREAD_COLUMNS.items()}
    whole: dict[str, ColumnType] = {dual_column(n): "bool" for n in range(1, threads + 1)}
    pairs: dict[str, ColumnType] = {
        pair_column(gap, n): kind for gap in PAIR_GAPS for n, (kind, _) in PAIR_COLUMNS.items()
    }
    return named | whole | pairs


def empty_record(unit: UnitSpec) -> dict[str, Any]:
    """The record of a unit before its run: null in every column but those that identify it."""
    return dict.fromkeys(columns(len(unit.threads))) | {
        "unit_id": unit.unit_id,
        "experiment": unit.experiment,
        "cell": unit.cell,
        "kind": unit.kind,
        "severity": unit.severity,
        "index": unit.index,
        "world": unit.scenario.world.kind,
        "world_seed": unit.world_seed,
        "nuisance_seed": unit.nuisance_seed,
        "outcome": Outcome.INFRASTRUCTURE_ERROR.value,
        "message": "",
        "attempts": 1,
    }


def error_message(error: Exception) -> str:
    """One line about an error; with its type and place unless it is an InputError."""
    if isinstance(error, InputError):
        return str(error)
    at = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(at.filename).name}:{at.lineno})"
