"""One unit of an experiment: both systems on the same images, judged, as one flat row. Never raises.

A unit has a clean lead-in, exposed segments and clean stretches after them. B: the base declares a breakage
in an exposed segment. R_1: the recovery fails, or its fusion is false by the audit. D_1: B and R_1.
"""

import time
import traceback
from collections.abc import Callable
from enum import StrEnum
from typing import Any

from experiments.alignment import Undefined, align_poses
from experiments.breakages import BreakageOutcome, breakage_outcomes
from experiments.execution import RunRecord, SystemFactory, SystemKind, execute, system_factory
from experiments.metrics import associate, coverage, position_errors_m, rms
from experiments.provenance import commit
from experiments.summary import is_tracked, summarise
from scenarios.errors import InputError
from scenarios.spec import Scenario
from sim.sequence import Sequence
from slam.dual.config import DualConfig
from slam.dual.registry import ThreadSpec
from slam.results import MapTrajectory

RECOVERY_ALONE = DualConfig(threads=(ThreadSpec("orb"),), relocalization=False, joining=None)
LEAD_IN_HEALTHY_S = 1.0
"""How long before the first segment the map must have been tracked without a gap."""
LEAD_IN_ERROR_SHARE = 0.05
"""Largest position error (RMS) on the lead-in, as a share of its path, of a healthy map."""


class Outcome(StrEnum):
    """How a unit ended."""

    COMPLETED = "completed"
    VOID = "void"
    INFRASTRUCTURE_ERROR = "infrastructure_error"


Render = Callable[[Scenario, int], Sequence]


def run_trial(
    scenario: Scenario, seed: int, render: Render, build: SystemFactory | None = None
) -> dict[str, Any]:
    """Run one unit of the free arm: base and Dual-SLAM, same seed, same images.

    Args:
        scenario: what happens.
        seed: root seed of the unit: of the world, the images and both systems.
        render: makes the images.
        build: makes the systems; by default with one ORB recovery thread that nothing forestalls: neither
            relocalization nor meeting the saved map again.

    Returns:
        One flat row with the columns of :func:`empty_row`. Whatever goes wrong in the programs is the outcome
        ``infrastructure_error`` with its message, never a failure of the SLAM.
    """
    row = empty_row(scenario, seed)
    started = time.perf_counter()
    try:
        sequence = render(scenario, seed)
        row["render_s"] = time.perf_counter() - started
        build = build or system_factory(dual=RECOVERY_ALONE)
        records = {kind: execute(sequence, kind, seed, build=build) for kind in ("base", "dual")}
        row.update(judge(records["base"], records["dual"]))
    except Exception as error:  # the one place that may: a broken unit must not end the experiment
        row["outcome"] = Outcome.INFRASTRUCTURE_ERROR.value
        row["message"] = _message(error)
    row["wall_s"] = time.perf_counter() - started
    return row


def empty_row(scenario: Scenario, seed: int) -> dict[str, Any]:
    """Every column of the table, nothing known yet."""
    unknown = (
        "void_reason", "breakage", "breakage_frame", "breakage_segment", "breakage_reason",
        "relocalized", "base_failure", "silent_failure", "declaration_delay_s",
        "dual_breakage_frame", "recovery_ran", "recovery_stage", "recovery_reason", "frames_covered",
        "recovered_declared", "false_recovery", "fusion_scale_error", "fusion_seam_error_m",
        "recovery_failure", "no_reinit", "dual_failure", "dual_breakages", "dual_recoveries",
        "base_share_tracked", "dual_share_tracked", "base_ate_m", "dual_ate_m",
        "base_path_share", "dual_path_share", "dual_maps", "render_s",
    )  # fmt: skip
    return {
        "scenario": scenario.name,
        "seed": seed,
        "outcome": Outcome.INFRASTRUCTURE_ERROR.value,
        "message": "",
        "commit": commit() or "",
        **dict.fromkeys(unknown),
        "wall_s": 0.0,
    }


