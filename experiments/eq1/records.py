"""The record of a unit: one flat row with the same columns for every unit of an experiment.

Booleans are null if they do not apply: a recovery that was never due has neither failed nor succeeded. Names
follow Eq. 1: B a breakage, R_j the failure of recovery thread j; with J the first n threads, D_J is B and the
failure of all of them, S_J the failure of the system, M_J that of its mission.
"""

import math
import traceback
from collections.abc import Mapping
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, Literal

from dslab.experiments.eq1.units import UnitSpec, system_label
from dslab.scenarios.errors import InputError

ColumnType = Literal["bool", "int", "float", "text"]
Domain = Literal["bool", "int", "count", "float", "amount", "share", "text", "name"]
DOMAINS: dict[Domain, tuple[ColumnType, float, float]] = {
    "bool": ("bool", 0, 1),
    "int": ("int", -(2**63), 2**63 - 1),
    "count": ("int", 0, 2**63 - 1),
    "float": ("float", -math.inf, math.inf),
    "amount": ("float", 0, math.inf),
    "share": ("float", 0, 1),
    "text": ("text", -math.inf, math.inf),
    "name": ("text", -math.inf, math.inf),
}
"""Type, least and largest value of each domain; a name is a text that is not empty."""

ROUNDING = 1e-9
"""How far a share, a ratio of sums, may lie beyond its ends by their rounding; further, and it is wrong."""


SHAM = "sham"
"""Kind of the cells without a degradation."""


class Outcome(StrEnum):
    """Outcome of a unit."""

    COMPLETED = "completed"
    VOID = "void"
    INFRASTRUCTURE_ERROR = "infrastructure_error"


