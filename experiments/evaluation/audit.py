"""Audit of the estimate by the truth: loss of the pose, late declaration, false fusion. Never fed back."""

from dataclasses import dataclass

import numpy as np

from dslab.experiments.evaluation.alignment import Similarity, Undefined, align_poses
from dslab.experiments.evaluation.metrics import PoseBounds, PosePairs, Truth, path_length_m, pose_errors
from dslab.slam.core.results import MapTrajectory


@dataclass(frozen=True)
class AuditBounds(PoseBounds):
    """Bounds beyond which an estimate counts as wrong.

    The extent is the true path since the start of the reference window.

    Attributes:
        scale_share: scale error allowed across a fusion.
        reference_s: length of the window before the onset on which the estimate is aligned to the truth.
        seam_s: length of the window after a breakage on which the seam of a fusion is judged; also the least
            time that poses are wrong in silence, and the longest gap of the truth that is judged across.
        min_poses: least number of poses for an alignment.
        min_path_m: least true path for an alignment.
    """

    scale_share: float = 0.10
    reference_s: float = 5.0
    seam_s: float = 1.0
    min_poses: int = 15
    min_path_m: float = 0.2


BOUNDS = AuditBounds()
RELATION_BOUNDS = AuditBounds(min_poses=5)
"""For the relation that a recovery finds; it starts when the new map has this number of keyframes."""


@dataclass(frozen=True)
class LossAudit:
    """True loss of the pose.

    Attributes:
        true_loss_frame: first frame from which no pose is within the bounds until the end of the window; None
            if not lost.
    """

    true_loss_frame: int | None


@dataclass(frozen=True)
class FusionAudit:
    """Comparison of a fused map on the two sides of the breakage.

    Attributes:
        scale_error: size of the part after the breakage over that of the part before, both in units of
            the truth, minus 1; None if one of the two is too short to have a scale.
        seam_error_m: median position error over the first ``seam_s`` after the breakage, aligned on the
            ``reference_s`` before it.
        seam_rotation_deg: likewise, of the orientation.
        seam_bound_m: position error allowed there.
        false: scale or seam are out of bounds; None if neither could be judged.
        reason: the figures that could not be judged, with the causes; empty if none.
    """

    scale_error: float | None
    seam_error_m: float | None
    seam_rotation_deg: float | None
    seam_bound_m: float | None
    false: bool | None
    reason: str


def audit_loss(
    live: MapTrajectory, truth: Truth, onset_frame: int, end_frame: int, bounds: AuditBounds = BOUNDS
) -> LossAudit | Undefined:
    """Find the true loss in the frames ``onset_frame .. end_frame``.

    The poses of one map are aligned to the truth over ``reference_s`` before the onset and followed
    from there.

    Args:
        live: the poses of the map as returned at each frame.
        truth: of the sequence.
        onset_frame: first frame that may be lost.
        end_frame: last frame of the window (inclusive): the declaration if there is one.
        bounds: bounds of a correct pose.

    Returns:
        The finding; Undefined if the poses before the onset determine no alignment.
    """
    pairs = truth.pairs(live)
    start_frame = int(np.searchsorted(truth.stamps_s, truth.stamps_s[onset_frame] - bounds.reference_s))
    reference = pairs.where((pairs.frames >= start_frame) & (pairs.frames < onset_frame))
    alignment = _reference_alignment(reference, bounds)
    if isinstance(alignment, Undefined):
        return alignment
    window = pairs.where((pairs.frames >= onset_frame) & (pairs.frames <= end_frame))
    along_m = truth.walked_m()
    errors = pose_errors(window, alignment, along_m[window.frames] - along_m[start_frame], bounds)
    # Frames without truth are passed over.
    frames = onset_frame + np.flatnonzero(truth.known[onset_frame : end_frame + 1])
    return LossAudit(lost_from(frames, ~np.isin(frames, window.frames[~errors.false])))


