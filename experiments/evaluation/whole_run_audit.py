"""The live path and the final maps of a run, judged against the truth all along."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.audit import AuditBounds, lacks_for_alignment
from dslab.experiments.evaluation.metrics import Truth, path_length_m
from dslab.experiments.evaluation.path_audit import PathAudit, audit_path, fit, known_pieces
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import Breakage, Fusion, LoopClosed, MapAdjusted, MapDropped, Relocalized
from dslab.slam.core.results import MapTrajectory


@dataclass(frozen=True)
class WrongStretch:
    """Live poses that are out of bounds.

    Attributes:
        first_frame, last_frame: of them.
        declared_frame: frame at which the system gave the map up, if that is their end; else None.
    """

    first_frame: int
    last_frame: int
    declared_frame: int | None


@dataclass(frozen=True)
class LiveAudit:
    """Judgement of all live poses of a run.

    Attributes:
        poses, judged: number of live poses, and of those that could be judged.
        reason: why most of the others could not be judged; empty if all were.
        wrong: the stretches that are out of bounds, in order.
    """

    poses: int
    judged: int
    reason: str
    wrong: tuple[WrongStretch, ...]


def audit_live(record: RunRecord, bounds: AuditBounds) -> LiveAudit:
    """Judge the live poses of a run over a sequence with truth.

    Where a map was lost, found again, or corrected, another path begins: what was right by the map of its
    time need not lie right in the later one.
    """
    truth, audits, wrong = Truth.of(record.sequence), [], []
    for piece, given_up in _live_pieces(record):
        audit = audit_path(piece, truth, bounds)
        audits.append(audit)
        for first, last in audit.wrong:
            to_end_s = piece.stamps_s[-1] - truth.stamps_s[last]
            wrong.append(WrongStretch(first, last, given_up if to_end_s <= bounds.seam_s else None))
    poses = sum(len(path.frames) for path in record.live.values())
    judged = sum(len(audit.judged) for audit in audits)
    wrong.sort(key=lambda stretch: stretch.first_frame)
    return LiveAudit(poses, judged, _reason(audits) if poses else "no pose was given", tuple(wrong))


def audit_maps(record: RunRecord, bounds: AuditBounds) -> list[dict[str, Any]]:
    """Judge the final maps of a run over a sequence with truth, that with most frames first.

    Returns:
        Per map ``map_id``; ``poses``, ``judged`` and ``reason``, as of LiveAudit; ``corrupted``: no alignment
        makes the truth of it, or a stretch of it is out of bounds, None if nothing could be judged;
        ``first_frame`` of the first such stretch, None without one; ``error_m`` and ``rotation_deg``, RMS of
        the poses in one alignment of all, None if there is none; ``path_m``, the true path of these poses.
    """
    return [_audit_map(path, Truth.of(record.sequence), bounds) for path in record.trajectories]


def _audit_map(path: MapTrajectory, truth: Truth, bounds: AuditBounds) -> dict[str, Any]:
    audit, pairs = audit_path(path, truth, bounds), truth.pairs(path)
    pieces = [p for p in known_pieces(pairs, truth, bounds) if not lacks_for_alignment(p, bounds)]
    fits = [fit(piece, bounds) for piece in pieces]
    bends = any(isinstance(found, Undefined) or found.is_false(bounds) for found in fits)
    whole = fit(pairs, bounds)
    return {
        "map_id": path.map_id,
        "poses": len(path.frames),
        "judged": len(audit.judged),
        "reason": _reason([audit]),
        "corrupted": bends or bool(audit.wrong) if fits else None,
        "first_frame": audit.wrong[0][0] if audit.wrong else None,
        "error_m": None if isinstance(whole, Undefined) else whole.error_m,
        "rotation_deg": None if isinstance(whole, Undefined) else whole.rotation_deg,
        "path_m": path_length_m(pairs.T_world_cam),
    }


def _live_pieces(record: RunRecord) -> Iterator[tuple[MapTrajectory, int | None]]:
    """Live paths between changes of their map; with each the frame at which it was given up, if it was."""
    for map_id, path in record.live.items():
        given_up = {
            e.frame for e in record.events if isinstance(e, Breakage | MapDropped) and e.map_id == map_id
        }
        cuts = np.array(sorted(given_up | _changed(record, map_id)), int)
        number = np.searchsorted(cuts, path.frames, side="right")
        for own in np.unique(number):
            end = int(cuts[own]) if own < len(cuts) else None
            yield path.where(number == own), end if end in given_up else None


def _changed(record: RunRecord, map_id: int) -> set[int]:
    """Frames from which on live poses lie in a map that was moved, or found again."""
    frames = set()
    for event in record.events:
        if isinstance(event, LoopClosed | MapAdjusted) and event.map_id == map_id:
            frames.add(_applied_frame(event, record))
        elif isinstance(event, Relocalized) and event.map_id == map_id:
            frames.add(event.first_frame)
        elif isinstance(event, Fusion) and event.accepted and event.map_id == map_id:
            frames.add(event.frame)
    return frames


def _applied_frame(event: LoopClosed | MapAdjusted, record: RunRecord) -> int:
    """The frame that found the map corrected: the event has that of the keyframe that started the work."""
    later = record.results[event.frame :]
    return next((r.frame for r in later if r.loop_cpu_ms >= event.cpu_ms > 0), event.frame)


def _reason(audits: list[PathAudit]) -> str:
    """Why most of the poses that could not be judged were not; empty for none."""
    reasons = Counter(reason for audit in audits for reason in audit.unjudged.values())
    return reasons.most_common(1)[0][0] if reasons else ""
