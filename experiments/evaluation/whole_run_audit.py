"""The live path and the final maps of a run, judged against the truth all along."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.audit import AuditBounds, lacks_for_alignment
from dslab.experiments.evaluation.metrics import associate, path_length_m
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


@dataclass(frozen=True)
class MapAudit:
    """Judgement of the final path of a map.

    Attributes:
        map_id: the map.
        poses, judged, reason: as of LiveAudit.
        corrupted: no similarity makes the truth of it, or a stretch of it is out of bounds; None if nothing
            could be judged.
        first_frame: first frame of the first such stretch; None without one.
        error_m, rotation_deg: RMS of the poses in one alignment of all; None if there is none.
        path_m: true path of these poses.
    """

    map_id: int
    poses: int
    judged: int
    reason: str
    corrupted: bool | None
    first_frame: int | None
    error_m: float | None
    rotation_deg: float | None
    path_m: float


def audit_live(record: RunRecord, bounds: AuditBounds) -> LiveAudit:
    """Judge the live poses of a run over a sequence with truth.

    Where a map was lost, found again, or corrected, another path begins: what was right by the map of its
    time need not lie right in the later one.
    """
    sequence = record.sequence
    assert sequence.T_world_cam is not None
    audits, wrong = [], []
    for piece, given_up in _live_pieces(record):
        audit = audit_path(piece, sequence.stamps_s, sequence.T_world_cam, bounds)
        audits.append(audit)
        for first, last in audit.wrong:
            to_end_s = piece.stamps_s[-1] - sequence.stamps_s[last]
            wrong.append(WrongStretch(first, last, given_up if to_end_s <= bounds.seam_s else None))
    poses = sum(len(path.frames) for path in record.live.values())
    judged = sum(len(audit.judged) for audit in audits)
    wrong.sort(key=lambda stretch: stretch.first_frame)
    return LiveAudit(poses, judged, _reason(audits) if poses else "no pose was given", tuple(wrong))


def audit_maps(record: RunRecord, bounds: AuditBounds) -> list[MapAudit]:
    """Judge the final maps of a run over a sequence with truth, that with most frames first."""
    return [_audit_map(path, record, bounds) for path in record.trajectories]


def _audit_map(path: MapTrajectory, record: RunRecord, bounds: AuditBounds) -> MapAudit:
    stamps_s, truth = record.sequence.stamps_s, record.sequence.T_world_cam
    assert truth is not None
    audit = audit_path(path, stamps_s, truth, bounds)
    pairs = associate(path, stamps_s, truth)
    pieces = [p for p in known_pieces(pairs, stamps_s, truth, bounds) if not lacks_for_alignment(p, bounds)]
    fits = [fit(piece, bounds) for piece in pieces]
    bends = any(isinstance(found, Undefined) or found.is_false(bounds) for found in fits)
    whole = fit(pairs, bounds)
    return MapAudit(
        path.map_id,
        len(path.frames),
        len(audit.judged),
        _reason([audit]),
        bends or bool(audit.wrong) if fits else None,
        audit.wrong[0][0] if audit.wrong else None,
        None if isinstance(whole, Undefined) else whole.error_m,
        None if isinstance(whole, Undefined) else whole.rotation_deg,
        path_length_m(pairs.T_world_cam),
    )


def _live_pieces(record: RunRecord) -> Iterator[tuple[MapTrajectory, int | None]]:
    """Live paths between changes of their map; with each the frame at which it was given up, if it was."""
    for map_id, path in record.live.items():
        given_up = {
            e.frame for e in record.events if isinstance(e, Breakage | MapDropped) and e.map_id == map_id
        }
        cuts = np.array(sorted(given_up | _changed(record, map_id)), int)
        number = np.searchsorted(cuts, path.frames, side="right")
        for own in np.unique(number):
            kept = number == own
            end = int(cuts[own]) if own < len(cuts) else None
            piece = MapTrajectory(map_id, path.frames[kept], path.stamps_s[kept], path.T_map_cam[kept])
            yield piece, end if end in given_up else None


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
