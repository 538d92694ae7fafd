"""Audit by the truth of what a loop closure, a fusion or a relocalization asserts, at that moment.

Only the relation of the two sides is judged, locally: the keyframes around the recognised one are aligned to
the truth, and the other side's poses are compared with the truth in that alignment. So a right loop is right
even after long drift, and what a later correction makes of a false one does not hide it.
"""

from dataclasses import dataclass

import numpy as np

from dslab.experiments.evaluation.alignment import Similarity, Undefined, align_poses
from dslab.experiments.evaluation.metrics import PoseBounds, PoseErrors, PosePairs, Truth, pose_errors
from dslab.slam.core.relation import PlacedFrames, Relation
from dslab.slam.core.results import MapTrajectory


@dataclass(frozen=True)
class RelationBounds(PoseBounds):
    """Bounds beyond which an asserted relation counts as false.

    The extent is local: true distance from the middle of the recognised keyframes, plus the median depth of
    the scene there.

    Attributes:
        scale_share: difference of scale allowed between the two sides.
        compared: nearest keyframes of the recognising side whose place and direction are compared.
        aligned: nearest keyframes of a side that are aligned to the truth; more where they stand too close.
        min_poses: least number of keyframes of a side for an alignment.
        min_spread_m: least true distance between the outermost of them.
        min_spread_share: likewise for a judgement of scale, as a share of the median depth.
        follow_s: time after a relocalization over which the live poses are judged.
    """

    scale_share: float = 0.10
    compared: int = 5
    aligned: int = 10
    min_poses: int = 5
    min_spread_m: float = 0.2
    min_spread_share: float = 0.05
    follow_s: float = 1.0


RELATION_BOUNDS = RelationBounds()


@dataclass(frozen=True)
class RelationAudit:
    """Judgement of an asserted relation.

    Attributes:
        position_error_m, rotation_error_deg: of the new side in the frame of the old one, medians over the
            nearest keyframes; None if they could not be judged.
        position_bound_m: position error allowed there.
        scale_error: size of the new side over that of the old one, both in units of the truth, minus 1; None
            if a side has too little motion.
        false: any of them is out of bounds; None if none could be judged.
        reason: the figures that could not be judged, with the causes; empty if none.
    """

    position_error_m: float | None
    position_bound_m: float | None
    rotation_error_deg: float | None
    scale_error: float | None
    false: bool | None
    reason: str

    @classmethod
    def open(cls, reason: str) -> "RelationAudit":
        """That of nothing, for a reason."""
        return cls(None, None, None, None, None, reason)


@dataclass(frozen=True)
class RecognisedSide:
    """The keyframes around the recognised one, aligned to the truth.

    Attributes:
        alignment: of the map there to the truth.
        keyframes: those that were aligned.
        depth_m: median depth of the scene there.
    """

    alignment: Similarity
    keyframes: PosePairs
    depth_m: float

    @classmethod
    def of(cls, relation: Relation, truth: Truth, bounds: RelationBounds) -> "RecognisedSide | Undefined":
        """Align the old side of a relation, as asserted.

        Returns:
            The side; Undefined if its keyframes are too few, too close together, or do not fit the truth
            among themselves, so that nothing can be compared with them.
        """
        keyframes = _spread_out(_pairs(relation.old, truth), relation.depth, bounds)
        if isinstance(keyframes, Undefined):
            return keyframes
        alignment = align_poses(keyframes.T_map_cam, keyframes.T_world_cam)
        if isinstance(alignment, Undefined):
            return alignment
        side = cls(alignment, keyframes, alignment.scale * relation.depth)
        own = side.errors(keyframes, bounds)
        off_m, _, off_deg = own.medians
        if np.median(own.position_m / own.bound_m) > 1 or off_deg > bounds.rotation_deg:
            return Undefined(f"they do not fit the truth themselves ({off_m:.2f} m, {off_deg:.1f} degrees)")
        return side

    def errors(self, pairs: PosePairs, bounds: RelationBounds) -> PoseErrors:
        """Errors of poses in the same map, by this alignment."""
        middle = self.keyframes.T_world_cam[:, :3, 3].mean(axis=0)
        extent_m = np.linalg.norm(pairs.T_world_cam[:, :3, 3] - middle, axis=1) + self.depth_m
        return pose_errors(pairs, self.alignment, extent_m, bounds)


def audit_asserted(
    relation: Relation, truth: Truth, bounds: RelationBounds = RELATION_BOUNDS
) -> RelationAudit:
    """Judge the relation that a loop closure or a fusion asserts."""
    side = RecognisedSide.of(relation, truth, bounds)
    if isinstance(side, Undefined):
        return RelationAudit.open(f"recognised keyframes: {side.reason}")
    new = _pairs(relation.new, truth)
    if not len(new):
        return RelationAudit.open("no true pose of the recognising keyframes")
    medians = side.errors(new.where(np.arange(len(new)) < bounds.compared), bounds).medians
    position_m, bound_m, rotation_deg = medians
    false = position_m > bound_m or rotation_deg > bounds.rotation_deg
    scale_error = _scale_error(side, new, relation.depth, bounds)
    if isinstance(scale_error, Undefined):
        return RelationAudit(*medians, None, false, f"scale: {scale_error.reason}")
    return RelationAudit(*medians, scale_error, false or abs(scale_error) > bounds.scale_share, "")


def _scale_error(
    side: RecognisedSide, new: PosePairs, depth: float, bounds: RelationBounds
) -> float | Undefined:
    other = _spread_out(new, depth, bounds)
    if isinstance(other, Undefined):
        return Undefined(f"recognising keyframes: {other.reason}")
    needed = bounds.min_spread_share * depth
    for name, pairs in (("recognised", side.keyframes), ("recognising", other)):
        if (spread := _spread(pairs.T_map_cam)) < needed:
            share = bounds.min_spread_share
            return Undefined(f"{name} keyframes: {spread / depth:.3f} median depths apart, {share:g} needed")
    alignment = align_poses(other.T_map_cam, other.T_world_cam)
    # A side that is too large has too small a factor to metres.
    return alignment if isinstance(alignment, Undefined) else side.alignment.scale / alignment.scale - 1


def _spread_out(pairs: PosePairs, depth: float, bounds: RelationBounds) -> PosePairs | Undefined:
    """The nearest keyframes, and as many more as it takes until they stand far enough apart."""
    n = len(pairs)
    if n < bounds.min_poses:
        return Undefined(f"{n} with a true pose, {bounds.min_poses} needed")
    for count in range(min(n, bounds.aligned), n + 1):
        part = pairs.where(np.arange(n) < count)
        enough = _spread(part.T_map_cam) >= bounds.min_spread_share * depth
        if enough and _spread(part.T_world_cam) >= bounds.min_spread_m:
            return part
    spread_m = _spread(pairs.T_world_cam)
    if spread_m < bounds.min_spread_m:
        return Undefined(f"{spread_m:.2f} m apart, {bounds.min_spread_m:g} m needed")
    return pairs


def _spread(T: np.ndarray) -> float:
    """Distance of the two poses that are farthest apart."""
    p = T[:, :3, 3]
    return float(np.linalg.norm(p[:, None] - p[None], axis=2).max())


def _pairs(placed: PlacedFrames, truth: Truth) -> PosePairs:
    return truth.pairs(MapTrajectory(-1, placed.frames, placed.stamps_s, placed.T_map_cam))