UNIT_COLUMNS: dict[str, tuple[Domain, str]] = {
    "unit_id": ("name", "content hash of the unit's spec"),
    "experiment": ("name", "name of the experiment"),
    "cell": ("name", "name of the cell"),
    "base": ("name", "name of its base: one kind of world and of motion"),
    "system": ("name", "name of the system"),
    "kind": ("name", "kind of the degradation"),
    "severity": ("float", "its dose"),
    "index": ("count", "number of the unit in its cell"),
    "world": ("name", "kind of the world"),
    "sequence": ("count", "number of its sequence in its world"),
    "repeat": ("count", "number of the replicate in its sequence"),
    "world_seed": ("count", "seed of the world: worlds are the sample"),
    "sequence_seed": ("count", "seed of path, camera and draws of the segment"),
    "repeat_seed": ("count", "seed of noise, start frame, SLAM and threads"),
    "start_frame": ("count", "first frame of the scenario that was fed; frames count from it"),
    "code": ("text", "hash of the sources of sim, scenarios and slam"),
    "commit": ("text", "commit of the code"),
    "system_digest": ("text", "hash of the class or the description of a system that is not ours"),
    "outcome": ("name", "completed, void or infrastructure_error"),
    "message": ("text", "of an infrastructure error"),
    "attempts": ("count", "number of tries, above 1 only after infrastructure errors"),
    "void_reason": ("text", "reason why the lead-in was not healthy"),
    "onset_s": ("amount", "start of the exposed segment"),
    "exposed_s": ("amount", "its length"),
    "onset_frame": ("count", "first frame of the exposed segment"),
    "end_frame": ("count", "last frame of the exposed segment"),
    "exposed": (
        "bool",
        "the stress acted: its own measure reaches its threshold on a frame of its time; null for a sham",
    ),
    "declares": ("name", "what the system says of itself: events, losses or nothing"),
    "ended": ("name", "how its run ended: finished, or what went wrong in a system that is not ours"),
    "ended_message": ("text", "a line about that"),
    # Base, and the dual up to the breakage; any other system.
    "breakage": (
        "bool",
        "B: tracking was declared lost in the exposed segment; of a system that declares nothing: truly lost",
    ),
    "breakage_frame": ("count", "frame of the declaration"),
    "breakage_reason": ("text", "as declared"),
    "declaration_delay_s": ("float", "from the true loss to the declaration"),
    "silent_failure": (
        "bool",
        "the segment corrupted the map and no breakage was declared; null for a system that declares nothing",
    ),
    "view_overlap": ("share", "largest view overlap of usable frames on either side of the stress"),
    "rescuable": ("bool", "it is enough for a recovery by images; never shown to the SLAM"),
    # The base; beside a system with initialisation by GMS the plain one, with a map of its own.
    "base_breakage": ("bool", "it declared tracking lost in the exposed segment"),
    "relocalized": (
        "bool",
        "given its breakage: it relocalized, before the next one; of a system without recovery threads: it "
        "came back",
    ),
    "base_failure": ("bool", "it broke and did not relocalize"),
    "base_mission_failure": ("bool", "the same, or silent, false, or its final pose is off"),
    "base_mission_cause": ("text", "which of these was first"),
    "base_share_tracked": ("share", "share of frames with a final pose in the main map"),
    "base_ate_m": ("amount", "ATE of the largest map"),
    "base_keyframe_ate_m": ("amount", "the same over its keyframes, as in the paper's Table I"),
    "base_path_share": ("share", "share of the path that this map covers"),
    "base_end_error_m": ("amount", "position error of the last pose, aligned on the lead-in"),
    "base_false_loops": ("count", "loops it closed that are false by the audit"),
    "base_false_relocalizations": ("count", "relocalizations it declared and did not withdraw, likewise"),
    "base_unjudged": ("count", "loops and relocalizations that the audit could not judge"),
    # Free arm, given B.
    "reinit": ("bool", "given B: a new map was initialized before the end"),
    "reinit_frame": ("count", "its frame"),
    "free_frames_to_cross": ("int", "frames from the old map's last correct pose to the new map's first"),
    # Dual-SLAM with all its threads; any other system.
    "dual_share_tracked": ("share", "share of frames with a final pose in the main map"),
    "dual_ate_m": ("amount", "ATE of its largest map"),
    "dual_keyframe_ate_m": ("amount", "the same over its keyframes"),
    "dual_path_share": ("share", "share of the path that this map covers"),
    "dual_end_error_m": ("amount", "position error of the last pose, aligned on the lead-in"),
    "dual_false_loops": ("count", "loops it closed that are false by the audit"),
    "dual_false_relocalizations": ("count", "relocalizations it declared and did not withdraw, likewise"),
    "dual_false_fusions": ("count", "fusions by a recovery, likewise"),
    "dual_false_joins": ("count", "fusions by place, likewise"),
    "dual_unjudged": ("count", "of all these, those that the audit could not judge"),
    "mission_cause": ("text", "what failed first in its mission, with all its threads"),
    # Crossing arm.
    "cross_reinit": ("bool", "a new map was initialized after the exposed segment"),
    "cross_reinit_frame": ("count", "its frame"),
    "cross_frames_to_cross": ("int", "frames from the onset to the new map's first"),
    # Costs.
    "render_s": ("amount", "CPU time of rendering"),
    "slam_s": ("amount", "CPU time within the systems"),
    "cpu_s": ("amount", "CPU time of the unit"),
    "wall_s": ("amount", "elapsed"),
    "peak_rss_mb": ("amount", "largest resident memory of the process during the unit"),
}

THREAD_COLUMNS: dict[str, tuple[Domain, str]] = {
    "failed": ("bool", "R_j: it did not relate the maps, or its fusion is false by the audit"),
    "declared": ("bool", "it declared that it related the maps"),
    "false": ("bool", "given declared: out of bounds by the audit (false recovery)"),
    "stage": ("text", "stage of its failure: propagation, overlap, sim3, fusion, audit, no_reinit"),
    "reason": ("text", "reason of its failure"),
    "frames_covered": ("count", "number of frames that it went back"),
    "scale_error": ("float", "given declared: scale over the true one, minus 1"),
    "seam_error_m": ("amount", "given declared: position error of the new map in the old one"),
    "cpu_ms": ("amount", "its CPU time, with that of features found before"),
    "inliers": ("count", "of its alignment"),
}
"""Per arm and thread, named ``free_r1_failed``, ``cross_r2_cpu_ms`` and so on; ``free_`` only given B."""

PAIR_GAPS = (1, 3, 9, 27)
"""Gaps, in frames, between the two frames of a pair, for the columns below."""

