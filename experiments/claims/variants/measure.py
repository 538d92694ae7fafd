"""A unit of variants: one world in one condition, and its variants on the same frames."""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from dslab.experiments.claims.variants.spec import Variant, VariantsSpec
from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.audit_text import corrupted_maps, silent_losses
from dslab.experiments.evaluation.summary import is_tracked, summarise
from dslab.experiments.runs.execution import RunRecord
from dslab.experiments.runs.files import plain
from dslab.experiments.runs.slam_settings import factory_of
from dslab.experiments.runs.systems.registry import Registry
from dslab.experiments.runs.systems.run import run_system
from dslab.sim.sequence import Sequence
from dslab.sim.sequence_rendering import render_sequence
from dslab.slam.core.events import CANCELLED, Breakage, RecoveryEnd
from dslab.slam.core.results import TrackingResult

Row = dict[str, Any]
_REPAIRS = {"recovery": "fusions", "place": "joins", "relocalization": "relocalizations"}
_EVERY = 5
"""Frames between two looks at the size of the buffer, which takes a walk over all that it holds."""


def units(spec: VariantsSpec) -> list[dict[str, Any]]:
    """The units, world by world; more variants than one unit takes are cut into parts."""
    names, most = [variant.name for variant in spec.variants], spec.most_variants
    return [
        {"world": world, "condition": condition, "part": part, "variants": names[first : first + most]}
        for world in range(spec.worlds)
        for condition in spec.cells
        for part, first in enumerate(range(0, len(names), most))
    ]


def measure(spec: VariantsSpec, unit: dict[str, Any]) -> list[Row]:
    """Run the variants of a unit, one row each.

    All of them have one seed, so that two differ by their settings alone; the rows do not depend on how the
    variants are cut into units. Times (``cpu_ms``, ``recovery_cpu_s``, ``wall_s``) are measured: the order
    of the runs is drawn, so that none has always the same place in it.
    """
    cv2.setNumThreads(1)
    condition, world = unit["condition"], unit["world"]
    cell = spec.cells[condition]
    sequence = render_sequence(spec.scenario(condition, world))
    stress = None if cell.degradation is None else spec.degradations[cell.degradation]
    about = {
        "world": world,
        "condition": condition,
        "base": cell.base,
        "stress": stress.label if stress else None,
        "dose": stress.doses_of(cell.base)[cell.dose] if stress and cell.dose is not None else None,
        "exposed": any(s.first_frame >= 0 for s in sequence.segments) if stress else None,
    }
    seed = spec.seed("systems", world)
    names = unit["variants"]
    rng = np.random.default_rng(spec.seed("order", condition, unit["part"], world))
    order = rng.permutation(len(names))
    rows = {names[k]: about | run_variant(spec.variant(names[k]), sequence, seed) for k in order}
    return [rows[name] for name in names]