def lost_from(frames: np.ndarray, wrong: np.ndarray) -> int | None:
    """First of n frames from which all are wrong, to the last; None for none."""
    right = np.flatnonzero(~wrong)
    lost = frames[right[-1] + 1 :] if len(right) else frames
    return int(lost[0]) if len(lost) else None


def audit_relation(
    old: MapTrajectory,
    placed: MapTrajectory,
    stamps_s: np.ndarray,
    T_world_cam: np.ndarray,
    onset_frame: int,
    bounds: AuditBounds = RELATION_BOUNDS,
) -> FusionAudit:
    """Judge the pose of a new map in an old one found by a recovery, applied or not.

    Args:
        old: poses in the old map; those before the onset are used.
        placed: poses of the new map's keyframes, in the old map; those after the onset are used.
        stamps_s: (N,) float64 times of all frames.
        T_world_cam: (N, 4, 4) float64 true poses, NaN where unknown.
        onset_frame: end of the trusted part of the old map.
        bounds: bounds of a correct relation.
    """
    truth = Truth(stamps_s, T_world_cam)
    before = truth.pairs(old.where(old.frames < onset_frame))
    after = truth.pairs(placed.where(placed.frames > onset_frame))
    scale_error, seam = _scale_error(before, after, bounds), _seam(before, after, truth, bounds)
    verdicts, reasons = [], []
    if isinstance(scale_error, Undefined):
        reasons.append(f"scale: {scale_error.reason}")
        scale_error = None
    else:
        verdicts.append(abs(scale_error) > bounds.scale_share)
    error_m = bound_m = rotation_deg = None
    if isinstance(seam, Undefined):
        reasons.append(f"seam: {seam.reason}")
    else:
        error_m, bound_m, rotation_deg = seam
        verdicts.append(error_m > bound_m or rotation_deg > bounds.rotation_deg)
    false = any(verdicts) if verdicts else None
    return FusionAudit(scale_error, error_m, rotation_deg, bound_m, false, "; ".join(reasons))


def _reference_alignment(reference: PosePairs, bounds: AuditBounds) -> Similarity | Undefined:
    lacks = lacks_for_alignment(reference, bounds)
    return Undefined(lacks) if lacks else align_poses(reference.T_map_cam, reference.T_world_cam)


def lacks_for_alignment(reference: PosePairs, bounds: AuditBounds) -> str:
    """What the truth lacks for an alignment of these poses; empty for nothing."""
    if len(reference) < bounds.min_poses:
        return f"{len(reference)} poses, {bounds.min_poses} needed"
    moved = path_length_m(reference.T_world_cam)
    return "" if moved >= bounds.min_path_m else f"{moved:.2f} m of path, {bounds.min_path_m:g} m needed"


def _scale_error(before: PosePairs, after: PosePairs, bounds: AuditBounds) -> float | Undefined:
    scales = []
    for name, part in (("before", before), ("after", after)):
        alignment = _reference_alignment(part, bounds)
        if isinstance(alignment, Undefined):
            return Undefined(f"{name} the breakage: {alignment.reason}")
        scales.append(alignment.scale)
    # A part of the map that is too large has too small a factor to metres.
    return scales[0] / scales[1] - 1


def _seam(
    before: PosePairs, after: PosePairs, truth: Truth, bounds: AuditBounds
) -> tuple[float, float, float] | Undefined:
    """Position error, its bound and rotation error just after the breakage, medians."""
    if not len(before):
        return Undefined("no pose before the breakage")
    stamps_s = truth.stamps_s
    reference_end = stamps_s[before.frames[-1]]
    reference = before.where(stamps_s[before.frames] >= reference_end - bounds.reference_s)
    alignment = _reference_alignment(reference, bounds)
    if isinstance(alignment, Undefined):
        return Undefined(f"before the breakage: {alignment.reason}")
    if not len(after):
        return Undefined("no pose after the breakage")
    first = after.where(stamps_s[after.frames] <= stamps_s[after.frames[0]] + bounds.seam_s)
    walked = path_length_m(truth.T_world_cam[reference.frames[0] : first.frames[-1] + 1])
    return pose_errors(first, alignment, walked, bounds).medians