PAIRS_PER_GAP = 8
"""Number of pairs of each gap; fewer in a short lead-in."""

PAIR_COLUMNS: dict[str, tuple[Domain, str]] = {
    "count": ("count", "pairs of the lead-in whose relative pose was estimated, of ``PAIRS_PER_GAP``"),
    "matches": ("amount", "matches of a pair"),
    "baseline_m": ("amount", "true distance of its two cameras"),
    "rotation_deg": ("amount", "error of its rotation"),
    "direction_deg": ("amount", "angle between estimated and true direction of translation"),
}
"""Per gap, named ``pairs1_count``, ``pairs27_direction_deg`` and so on: medians over the pairs of the gap."""

FAILURES = {
    "d": "B and all of R_1 … R_n of the free arm: D_J",
    "s": "B and, of the first n threads, none declared success or the first to do so was false: S_J",
    "m": "S_J, or silent, or a false declaration, or a final pose out of bounds: M_J",
}
"""Failures of Dual-SLAM with the first n threads (bool), named ``d1`` … ``dn``, ``s1`` …, ``m1`` ….

Of a system without recovery threads S is B without coming back. S and M are then the same for every n, and D
is null.
"""


NEVER_NULL = frozenset(
    {
        *("unit_id", "experiment", "cell", "kind", "severity", "index"),
        *("world", "world_seed", "outcome", "message", "attempts"),
    }
)
"""Columns with a value in every record."""

GIVEN_BREAKAGE = frozenset(
    {
        *("breakage_frame", "breakage_reason", "reinit", "reinit_frame", "free_frames_to_cross"),
    }
)
"""Columns that are null without a breakage, besides those of the threads in the free arm."""

MEASURED_COLUMNS = ("attempts", "render_s", "slam_s", "cpu_s", "wall_s", "peak_rss_mb")
"""Columns that may differ between two runs of a unit, besides the threads' ``cpu_ms``."""


def reproduced(record: dict[str, Any]) -> dict[str, Any]:
    """The decided columns without those that name the code: equal if two codes do the same."""
    return {k: v for k, v in decided(record).items() if k not in ("code", "commit")}


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
    """The name of the column of D_J with the first ``threads`` threads."""
    return failure_column("d", threads)


def failure_column(failure: Literal["d", "s", "m"], threads: int) -> str:
    """The name of the column of D_J, S_J or M_J with the first ``threads`` threads."""
    return f"{failure}{threads}"


@cache
def domains(threads: int) -> Mapping[str, Domain]:
    """Every column of an experiment with this many recovery threads, in order, with its domain."""
    named: dict[str, Domain] = {name: domain for name, (domain, _) in UNIT_COLUMNS.items()}
    for arm in ("free", "cross"):
        for thread in range(1, threads + 1):
            named |= {thread_column(arm, thread, n): domain for n, (domain, _) in THREAD_COLUMNS.items()}
    whole: dict[str, Domain] = {
        failure_column(failure, n): "bool" for failure in ("d", "s", "m") for n in range(1, threads + 1)
    }
    pairs: dict[str, Domain] = {
        pair_column(gap, n): domain for gap in PAIR_GAPS for n, (domain, _) in PAIR_COLUMNS.items()
    }
    return named | whole | pairs


def columns(threads: int) -> dict[str, ColumnType]:
    """Every column of an experiment with this many recovery threads, in order, with its type."""
    return {name: DOMAINS[domain][0] for name, domain in domains(threads).items()}


def empty_record(unit: UnitSpec) -> dict[str, Any]:
    """The record of a unit before its run: null in every column but those that identify it."""
    return dict.fromkeys(columns(len(unit.threads))) | {
        "unit_id": unit.unit_id,
        "experiment": unit.experiment,
        "cell": unit.cell,
        "system": system_label(unit.system),
        "kind": unit.kind,
        "severity": unit.severity,
        "base": unit.base or None,
        "index": unit.index,
        "sequence": unit.sequence,
        "repeat": unit.repeat,
        "world": unit.scenario.world.kind,
        "world_seed": unit.world_seed,
        "sequence_seed": unit.sequence_seed,
        "repeat_seed": unit.repeat_seed,
        "start_frame": unit.start_frame,
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
