"""Results of a system: the outcome of a frame, and the trajectory of a map."""

import math
from dataclasses import dataclass, field

import numpy as np

from dslab.slam.core.events import TrackingState


@dataclass(frozen=True)
class RelativePose:
    """A pose relative to a keyframe, and how well it is known.

    Attributes:
        frame: that the keyframe was made from.
        T_cam_keyframe: (4, 4) keyframe's camera to this one's, map units.
        covariance: (6, 6) of it as a twist from the left: translation in map units, then rotation in rad;
            infinite where it is not determined.
    """

    frame: int
    T_cam_keyframe: np.ndarray
    covariance: np.ndarray

    @property
    def position_sd(self) -> float:
        """Standard deviation of the position along the axis in which it is largest, map units."""
        return _largest_sd(self.covariance[:3, :3])

    @property
    def direction_sd_rad(self) -> float:
        """Standard deviation of the orientation about the axis in which it is largest."""
        return _largest_sd(self.covariance[3:, 3:])


def _largest_sd(covariance: np.ndarray) -> float:
    """Root of the largest eigenvalue of a symmetric (3, 3).

    Source: Smith, "Eigenvalues of a symmetric 3 × 3 matrix", Communications of the ACM 4(4), 1961.
    """
    (xx, _, _), (xy, yy, _), (xz, yz, zz) = covariance.tolist()
    if not math.isfinite(xx + yy + zz + xy + xz + yz):
        return math.inf
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    spread = math.sqrt((a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
    if spread == 0.0:
        return math.sqrt(max(mean, 0.0))
    det = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    angle = math.acos(min(max(0.5 * det / spread**3, -1.0), 1.0)) / 3.0
    return math.sqrt(max(mean + 2.0 * spread * math.cos(angle), 0.0))


@dataclass(frozen=True)
class TrackingResult:
    """The outcome of one frame.

    Attributes:
        frame: index of the frame, from 0.
        stamp_s: its time stamp.
        state: tracker state after the frame.
        T_map_cam: (4, 4) camera to map, at this time; None unless tracking.
        map_id: the current map.
        inliers: matches with map points that survive the pose optimisation.
        matches: matches before the pose optimisation.
        reason: reason of a tracking failure; empty otherwise.
        is_keyframe: a keyframe was made from it.
        keypoints_px: (n, 2) float32 detected features, image pixels.
        inlier_mask: (n,) bool, features that are inliers of the map.
        cpu_ms: CPU milliseconds of this thread per tracking stage; with ``other`` they sum up to the whole
            call, less mapping, loop closing and recovery if these run inside it.
        ms: wall milliseconds per tracking stage, likewise.
        mapping_cpu_ms: CPU milliseconds of local mapping run for this frame (0 without a keyframe).
        loop_cpu_ms: CPU milliseconds of loop closing run for this frame (0 without a keyframe).
        relative: the pose relative to a keyframe; None where the system does not tell how well it is known.
    """

    frame: int
    stamp_s: float
    state: TrackingState
    T_map_cam: np.ndarray | None
    map_id: int
    inliers: int
    matches: int
    reason: str
    is_keyframe: bool
    keypoints_px: np.ndarray
    inlier_mask: np.ndarray
    cpu_ms: dict[str, float] = field(default_factory=dict)
    ms: dict[str, float] = field(default_factory=dict)
    mapping_cpu_ms: float = 0.0
    loop_cpu_ms: float = 0.0
    relative: RelativePose | None = None


@dataclass(frozen=True)
class PhotometricView:
    """What a direct system compares in a frame, for display.

    Attributes:
        keyframes: frames of the keyframes of its window, increasing.
        pixels_px: (n, 2) float32 image pixels at which the frame shows points of the newest keyframe.
        residual: (n,) float32 intensity there, of 255, less that in the keyframe in the frame's brightness.
    """

    keyframes: tuple[int, ...]
    pixels_px: np.ndarray
    residual: np.ndarray

    @classmethod
    def none(cls) -> "PhotometricView":
        """That of a frame without a pose."""
        return cls((), np.empty((0, 2), np.float32), np.empty(0, np.float32))


@dataclass(frozen=True)
class MapTrajectory:
    """Trajectory of one map's frames, in that map's own frame and scale.

    Attributes:
        map_id: the map.
        frames: (n,) int frame indices, increasing.
        stamps_s: (n,) float64.
        T_map_cam: (n, 4, 4) float64 camera to map.
    """

    map_id: int
    frames: np.ndarray
    stamps_s: np.ndarray
    T_map_cam: np.ndarray

    def where(self, kept: np.ndarray) -> "MapTrajectory":
        """The poses that a (n,) bool mask selects."""
        return MapTrajectory(self.map_id, self.frames[kept], self.stamps_s[kept], self.T_map_cam[kept])
