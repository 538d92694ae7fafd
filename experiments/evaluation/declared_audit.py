"""Audit of every declared loop, fusion, join and relocalization of a run, each at its own moment."""

from dataclasses import asdict, dataclass

import numpy as np

from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.metrics import PosePairs, Truth
from dslab.experiments.evaluation.relation_audit import (
    RELATION_BOUNDS,
    RecognisedSide,
    RelationAudit,
    audit_asserted,
)
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import Fusion, LoopClosed, MapAdjusted, Relocalized, TrackingState
from dslab.slam.core.relation import Relation

_UNSAID = "the system does not say what it asserts"
_FIELDS = {
    "loops": ("map_id", "keyframe", "loop_keyframe", "matches", "scale"),
    "fusions": ("old_map_id", "new_map_id", "inliers", "scale"),
    "joins": ("old_map_id", "new_map_id", "inliers", "scale"),
    "relocalizations": ("map_id", "keyframe", "inliers"),
}
"""Of each kind of declaration what its rows have of the event."""


@dataclass(frozen=True)
class RelocalizationAudit:
    """A relocalization judged with the live poses that followed it.

    The frames are those of its probation and those that follow for ``follow_s``, until the next loss or a
    correction that moves the map.

    Attributes:
        frames_judged, frames_false: number of frames, and of those out of bounds.
        position_error_m, position_bound_m, rotation_error_deg: of the relocalized frame itself.
        largest_error_m: of all judged frames.
        false: the relocalized frame, or most of the judged frames, are out of bounds; None if undetermined.
        reason: reason why it could not be judged; empty otherwise.
    """

    frames_judged: int
    frames_false: int
    position_error_m: float | None
    position_bound_m: float | None
    rotation_error_deg: float | None
    largest_error_m: float | None
    false: bool | None
    reason: str


@dataclass(frozen=True)
class DeclaredFinding:
    """A closed loop, an accepted fusion or a relocalization, judged.

    Attributes:
        event: the declaration.
        audit: its judgement.
    """

    event: LoopClosed | Fusion | Relocalized
    audit: RelationAudit | RelocalizationAudit

    @property
    def false(self) -> bool | None:
        """None if it could not be judged."""
        return self.audit.false


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
    relocalizations: tuple[DeclaredFinding, ...]

    @property
    def false_counts(self) -> dict[str, int]:
        """Number of false declarations by kind."""
        return {f"false_{kind}": sum(f.false is True for f in of) for kind, of in vars(self).items()}

    @property
    def unjudged(self) -> int:
        """Number of declarations that could not be judged."""
        return sum(f.false is None for of in vars(self).values() for f in of)

    def rows(self, start_s: float) -> dict:
        """As part of the summary, with times since the first frame at ``start_s``."""
        return self.false_counts | {
            kind: [
                {"frame": f.event.frame, "time_s": f.event.stamp_s - start_s}
                | {name: getattr(f.event, name) for name in _FIELDS[kind]}
                | asdict(f.audit)
                for f in of
            ]
            for kind, of in vars(self).items()
        }


def audit_declared(record: RunRecord) -> DeclaredAudit:
    """Judge every loop, fusion, join and relocalization of a run over a sequence with truth."""
    truth = Truth.of(record.sequence)
    found: dict[str, list[DeclaredFinding]] = {kind: [] for kind in _FIELDS}
    for event in record.events:
        if isinstance(event, Relocalized):
            found["relocalizations"].append(DeclaredFinding(event, _relocalization(event, record, truth)))
        elif isinstance(event, LoopClosed) or (isinstance(event, Fusion) and event.accepted):
            said = event.relation
            audit = RelationAudit.open(_UNSAID) if said is None else audit_asserted(said, truth)
            kind = "loops" if isinstance(event, LoopClosed) else "joins" if event.by == "place" else "fusions"
            found[kind].append(DeclaredFinding(event, audit))
    return DeclaredAudit(**{kind: tuple(of) for kind, of in found.items()})


def _relocalization(event: Relocalized, record: RunRecord, truth: Truth) -> RelocalizationAudit:
    def unjudged(reason: str) -> RelocalizationAudit:
        return RelocalizationAudit(0, 0, None, None, None, None, None, reason)

    if event.relation is None:
        return unjudged(_UNSAID)
    side = RecognisedSide.of(event.relation, truth, RELATION_BOUNDS)
    if isinstance(side, Undefined):
        return unjudged(f"recognised keyframes: {side.reason}")
    frames, poses = _followed(event, event.relation, record)
    known = truth.known[frames]
    if not known[0]:
        return unjudged("no true pose of the relocalized frame")
    judged = PosePairs(frames[known], poses[known], truth.T_world_cam[frames[known]])
    errors = side.errors(judged, RELATION_BOUNDS)
    return RelocalizationAudit(
        len(judged),
        int(errors.false.sum()),
        float(errors.position_m[0]),
        float(errors.bound_m[0]),
        float(errors.rotation_deg[0]),
        float(errors.position_m.max()),
        bool(errors.false[0] or 2 * errors.false.sum() > len(judged)),
        "",
    )


def _followed(event: Relocalized, relation: Relation, record: RunRecord) -> tuple[np.ndarray, np.ndarray]:
    """The relocalized frames, and those after them in the same map: (n,) and (n, 4, 4)."""
    frames, poses = list(relation.new.frames), list(relation.new.T_map_cam)
    moved = {
        e.frame
        for e in record.events
        if isinstance(e, LoopClosed | MapAdjusted | Fusion) and e.map_id == event.map_id
    }
    for result in record.results[event.frame + 1 :]:
        tracked = result.state is TrackingState.TRACKING and result.map_id == event.map_id
        late = result.stamp_s > event.stamp_s + RELATION_BOUNDS.follow_s
        if not tracked or late or result.frame in moved or result.T_map_cam is None:
            break
        frames.append(result.frame)
        poses.append(result.T_map_cam)
    return np.array(frames), np.array(poses)
