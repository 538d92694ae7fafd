"""Accuracy of a trajectory against the truth: ATE, RPE, errors of poses, scale along the path, coverage."""

from dataclasses import dataclass

import numpy as np

from dslab.experiments.evaluation.alignment import Similarity, Undefined, rotation_angle_deg, umeyama
from dslab.sim.sequence import Sequence
from dslab.slam.core.results import MapTrajectory


@dataclass(frozen=True)
class PosePairs:
    """Estimated and true poses of the same frames.

    Attributes:
        frames: (n,) int frame indices, increasing.
        T_map_cam: (n, 4, 4) float64 estimate.
        T_world_cam: (n, 4, 4) float64 truth, metres.
    """

    frames: np.ndarray
    T_map_cam: np.ndarray
    T_world_cam: np.ndarray

    def __len__(self) -> int:
        return len(self.frames)

    def where(self, mask: np.ndarray) -> "PosePairs":
        """The pairs that a (n,) bool mask selects."""
        return PosePairs(self.frames[mask], self.T_map_cam[mask], self.T_world_cam[mask])


@dataclass(frozen=True)
class Truth:
    """The true path of a sequence.

    Attributes:
        stamps_s: (N,) float64 times of all frames.
        T_world_cam: (N, 4, 4) float64 true poses, metres, NaN where unknown.
    """

    stamps_s: np.ndarray
    T_world_cam: np.ndarray

    @classmethod
    def of(cls, sequence: Sequence) -> "Truth":
        """That of a sequence which has one."""
        assert sequence.T_world_cam is not None
        return cls(sequence.stamps_s, sequence.T_world_cam)

    @property
    def known(self) -> np.ndarray:
        """(N,) bool: the pose is known."""
        return np.asarray(np.isfinite(self.T_world_cam).all(axis=(1, 2)))

    def pairs(self, path: MapTrajectory) -> PosePairs:
        """The poses of a path with the truth; frames without truth are left out."""
        return associate(path, self.stamps_s, self.T_world_cam)

    def walked_m(self) -> np.ndarray:
        """(N,) length of the path up to each pose, metres; straight over unknown poses."""
        known = np.flatnonzero(self.known)
        steps = np.zeros(len(self.T_world_cam))
        steps[known[1:]] = np.linalg.norm(np.diff(self.T_world_cam[known, :3, 3], axis=0), axis=1)
        return np.cumsum(steps)


@dataclass(frozen=True)
class PoseBounds:
    """Bounds beyond which a pose counts as wrong.

    Attributes:
        position_share: position error allowed per metre of the extent over which poses are compared.
        position_floor_m: position error allowed in any case.
        rotation_deg: orientation error allowed.
    """

    position_share: float = 0.05
    position_floor_m: float = 0.1
    rotation_deg: float = 5.0

    def position_m(self, extent_m: np.ndarray | float) -> np.ndarray:
        """Position error allowed over an extent, metres."""
        return np.maximum(self.position_floor_m, self.position_share * np.asarray(extent_m))


@dataclass(frozen=True)
class PoseErrors:
    """Errors of single poses in a common alignment.

    Attributes:
        position_m, bound_m, rotation_deg: (n,) float64.
        false: (n,) bool, out of bounds.
    """

    position_m: np.ndarray
    bound_m: np.ndarray
    rotation_deg: np.ndarray
    false: np.ndarray

    @property
    def medians(self) -> tuple[float, float, float]:
        """Of position, bound and rotation."""
        position_m, bound_m, rotation_deg = map(np.median, (self.position_m, self.bound_m, self.rotation_deg))
        return float(position_m), float(bound_m), float(rotation_deg)


@dataclass(frozen=True)
class Ate:
    """Absolute trajectory error after alignment.

    Attributes:
        alignment: the alignment used; its scale is metres per map unit.
        errors_m: (n,) distance of every aligned position from the true one, metres.
    """

    alignment: Similarity
    errors_m: np.ndarray

    @property
    def rmse_m(self) -> float:
        """By which the error is known."""
        return rms(self.errors_m)


