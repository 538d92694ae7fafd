"""Pixels of a frame that are followed from frame to frame, some with known 3D positions."""

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import ViewGeometry
from dslab.slam.optimization._triangulation import triangulate


@dataclass
class TrackedFrame:
    """Features of a frame in tracks.

    Attributes:
        frame: the frame, with or without a pose.
        xy: (n, 2) undistorted pixels.
        inv_sigma2: (n,) information of each, 1/px².
        xyz_cam: (n, 3) positions in the frame's camera, NaN where unknown.
        track: (n,) int64 track id, the same in every frame; -1 until the frame is placed.
        seen_from: (n,) int32 number of the placed frame that saw the feature first.
        seen_at: (n, 2) its undistorted pixel there.
    """

    frame: Frame
    xy: np.ndarray
    inv_sigma2: np.ndarray
    xyz_cam: np.ndarray = field(init=False)
    track: np.ndarray = field(init=False)
    seen_from: np.ndarray = field(init=False)
    seen_at: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        n = len(self.xy)
        self.xyz_cam = np.full((n, 3), np.nan)
        self.track = np.full(n, -1, np.int64)
        self.seen_from = np.full(n, -1, np.int32)
        self.seen_at = self.xy.copy()

    @property
    def known(self) -> np.ndarray:
        """(n,) bool mask of the features with a position."""
        return np.isfinite(self.xyz_cam[:, 0])

    @property
    def depth(self) -> float:
        """Median depth of the features with a position, 0 without any."""
        return float(np.median(self.xyz_cam[self.known, 2])) if self.known.any() else 0.0

    def follow(self, rows: np.ndarray, other: "TrackedFrame", theirs: np.ndarray) -> None:
        """Continue the tracks of features ``theirs`` of another frame in features ``rows``."""
        self.track[rows] = other.track[theirs]
        self.seen_from[rows], self.seen_at[rows] = other.seen_from[theirs], other.seen_at[theirs]

    def forget(self, rows: np.ndarray) -> None:
        """Reset features ``rows`` to new ones."""
        self.track[rows], self.seen_from[rows] = -1, -1
        self.xyz_cam[rows], self.seen_at[rows] = np.nan, self.xy[rows]

    def set_positions(self, rows: np.ndarray, xyz: np.ndarray, T_cam_map: np.ndarray) -> None:
        """Set the positions ``xyz`` (k, 3), frame map, of features ``rows``."""
        self.xyz_cam[rows] = xyz @ T_cam_map[:3, :3].T + T_cam_map[:3, 3]

    def positions(self, rows: np.ndarray, T_cam_map: np.ndarray) -> np.ndarray:
        """(k, 3) positions of features ``rows``, frame map."""
        return (self.xyz_cam[rows] - T_cam_map[:3, 3]) @ T_cam_map[:3, :3]


def take_depth_from_points(
    tracked: TrackedFrame,
    xyz: np.ndarray,
    xy: np.ndarray,
    T_cam_map: np.ndarray,
    view: ViewGeometry,
    radius_px: float,
) -> None:
    """Give features without a position the depth of the nearest map point in the image.

    Args:
        tracked: changed in place.
        xyz: (m, 3) map points that the frame sees.
        xy: (m, 2) their undistorted keypoints, px.
        T_cam_map: (4, 4) the frame's pose.
        view: intrinsics.
        radius_px: largest distance to the map point's keypoint.
    """
    rows = np.flatnonzero(~tracked.known)
    if not len(rows) or not len(xyz):
        return
    distance, nearest = cKDTree(xy).query(tracked.xy[rows], distance_upper_bound=radius_px)
    rows, nearest = rows[np.isfinite(distance)], nearest[np.isfinite(distance)]
    depth = xyz[nearest] @ T_cam_map[2, :3] + T_cam_map[2, 3]
    rows, depth = rows[depth > 0], depth[depth > 0]
    tracked.xyz_cam[rows] = depth[:, None] * rays(tracked.xy[rows], view)


def rays(xy: np.ndarray, view: ViewGeometry) -> np.ndarray:
    """(n, 3) directions of undistorted pixels (n, 2) in the camera frame, with depth one."""
    return np.column_stack([(xy - (view.cx, view.cy)) / (view.fx, view.fy), np.ones(len(xy))])


@njit(cache=True, nogil=True)
def triangulate_pairs(T_1, rays_1, T_2, rays_2, tolerance2, min_parallax_cosine):
    """Triangulate points from pairs of views.

    Args:
        T_1: (n, 4, 4) float64 poses of the first views.
        rays_1: (n, 3) directions in their cameras, with depth one.
        T_2: (4, 4) pose of the second view.
        rays_2: (n, 3) directions in its camera.
        tolerance2: (n,) largest accepted squared reprojection error at depth one.
        min_parallax_cosine: rays with a larger cosine give no point.

    Returns:
        points (n, 3), NaN where there is none; disagrees (n,) bool, where the rays do not intersect.
    """
    n = len(rays_1)
    xyz = np.full((n, 3), np.nan)
    disagrees = np.zeros(n, np.bool_)
    for i in range(n):
        dot, norm_1, norm_2 = 0.0, 0.0, 0.0
        for r in range(3):
            ray_1 = T_1[i, 0, r] * rays_1[i, 0] + T_1[i, 1, r] * rays_1[i, 1] + T_1[i, 2, r] * rays_1[i, 2]
            ray_2 = T_2[0, r] * rays_2[i, 0] + T_2[1, r] * rays_2[i, 1] + T_2[2, r] * rays_2[i, 2]
            dot += ray_1 * ray_2
            norm_1 += ray_1 * ray_1
            norm_2 += ray_2 * ray_2
        if dot > min_parallax_cosine * np.sqrt(norm_1 * norm_2):
            continue
        x, y, z = triangulate(T_1[i], T_2, rays_1[i, 0], rays_1[i, 1], rays_2[i, 0], rays_2[i, 1])
        if not np.isfinite(x):
            disagrees[i] = True
            continue
        if (
            _error2(T_1[i], x, y, z, rays_1[i]) > tolerance2[i]
            or _error2(T_2, x, y, z, rays_2[i]) > tolerance2[i]
        ):
            disagrees[i] = True
            continue
        xyz[i, 0], xyz[i, 1], xyz[i, 2] = x, y, z
    return xyz, disagrees


@njit(cache=True, nogil=True)
def _error2(T, x, y, z, ray):
    depth = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    if depth <= 0.0:
        return np.inf
    du = (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / depth - ray[0]
    dv = (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / depth - ray[1]
    return du * du + dv * dv
