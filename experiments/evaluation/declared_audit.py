"""Audit of every declared loop, fusion, join and relocalization of a run, each at its own moment."""

from dataclasses import asdict, dataclass

import numpy as np

from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.metrics import PosePairs
from dslab.experiments.evaluation.relation_audit import (
    RecognisedSide,
    RelationAudit,
    RelationBounds,
    audit_asserted,
)
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import Event, Fusion, LoopClosed, MapAdjusted, Relocalized, TrackingState
from dslab.slam.core.relation import Relation

_UNSAID = RelationAudit(None, None, None, None, None, "the system does not say what it asserts")


@dataclass(frozen=True)
class DeclaredFinding:
    """A closed loop or an accepted fusion, judged.

    Attributes:
        event: the declaration.
        audit: its judgement.
    """

    event: LoopClosed | Fusion
    audit: RelationAudit


@dataclass(frozen=True)
class RelocalizationFinding:
    """A relocalization with the live poses that followed it.

    The frames are those of its probation and those that follow for ``follow_s``, until the next loss or a
    correction that moves the map.

    Attributes:
        event: the declaration.
        frames_judged, frames_false: number of frames, and of those out of bounds.
        position_error_m, position_bound_m, rotation_error_deg: of the relocalized frame itself.
        largest_error_m: of all judged frames.
        false: the relocalized frame, or most of the judged frames, are out of bounds; None if undetermined.
        reason: reason why it could not be judged; empty otherwise.
    """

    event: Relocalized
    frames_judged: int
    frames_false: int
    position_error_m: float | None
    position_bound_m: float | None
    rotation_error_deg: float | None
    largest_error_m: float | None
    false: bool | None
    reason: str


@dataclass(frozen=True)
class DeclaredAudit:
    """Judgement of all that a run has declared.

    Attributes:
        loops: every closed loop.
        fusions, joins: every accepted fusion, by a recovery and by place.
        relocalizations: every relocalization.
    """

    loops: tuple[DeclaredFinding, ...]
    fusions: tuple[DeclaredFinding, ...]
    joins: tuple[DeclaredFinding, ...]
    relocalizations: tuple[RelocalizationFinding, ...]

    @property
    def false_counts(self) -> dict[str, int]:
        """Number of false declarations by kind."""
        return {
            "false_loops": sum(f.audit.false is True for f in self.loops),
            "false_fusions": sum(f.audit.false is True for f in self.fusions),
            "false_joins": sum(f.audit.false is True for f in self.joins),
            "false_relocalizations": sum(f.false is True for f in self.relocalizations),
        }

    @property
    def unjudged(self) -> int:
        """Number of declarations that could not be judged."""
        related = (*self.loops, *self.fusions, *self.joins)
        return sum(f.audit.false is None for f in related) + sum(
            f.false is None for f in self.relocalizations
        )

    def rows(self, start_s: float) -> dict:
        """As part of the summary, with times since the first frame at ``start_s``."""
        of_maps = ("old_map_id", "new_map_id", "inliers", "scale")
        of_loop = ("map_id", "keyframe", "loop_keyframe", "matches", "scale")
        return {
            **self.false_counts,
            "loops": [_row(f.event, of_loop, start_s) | asdict(f.audit) for f in self.loops],
            "fusions": [_row(f.event, of_maps, start_s) | asdict(f.audit) for f in self.fusions],
            "joins": [_row(f.event, of_maps, start_s) | asdict(f.audit) for f in self.joins],
            "relocalizations": [
                _row(f.event, ("map_id", "keyframe", "inliers"), start_s)
                | {name: value for name, value in vars(f).items() if name != "event"}
                for f in self.relocalizations
            ],
        }


def audit_declared(record: RunRecord, bounds: RelationBounds | None = None) -> DeclaredAudit:
    """Judge every loop, fusion, join and relocalization of a run.

    Args:
        record: a run over a sequence with truth.
        bounds: of right relations.
    """
    bounds = bounds or RelationBounds()
    loops, fusions, joins, relocalizations = [], [], [], []
    for event in record.events:
        if isinstance(event, LoopClosed):
            loops.append(DeclaredFinding(event, _audit(event.relation, record, bounds)))
        elif isinstance(event, Fusion) and event.accepted:
            finding = DeclaredFinding(event, _audit(event.relation, record, bounds))
            (joins if event.by == "place" else fusions).append(finding)
        elif isinstance(event, Relocalized):
            relocalizations.append(_relocalization(event, record, bounds))
    return DeclaredAudit(tuple(loops), tuple(fusions), tuple(joins), tuple(relocalizations))


def _audit(relation: Relation | None, record: RunRecord, bounds: RelationBounds) -> RelationAudit:
    truth = record.sequence.T_world_cam
    assert truth is not None
    return _UNSAID if relation is None else audit_asserted(relation, record.sequence.stamps_s, truth, bounds)


def _relocalization(event: Relocalized, record: RunRecord, bounds: RelationBounds) -> RelocalizationFinding:
    stamps_s, truth = record.sequence.stamps_s, record.sequence.T_world_cam
    assert truth is not None

    def unjudged(reason: str) -> RelocalizationFinding:
        return RelocalizationFinding(event, 0, 0, None, None, None, None, None, reason)

    if event.relation is None:
        return unjudged(_UNSAID.reason)
    side = RecognisedSide.of(event.relation, stamps_s, truth, bounds)
    if isinstance(side, Undefined):
        return unjudged(f"recognised keyframes: {side.reason}")
    frames, poses = _followed(event, event.relation, record, bounds)
    known = np.isfinite(truth[frames]).all(axis=(1, 2))
    if not known[0]:
        return unjudged("no true pose of the relocalized frame")
    errors = side.errors(PosePairs(frames[known], poses[known], truth[frames[known]]), bounds)
    return RelocalizationFinding(
        event,
        len(errors.frames),
        int(errors.false.sum()),
        float(errors.position_m[0]),
        float(errors.bound_m[0]),
        float(errors.rotation_deg[0]),
        float(errors.position_m.max()),
        bool(errors.false[0] or 2 * errors.false.sum() > len(errors.frames)),
        "",
    )


def _followed(
    event: Relocalized, relation: Relation, record: RunRecord, bounds: RelationBounds
) -> tuple[np.ndarray, np.ndarray]:
    """The relocalized frames, and those after them in the same map: (n,) and (n, 4, 4)."""
    frames, poses = list(relation.new.frames), list(relation.new.T_map_cam)
    moved = {
        e.frame
        for e in record.events
        if isinstance(e, LoopClosed | MapAdjusted | Fusion) and e.map_id == event.map_id
    }
    for result in record.results[event.frame + 1 :]:
        tracked = result.state is TrackingState.TRACKING and result.map_id == event.map_id
        late = result.stamp_s > event.stamp_s + bounds.follow_s
        if not tracked or late or result.frame in moved or result.T_map_cam is None:
            break
        frames.append(result.frame)
        poses.append(result.T_map_cam)
    return np.array(frames), np.array(poses)


def _row(event: Event, fields: tuple[str, ...], start_s: float) -> dict:
    row = {"frame": event.frame, "time_s": event.stamp_s - start_s}
    return row | {name: getattr(event, name) for name in fields}
