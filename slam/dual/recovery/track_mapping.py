"""Local mapping of ORB features on poses that other features constrain too.

Source: paper, Algorithm 1, line 20: bundle adjustment and reconstruction with ORB features on SIFT's poses.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dslab.slam.features.tracks import TrackedFrame
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import MIN_OBSERVATIONS, Map
from dslab.slam.mapping._local_problem import local_problem
from dslab.slam.mapping.local_mapping import LocalMapper, LocalMappingConfig

_MIN_VIEWS = 3  # of a track: two views agree on any point along their epipolar line
_FIXED = 2  # oldest of the newest keyframes, which fix position and scale for the others


class TrackMapper(LocalMapper):
    """Local mapping with the tracked features of the newest keyframes.

    They take part in bundle adjustment, and those keyframes are matched for new points even if they share
    none: so the map continues across frames in which no ORB features are matched.

    Args:
        map_: the map.
        config: settings.
        first: view of the keyframe at which recovery starts.
        latest: returns the view of the frame that becomes a keyframe.
        kept: number of keyframes whose tracked features are kept.
        paired: number of them matched for new points.
        start: the keyframe at which recovery starts.
    """

    def __init__(
        self,
        map_: Map,
        config: LocalMappingConfig,
        first: TrackedFrame,
        latest: Callable[[], TrackedFrame],
        kept: int,
        paired: int,
        start: int = 0,
    ) -> None:
        super().__init__(map_, config)
        self._latest = latest
        self._kept = kept
        self._paired = paired
        self._views: dict[int, TrackedFrame] = {start: first}

    def adjust_keyframes(self, free: np.ndarray) -> None:
        """Bundle-adjust the keyframes marked in ``free``, the newest ones, and their points.

        Args:
            free: (n_keyframes,) bool.
        """
        m, a, view = self.map, self.map.arrays, self.map.view
        made = [k for k in self._views if not a.kf_bad[k]]
        free = free.copy()
        free[made] = True
        free[made[: min(_FIXED, len(made) - 1)]] = False
        cameras, points, obs_camera, obs_point, obs_keypoint = local_problem(
            a, m.n_keyframes, m.n_points, free, self.config.fixed
        )
        cameras = np.concatenate([cameras, np.setdiff1d(made, cameras)]).astype(np.int64)
        tracks = self._track_problem(cameras)
        observed = np.bincount(np.concatenate([obs_camera, tracks.camera]), minlength=len(cameras))
        fixed = ~free[cameras] | (observed < self.rules.least_observations)
        if not fixed.any():
            fixed[0] = True
        if fixed.all() or not (len(points) or len(tracks.xyz)):
            return
        count = len(obs_camera)
        result, good = self.rules.adjust(
            a.kf_T_cam_map[cameras],
            fixed,
            np.concatenate([a.pt_xyz[points], tracks.xyz]),
            np.concatenate([obs_camera, tracks.camera]),
            np.concatenate([obs_point, len(points) + tracks.point]),
            np.concatenate([a.kp_xy[obs_keypoint], tracks.xy]),
            np.concatenate([self._information(cameras, obs_camera, obs_keypoint), tracks.inv_sigma2]),
            view.fx, view.fy, view.cx, view.cy,
        )  # fmt: skip
        a.kf_T_cam_map[cameras[~fixed]] = result.T_cam_map[~fixed]
        a.pt_xyz[points] = result.points[: len(points)]
        kernels.erase_observations(a, obs_keypoint[~good[:count]], MIN_OBSERVATIONS)
        kernels.refresh_geometries(a, points, view)
        xyz = result.points[len(points) :][tracks.point]
        for c in np.unique(tracks.camera):
            own, seen = tracks.camera == c, self._views[int(cameras[c])]
            seen.set_positions(tracks.row[own], xyz[own], result.T_cam_map[c])
            seen.forget(tracks.row[own & ~good[count:]])

    # -- steps -------------------------------------------------------------------------------------------

    def _create_points(self, keyframe: int) -> None:
        """Triangulate matches with covisible keyframes and with the newest ones."""
        self._views[keyframe] = self._latest()
        for old in list(self._views)[: -self._kept]:
            del self._views[old]
        super()._create_points(keyframe)
        # These need not share points with it, and it need not have any.
        depth = self._views[keyframe].depth
        nearest = self.config.min_depth * depth
        expected = self.rules.expected_depths(keyframe, depth)
        covisible = set(self.map.neighbours(keyframe, self.config.neighbours).tolist())
        for other in list(self._views)[-1 - self._paired : -1]:
            if other not in covisible and not self.map.arrays.kf_bad[other]:
                created = self._triangulate(keyframe, other, depth, nearest, expected)
                self._young = np.concatenate([self._young, created])

    def _track_problem(self, cameras: np.ndarray) -> "_TrackProblem":
        """Bundle adjustment terms of the tracked features seen from ``cameras`` (C,), keyframe rows."""
        seen = [
            (c, self._views[int(k)], self.map.T_cam_map(int(k)))
            for c, k in enumerate(cameras)
            if k in self._views
        ]
        track = np.concatenate([v.track for _, v, _ in seen])
        row = np.concatenate([np.arange(len(v.track)) for _, v, _ in seen])
        camera = np.concatenate([np.full(len(v.track), c) for c, v, _ in seen])
        positions = np.concatenate([v.positions(np.arange(len(v.track)), T) for _, v, T in seen])
        names, point, counts = np.unique(track, return_inverse=True, return_counts=True)
        xyz = np.full((len(names), 3), np.nan)
        # Of several positions of a feature, that of the newest keyframe is used.
        made = np.argsort(cameras[camera], kind="stable")
        made = made[np.isfinite(positions[made, 0])]
        xyz[point[made]] = positions[made]
        use = (counts >= _MIN_VIEWS) & np.isfinite(xyz[:, 0])
        keep = use[point]
        return _TrackProblem(
            camera[keep],
            row[keep],
            (np.cumsum(use) - 1)[point[keep]],
            xyz[use],
            np.concatenate([v.xy for _, v, _ in seen])[keep],
            np.concatenate([v.inv_sigma2 for _, v, _ in seen])[keep],
        )


@dataclass(frozen=True)
class _TrackProblem:
    """Observations (n,) of tracked features, ordered by camera, and their points (p, 3)."""

    camera: np.ndarray
    row: np.ndarray
    point: np.ndarray
    xyz: np.ndarray
    xy: np.ndarray
    inv_sigma2: np.ndarray