def run_variant(variant: Variant, sequence: Sequence, seed: int) -> Row:
    """Run a variant over a sequence.

    Returns:
        Its columns of a row. ``ready``: a frame was tracked right before the stress acted; else nothing can
        break, and ``broke``, ``rescued`` and ``failed`` are None. ``broke``: tracking was declared lost in
        the segment, or anywhere without a stress. ``rescued``, given that: the broken map came into use
        again, by a recovery, a join or a relocalization that the audit does not call false. ``reason``: of
        the breakage. ``thread_reasons``: of the threads that failed on it. ``next_map_frames``: from the
        breakage, or the end of the stress where that is later, to a new map. ``onset_share``: of the path,
        walked when the stress began to act.
    """
    seen = _Buffer()
    record = run_system(
        Registry.open().find(variant.system), sequence, seed, factory_of(variant.written), observer=seen
    )
    summary, stamps_s = summarise(record), sequence.stamps_s
    acting = [segment for segment in sequence.segments if segment.first_frame >= 0]
    breakages = [b for b in summary["breakage_list"] if not acting or b["segment_index"] is not None]
    onset = acting[0].first_frame if acting else len(sequence) - 1
    ready = any(map(is_tracked, record.results[onset - 1 : onset] if acting else record.results))
    first = breakages[0] if breakages else None
    false_repair = first is not None and _is_false(summary["audit"], first)
    rescued = None if first is None else first["repair"] is not None and not false_repair
    claims = sum(summary["audit"][name] for name in summary["audit"] if name.startswith("false_"))
    corrupted = len(corrupted_maps(summary))
    return plain(
        {
            "variant": variant.name,
            "system": variant.system,
            "seed": seed,
            "ended": summary["ended"],
            "ready": ready,
            "broke": first is not None if ready else None,
            "rescued": rescued if ready else None,
            "failed": first is not None and not rescued if ready else None,
            "repair": first and first["repair"],
            "false_repair": false_repair if first and first["repair"] else None,
            "breakages": summary["breakages"],
            "reason": first and first["reason"],
            "thread_reasons": first and "; ".join(_thread_reasons(record, first["frame"])),
            "maps": summary["maps"],
            "tracked_share": summary["share_tracked_after_init"],
            "path_share": summary["path_share"],
            "onset_share": _walked_share(sequence, onset) if acting else None,
            "ate_m": summary["ate_m"],
            "ate_share": summary["ate_share_of_path"],
            "false_claims": claims,
            "silent_losses": len(silent_losses(summary)),
            "corrupted_maps": corrupted,
            "wrong": claims + corrupted > 0,
            "first_map_frames": summary["frames_to_initialise"],
            "next_map_frames": first and _next_map_frames(first, acting[0].last_frame if acting else -1),
            "to_repair_s": float(stamps_s[first["repair_frame"]] - stamps_s[first["frame"]])
            if first and rescued
            else None,
            "recovery_cpu_s": sum(e.cpu_ms for e in record.events if isinstance(e, RecoveryEnd)) / 1e3,
            "cpu_ms": float(np.mean([_cpu_ms(result) for result in record.results])),
            "wall_s": record.wall_s,
            "buffer_mb": seen.most_bytes / 1e6 if seen.most_bytes else None,
        }
    )


class _Buffer:
    """Observer of a run: the largest size of its buffer, in bytes; 0 of a system without one."""

    def __init__(self) -> None:
        self.most_bytes = 0

    def frame(self, image: np.ndarray, result: TrackingResult, system: Any) -> None:
        buffer = getattr(system, "buffer", None)
        if buffer is not None and result.frame % _EVERY == 0:
            self.most_bytes = max(self.most_bytes, buffer.nbytes)


def _is_false(audit: Row, breakage: Row) -> bool:
    """True if the audit calls the first event by which a broken map came into use again false."""
    judged = audit.get(_REPAIRS.get(breakage["repair"], ""), ())
    return any(row["frame"] == breakage["repair_frame"] and row["false"] is True for row in judged)


def _next_map_frames(breakage: Row, stress_ends: int) -> int | None:
    if breakage["reinit_frame"] is None:
        return None
    return max(0, breakage["reinit_frame"] - max(breakage["frame"], stress_ends))


def _thread_reasons(record: RunRecord, frame: int) -> Iterator[str]:
    """Why the recovery threads of the breakage at a frame failed, up to the next breakage."""
    later = [e.frame for e in record.events if isinstance(e, Breakage) and e.frame > frame]
    until = min(later, default=len(record.sequence))
    for event in record.events:
        if not isinstance(event, RecoveryEnd) or not frame <= event.frame < until:
            continue
        if not event.success and event.stage != CANCELLED:
            yield f"{event.method}: {event.stage}: {event.reason}"


def _walked_share(sequence: Sequence, frame: int) -> float | None:
    if sequence.T_world_cam is None:
        return None
    walked = metrics.Truth.of(sequence).walked_m()
    return float(walked[frame] / walked[-1]) if walked[-1] > 0 else None


def _cpu_ms(result: TrackingResult) -> float:
    return sum(result.cpu_ms.values()) + result.mapping_cpu_ms + result.loop_cpu_ms