@dataclass(frozen=True)
class Rpe:
    """Relative pose error over a fixed step, after scaling the estimate.

    Attributes:
        translation_rmse_m, translation_median_m: error of the relative translation over the step.
        rotation_rmse_deg, rotation_median_deg: error of the relative rotation over the step.
        delta, unit: the step, in frames.
        pairs: number of steps compared.
    """

    translation_rmse_m: float
    translation_median_m: float
    rotation_rmse_deg: float
    rotation_median_deg: float
    delta: int
    unit: str
    pairs: int


@dataclass(frozen=True)
class ScaleAlong:
    """Scale of the estimate along the true path: true over estimated length, stretch by stretch.

    Attributes:
        relative: (n,) float64 ratio of each of ``n`` stretches of equal true length, over their median; NaN
            for one without motion. All 1 without scale drift.
        first_over_last: ratio over the first quarter of the true path over that of the last quarter; above 1
            where estimated steps grow along the path.
        steps: number of steps compared.
    """

    relative: np.ndarray
    first_over_last: float
    steps: int


@dataclass(frozen=True)
class Coverage:
    """Part of the true path that the estimate covers.

    Attributes:
        path_m: length of the true path between consecutive frames that are both posed.
        share: share of the whole true path; NaN if that does not move.
    """

    path_m: float
    share: float


def associate(
    trajectory: MapTrajectory, stamps_s: np.ndarray, T_world_cam: np.ndarray, tolerance_s: float = 1e-3
) -> PosePairs:
    """Pair the estimate with the truth by frame index; frames without truth are left out.

    Args:
        trajectory: estimated poses.
        stamps_s: (N,) float64 times of all frames of the sequence.
        T_world_cam: (N, 4, 4) float64 true poses, NaN where unknown.
        tolerance_s: largest difference of the two times of a frame.

    Raises:
        ValueError: a frame is outside the sequence or its times differ.
    """
    frames = np.asarray(trajectory.frames, int)
    if frames.size and (frames.min() < 0 or frames.max() >= len(stamps_s)):
        raise ValueError(f"frames {frames.min()}..{frames.max()} of a sequence of {len(stamps_s)}")
    if np.any(np.abs(stamps_s[frames] - trajectory.stamps_s) > tolerance_s):
        raise ValueError(f"time stamps of estimate and truth differ by more than {tolerance_s} s")
    truth = T_world_cam[frames]
    known = np.isfinite(truth).all(axis=(1, 2))
    return PosePairs(frames[known], trajectory.T_map_cam[known], truth[known])


def ate(pairs: PosePairs) -> Ate | Undefined:
    """Absolute trajectory error over all pairs, aligned by Sim(3).

    Source: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012, sec. IV.B.
    """
    alignment = umeyama(pairs.T_map_cam[:, :3, 3], pairs.T_world_cam[:, :3, 3])
    if isinstance(alignment, Undefined):
        return alignment
    return Ate(alignment, position_errors_m(pairs, alignment))


def position_errors_m(pairs: PosePairs, alignment: Similarity) -> np.ndarray:
    """(n,) distance of every aligned position from the true one, metres."""
    return np.linalg.norm(alignment.points(pairs.T_map_cam[:, :3, 3]) - pairs.T_world_cam[:, :3, 3], axis=1)


def pose_errors(
    pairs: PosePairs, alignment: Similarity, extent_m: np.ndarray | float, bounds: PoseBounds
) -> PoseErrors:
    """Compare n poses with the truth.

    Args:
        pairs: the poses.
        alignment: of their map to the world.
        extent_m: (n,), or one for all: the extent over which they are compared.
        bounds: of a right pose.
    """
    position_m = position_errors_m(pairs, alignment)
    aligned = alignment.R_world_map @ pairs.T_map_cam[:, :3, :3]
    rotation_deg = rotation_angle_deg(np.swapaxes(pairs.T_world_cam[:, :3, :3], 1, 2) @ aligned)
    bound_m = np.broadcast_to(bounds.position_m(extent_m), position_m.shape)
    right = (position_m <= bound_m) & (rotation_deg <= bounds.rotation_deg)
    return PoseErrors(position_m, bound_m, rotation_deg, ~right)