def judge(base: RunRecord, dual: RunRecord) -> dict[str, Any]:
    """The outcome of a unit from its two runs.

    The first breakage in an exposed segment counts. A recovery that was never reached, for want of a new map,
    failed too. A unit whose lead-in is not healthy is void: kept, and counted as void.
    """
    base_summary, dual_summary = summarise(base), summarise(dual)
    row = _figures(base_summary, "base") | _figures(dual_summary, "dual")
    void = lead_in_fault(base) or lead_in_fault(dual)
    if void:
        return {**row, "outcome": Outcome.VOID.value, "void_reason": void}
    base_first = _first_exposed(base)
    dual_first = _first_exposed(dual)
    losses = base_summary["audit"]["losses"]
    row |= {
        "outcome": Outcome.COMPLETED.value,
        "breakage": base_first is not None,
        "base_failure": not is_tracked(base.results[-1]),
        "silent_failure": any(loss["silent"] for loss in losses if loss["segment"] is not None),
        "dual_failure": False,
    }
    if base_first is None:
        return row
    delays = [x["delay_s"] for x in losses if x["declared_frame"] == base_first.breakage.frame]
    segment = base.sequence.segments[base_first.segment or 0]
    row |= {
        "breakage_frame": base_first.breakage.frame,
        "breakage_segment": segment.kind,
        "breakage_reason": base_first.breakage.reason,
        "declaration_delay_s": delays[0] if delays else None,
        "relocalized": base_first.relocalized is not None,
    }
    return row | _recovery(dual_first, dual_summary["audit"]["fusions"])


def lead_in_fault(record: RunRecord) -> str | None:
    """Why the map is not healthy when the exposure begins; None if it is."""
    onsets = [s.first_frame for s in record.sequence.segments if s.first_frame >= 0]
    if not onsets:
        return "no segment acts on any frame"
    onset = min(onsets)
    before = record.results[onset - 1] if onset else None
    if before is None or not is_tracked(before):
        return "not tracking at the onset"
    if any(o.breakage.frame < onset for o in _outcomes(record)):
        return "broke in the lead-in"
    live = record.live[before.map_id]
    lead_s = before.stamp_s - live.stamps_s[0]
    if lead_s < LEAD_IN_HEALTHY_S:
        return f"tracked for {lead_s:.2f} s only before the onset"
    return _lead_in_error(record, live, onset)


def _lead_in_error(record: RunRecord, live: MapTrajectory, onset: int) -> str | None:
    truth = record.sequence.T_world_cam
    if truth is None:
        return "no ground truth"
    pairs = associate(live, record.sequence.stamps_s, truth)
    pairs = pairs.where(pairs.frames < onset)
    path_m = coverage(pairs.frames, truth).path_m
    alignment = align_poses(pairs.T_map_cam, pairs.T_world_cam)
    if isinstance(alignment, Undefined):
        return f"the lead-in cannot be judged: {alignment.reason}"
    error_m = rms(position_errors_m(pairs, alignment))
    if error_m > LEAD_IN_ERROR_SHARE * path_m:
        return f"position error {error_m:.3f} m on {path_m:.2f} m of lead-in"
    return None


def _recovery(first: BreakageOutcome | None, fusions: list[dict]) -> dict[str, Any]:
    """R_1 and D_1 given B. The systems are alike up to the breakage, so the dual has it too."""
    if first is None:
        return {"recovery_ran": False, "recovery_failure": False, "dual_failure": False}
    audit = next((f for f in fusions if f["breakage_frame"] == first.breakage.frame), None)
    false = bool(audit["false"]) if audit and audit["false"] is not None else None
    ended = first.recoveries[-1] if first.recoveries else None
    failed = not first.recovered or false is True
    return {
        "dual_breakage_frame": first.breakage.frame,
        "recovery_ran": bool(first.recoveries),
        "recovery_stage": ended.stage if ended else None,
        "recovery_reason": first.failure_reason,
        "frames_covered": ended.frames_covered if ended else None,
        "recovered_declared": first.recovered,
        "false_recovery": false if first.recovered else None,
        "fusion_scale_error": audit["scale_error"] if audit else None,
        "fusion_seam_error_m": audit["seam_error_m"] if audit else None,
        "recovery_failure": failed,
        "no_reinit": first.reinit_frame is None,
        "dual_failure": failed,
    }


def _figures(summary: dict, kind: SystemKind) -> dict[str, Any]:
    row = {f"{kind}_{name}": summary[name] for name in ("share_tracked", "ate_m", "path_share")}
    if kind == "dual":
        row |= {"dual_breakages": summary["breakages"], "dual_recoveries": summary["recoveries"]}
        row["dual_maps"] = summary["maps"]
    return row


def _outcomes(record: RunRecord) -> list[BreakageOutcome]:
    return breakage_outcomes(record.events, record.sequence.segments, list(record.sequence.stamps_s))


def _first_exposed(record: RunRecord) -> BreakageOutcome | None:
    return next((o for o in _outcomes(record) if o.segment is not None), None)


def _message(error: Exception) -> str:
    if isinstance(error, InputError):
        return str(error)
    at = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({at.filename.rsplit('/', 1)[-1]}:{at.lineno})"
