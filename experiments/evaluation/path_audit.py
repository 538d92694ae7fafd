"""A path judged against the truth all along, by the rule of the true loss, once a second.

The poses are aligned over ``reference_s`` and followed from there for as long again: what is allowed from one
to the other is a change of direction by 5 degrees, or of scale by 10 %, which by the end comes to 5 % of the
path. A drift that takes longer is no loss.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dslab.experiments.evaluation.alignment import Similarity, Undefined, align_poses
from dslab.experiments.evaluation.audit import AuditBounds, lacks_for_alignment, lost_from
from dslab.experiments.evaluation.metrics import (
    PoseErrors,
    PosePairs,
    Truth,
    path_length_m,
    pose_errors,
    rms,
)
from dslab.slam.core.results import MapTrajectory

STEP_S = 1.0
"""From one window to the next."""
_ROUNDING_S = 1e-6
_NO_TRUTH = "no true pose"
_UNFIT = "the poses before do not fit the truth"
_UNCERTAIN = "the poses before leave scale or direction open"


@dataclass(frozen=True)
class PathAudit:
    """Judgement of a path.

    Attributes:
        judged: frames that could be judged, increasing.
        wrong: first and last frame of every stretch that is out of bounds.
        unjudged: why a frame could not be judged, by frame.
    """

    judged: np.ndarray
    wrong: tuple[tuple[int, int], ...]
    unjudged: dict[int, str]


@dataclass(frozen=True)
class Fit:
    """Poses in one alignment of all of them.

    Attributes:
        alignment: that alignment.
        errors: of each pose, the bound over the whole of their true path.
    """

    alignment: Similarity
    errors: PoseErrors

    @property
    def error_m(self) -> float:
        """RMS of the position errors."""
        return rms(self.errors.position_m)

    @property
    def rotation_deg(self) -> float:
        """RMS of the orientation errors."""
        return rms(self.errors.rotation_deg)

    def is_false(self, bounds: AuditBounds) -> bool:
        """True if one of the two is out of bounds: no similarity makes the truth of these poses."""
        return self.error_m > float(self.errors.bound_m[0]) or self.rotation_deg > bounds.rotation_deg


@dataclass(frozen=True)
class _Window:
    """Verdict on one window.

    Attributes:
        judged: frames that it judges.
        right_until: last frame before which all are right; -1 if that is not known.
        lost: first frame that is lost; None for none.
        left, reason: the other frames, and why they are not judged.
    """

    judged: np.ndarray
    right_until: int
    lost: int | None
    left: np.ndarray
    reason: str


def fit(pairs: PosePairs, bounds: AuditBounds) -> Fit | Undefined:
    """Judge poses in one alignment of all of them; Undefined if none brings them near the true path."""
    alignment = align_poses(pairs.T_map_cam, pairs.T_world_cam)
    if isinstance(alignment, Undefined):
        return alignment
    return Fit(alignment, pose_errors(pairs, alignment, path_length_m(pairs.T_world_cam), bounds))


def audit_path(path: MapTrajectory, truth: Truth, bounds: AuditBounds) -> PathAudit:
    """Judge the poses of one map, of which none was moved against the others.

    The first window that reaches a pose decides on it.
    """
    unjudged, judged, wrong = dict.fromkeys(path.frames.tolist(), _NO_TRUTH), set(), []
    along_m = truth.walked_m()
    for piece in known_pieces(truth.pairs(path), truth, bounds):
        right_until = -1
        for window in _windows(piece, truth.stamps_s, along_m, bounds):
            judged.update(window.judged.tolist())
            unjudged |= dict.fromkeys(window.left.tolist(), window.reason)
            if window.lost is not None and window.judged[-1] > right_until:
                wrong.append((max(window.lost, right_until + 1), int(window.judged[-1])))
            right_until = max(right_until, window.right_until)
    frames = np.array(sorted(judged), int)
    return PathAudit(frames, _joined(wrong), {f: r for f, r in unjudged.items() if f not in judged})


def known_pieces(pairs: PosePairs, truth: Truth, bounds: AuditBounds) -> list[PosePairs]:
    """Poses between gaps of the truth longer than ``seam_s``: how far was walked in one is not known."""
    known = np.flatnonzero(truth.known)
    begun = known[1:][np.diff(truth.stamps_s[known]) > bounds.seam_s]
    number = np.searchsorted(begun, pairs.frames, side="right")
    return [pairs.where(number == own) for own in np.unique(number)]


def _windows(
    piece: PosePairs, stamps_s: np.ndarray, along_m: np.ndarray, bounds: AuditBounds
) -> Iterator[_Window]:
    times_s = stamps_s[piece.frames]
    whole = align_poses(piece.T_map_cam, piece.T_world_cam)
    first_s = times_s[0] + bounds.reference_s
    count = 1 + max(0, int(np.ceil((times_s[-1] - bounds.seam_s - first_s) / STEP_S)))
    for onset_s in first_s + STEP_S * np.arange(count):
        before = (times_s >= onset_s - bounds.reference_s - _ROUNDING_S) & (times_s < onset_s)
        after = (times_s >= onset_s) & (times_s <= onset_s + bounds.reference_s)
        if before.any():
            reference, followed = piece.where(before), piece.where(after)
            yield _window(piece.where(before | after), reference, followed, whole, stamps_s, along_m, bounds)


def _window(
    window: PosePairs,
    reference: PosePairs,
    followed: PosePairs,
    whole: Similarity | Undefined,
    stamps_s: np.ndarray,
    along_m: np.ndarray,
    bounds: AuditBounds,
) -> _Window:
    """Judge poses by the first of them, unless all lie right in the path as a whole."""
    none, frames = np.empty(0, int), window.frames
    first, last = int(frames[0]), int(frames[-1])

    def lasts(lost: int | None) -> bool:
        return lost is not None and stamps_s[last] - stamps_s[lost] >= bounds.seam_s

    if lacks := lacks_for_alignment(reference, bounds):
        return _Window(none, -1, None, frames, lacks)
    # Within the reference, as in its own alignment, the bound is that over all of it.
    path_m = along_m[frames] - along_m[first]
    extent_m = np.maximum(path_m, path_m[len(reference) - 1])
    if isinstance(whole, Similarity) and not pose_errors(window, whole, extent_m, bounds).false.any():
        return _Window(frames, last, None, none, "")
    own = fit(reference, bounds)
    if isinstance(own, Undefined) or own.is_false(bounds):
        return _Window(reference.frames, -1, first, followed.frames, _UNFIT)
    found = pose_errors(followed, own.alignment, extent_m[len(reference) :], bounds)
    lost = lost_from(followed.frames, found.false)
    if not lasts(lost):  # the next window will tell of a loss at the end of this one
        return _Window(frames, last if lost is None else lost - 1, None, none, "")
    certain = _carried_m(own, reference, followed) <= found.bound_m
    lost = lost_from(followed.frames, found.false & certain)
    if lost is None or not lasts(lost):
        return _Window(reference.frames, -1, None, followed.frames, _UNCERTAIN)
    return _Window(frames, lost - 1, lost, none, "")


def _carried_m(own: Fit, reference: PosePairs, followed: PosePairs) -> np.ndarray:
    """(n,) what the errors within the reference come to at the poses that follow, metres.

    Scale and direction from poses of a small extent are as uncertain as these are off.
    """
    middle = reference.T_world_cam[:, :3, 3].mean(axis=0)
    extent_m = rms(np.linalg.norm(reference.T_world_cam[:, :3, 3] - middle, axis=1))
    away_m = np.linalg.norm(followed.T_world_cam[:, :3, 3] - middle, axis=1)
    return away_m * np.hypot(own.error_m / extent_m, np.radians(own.rotation_deg))


def _joined(stretches: list[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    """Stretches as (first, last frame), those that overlap or touch as one."""
    joined: list[tuple[int, int]] = []
    for first, last in sorted(stretches):
        if joined and first <= joined[-1][1] + 1:
            joined[-1] = joined[-1][0], max(joined[-1][1], last)
        else:
            joined.append((first, last))
    return tuple(joined)