def rpe(pairs: PosePairs, delta: int, scale: float = 1.0) -> Rpe | Undefined:
    """Relative pose error over every pair of posed frames exactly ``delta`` apart.

    Args:
        pairs: estimate and truth.
        delta: the step in frames, > 0.
        scale: metres per map unit, from the alignment.

    Returns:
        The errors; Undefined if no step of this length is posed at both ends.

    Source: Sturm et al., IROS 2012, sec. IV.A, eqs. 1-3.
    """
    _, starts, ends = np.intersect1d(pairs.frames + delta, pairs.frames, return_indices=True)
    if not len(starts):
        return Undefined(f"no step of {delta} frames is posed at both ends")
    T_map_cam = pairs.T_map_cam.copy()
    T_map_cam[:, :3, 3] *= scale
    estimated = np.linalg.inv(T_map_cam[starts]) @ T_map_cam[ends]
    true = np.linalg.inv(pairs.T_world_cam[starts]) @ pairs.T_world_cam[ends]
    error = np.linalg.inv(true) @ estimated
    translation, rotation = np.linalg.norm(error[:, :3, 3], axis=1), rotation_angle_deg(error[:, :3, :3])
    medians = float(np.median(translation)), float(np.median(rotation))
    return Rpe(rms(translation), medians[0], rms(rotation), medians[1], delta, "frames", len(starts))


def scale_along(pairs: PosePairs, stretches: int = 10) -> ScaleAlong | Undefined:
    """Scale along the path, from the steps between consecutive posed frames; a gap is no step.

    It needs no alignment. Lengths of steps grow with the noise of the positions: it says something where the
    camera moves much further per frame than that, as on a drive.

    Returns:
        The scale; Undefined if the first or last quarter of the path holds no step, or no motion of the truth
        or of the estimate.
    """
    step = np.flatnonzero(np.diff(pairs.frames) == 1)
    true = np.linalg.norm(np.diff(pairs.T_world_cam[:, :3, 3], axis=0), axis=1)[step]
    estimated = np.linalg.norm(np.diff(pairs.T_map_cam[:, :3, 3], axis=0), axis=1)[step]
    if not true.sum() > 0:
        return Undefined("no step of the true path is posed at both ends")
    middle = (np.cumsum(true) - true / 2) / true.sum()  # of each step, as a share of the path

    def ratio(of: np.ndarray) -> float:
        lengths = float(true[of].sum()), float(estimated[of].sum())
        return lengths[0] / lengths[1] if min(lengths) > 0 else float("nan")

    ratios = np.array([ratio(np.floor(middle * stretches) == k) for k in range(stretches)])
    first_over_last = ratio(middle < 1 / 4) / ratio(middle >= 3 / 4)
    if not np.isfinite(first_over_last):
        return Undefined("no true or no estimated motion in the first or the last quarter of the path")
    return ScaleAlong(ratios / np.nanmedian(ratios), first_over_last, len(step))


def path_length_m(T_world_cam: np.ndarray) -> float:
    """Length of a true path (n, 4, 4), metres, without steps to or from an unknown pose."""
    return float(np.nansum(np.linalg.norm(np.diff(T_world_cam[:, :3, 3], axis=0), axis=1)))


def coverage(frames: np.ndarray, T_world_cam: np.ndarray) -> Coverage:
    """Length of true path (N, 4, 4) covered by the (n,) posed frames, and its share of the whole."""
    steps = np.nan_to_num(np.linalg.norm(np.diff(T_world_cam[:, :3, 3], axis=0), axis=1))
    posed = np.zeros(len(T_world_cam), bool)
    posed[frames] = True
    covered, whole = float(steps[posed[:-1] & posed[1:]].sum()), float(steps.sum())
    # A sum of fewer steps may round above that of all.
    return Coverage(covered, min(1.0, covered / whole) if whole > 0 else float("nan"))


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
