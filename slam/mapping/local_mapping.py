"""Local mapping: extend and refine the map with each new keyframe."""

from contextlib import AbstractContextManager, nullcontext

import numpy as np

from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import camera_centre
from dslab.slam.core.settings import DEPTHS, setting, settings
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import MIN_OBSERVATIONS, Map
from dslab.slam.mapping._local_problem import local_problem
from dslab.slam.mapping.rules import MapRule, MapRules, map_rules


@settings
class LocalMappingConfig:
    """Settings of local mapping."""

    rules: MapRule = setting("own", "what decides: covariances; published: what ORB-SLAM's text says")
    max_depth_error: float = setting(0.1, "largest standard deviation of a new depth over itself")
    neighbours: int = setting(10, "covisible keyframes used for triangulation and fusion")
    min_baseline: float = setting(0.01, "least baseline for triangulation", unit=DEPTHS)
    min_depth: float = setting(0.1, "least depth of a new point", unit=DEPTHS)
    window: int = setting(20, "keyframes that local bundle adjustment moves, the new one included")
    fixed: int = setting(40, "most fixed keyframes around them")
    min_found_share: float = setting(0.25, "a young point found in less is culled", le=1)
    redundancy: float = setting(0.9, "share of points well seen elsewhere that culls a keyframe", le=1)


class LocalMapper:
    """Grows and refines one map, keyframe by keyframe.

    Args:
        map_: the map.
        config: settings.
        lock: held while the map is read or written, step by step and never while a problem is solved:
            concurrent tracking waits for a few milliseconds at most.
    """

    def __init__(
        self, map_: Map, config: LocalMappingConfig, lock: AbstractContextManager | None = None
    ) -> None:
        self.map = map_
        self.config = config
        self.lock = lock or nullcontext()
        self._young = np.empty(0, np.int64)

    @property
    def rules(self) -> MapRules:
        """What it decides by."""
        return map_rules(self.map, self.config)

    def insert(self, frame: Frame) -> int:
        """Make a keyframe of a tracked frame and extend the map from it.

        Returns:
            Row of the keyframe in the map.
        """
        with self.lock:
            kernels.resolve_points(self.map.arrays, frame.point)
            keyframe = self.map.add_keyframe(frame, self.map.live(frame.reference_keyframe))
            self._cull_young_points(keyframe)
        self._create_points(keyframe)
        self._fuse_neighbours(keyframe)
        self.adjust(keyframe)
        with self.lock:
            self._cull_keyframes(keyframe)
        return keyframe

    def adjust(self, keyframe: int) -> None:
        """Bundle-adjust a keyframe and its neighbours; other observers of their points are fixed."""
        m = self.map
        free = np.zeros(m.n_keyframes, np.bool_)
        free[keyframe] = True
        free[m.neighbours(keyframe, self.config.window - 1)] = True
        self.adjust_keyframes(free)

    def adjust_keyframes(self, free: np.ndarray) -> None:
        """Bundle-adjust the keyframes marked in ``free`` (n_keyframes,) bool and all their points.

        If no other keyframe fixes the gauge, the oldest of them is fixed.
        """
        m, a, view = self.map, self.map.arrays, self.map.view
        with self.lock:
            cameras, points, obs_camera, obs_point, obs_keypoint = local_problem(
                a, m.n_keyframes, m.n_points, free, self.config.fixed
            )
            T_cam_map, xyz = a.kf_T_cam_map[cameras], a.pt_xyz[points]
            information = self._information(cameras, obs_camera, obs_keypoint)
        observed = np.bincount(obs_camera, minlength=len(cameras))
        fixed = ~free[cameras] | (observed < self.rules.least_observations)
        if not fixed.any():
            fixed[0] = True
        if fixed.all() or not len(points):
            return
        result, good = self.rules.adjust(
            T_cam_map, fixed, xyz, obs_camera, obs_point,
            a.kp_xy[obs_keypoint], information,
            view.fx, view.fy, view.cx, view.cy,
        )  # fmt: skip
        with self.lock:
            a.kf_T_cam_map[cameras[~fixed]] = result.T_cam_map[~fixed]
            a.pt_xyz[points] = result.points
            kernels.erase_observations(a, obs_keypoint[~good], MIN_OBSERVATIONS)
            kernels.refresh_geometries(a, points, view)

    @property
    def young(self) -> np.ndarray:
        """(n,) points that are still watched, as they may be dropped."""
        return self._young

    def rebase(self, map_: Map) -> None:
        """Continue in a map that has absorbed this mapper's; young points are no longer checked."""
        self.map = map_
        self._young = np.empty(0, np.int64)

    # -- steps -------------------------------------------------------------------------------------------

    def _information(self, cameras: np.ndarray, obs_camera: np.ndarray, keypoints: np.ndarray) -> np.ndarray:
        """(n,) of keypoints in their cameras, 1/px², at the noise that each keyframe has told."""
        m = self.map
        noise2 = np.array([m.features(int(k)).noise2 for k in cameras])
        noise2[np.isnan(noise2)] = m.noise2
        return m.view.inv_sigma2[m.arrays.kp_octave[keypoints]] / noise2[obs_camera]

    def _cull_young_points(self, keyframe: int) -> None:
        """Cull points that are rarely found, or not observed by a third keyframe in time."""
        a, p = self.map.arrays, self._young
        p = p[~a.pt_bad[p]]
        age = keyframe - a.pt_first_keyframe[p]
        rare = a.pt_found[p] < self.config.min_found_share * a.pt_visible[p]
        lonely = (age >= 2) & (a.pt_observations[p] <= 2)
        kernels.remove_points(a, p[rare | lonely])
        self._young = p[~(rare | lonely) & (age < 3)]

    def _create_points(self, keyframe: int) -> None:
        """Triangulate matches with covisible keyframes."""
        with self.lock:
            nearest = self.config.min_depth * kernels.median_depth(self.map.arrays, keyframe)
            expected = self.rules.expected_depths(keyframe)
        created = []
        for neighbour in self.map.neighbours(keyframe, self.config.neighbours):
            with self.lock:
                depth = kernels.median_depth(self.map.arrays, int(neighbour))
                created.append(self._triangulate(keyframe, int(neighbour), depth, nearest, expected))
        self._young = np.concatenate([self._young, *created])

    def _triangulate(
        self, keyframe: int, other: int, depth: float, nearest: float, expected: np.ndarray
    ) -> np.ndarray:
        """Rows of the points triangulated between two keyframes; none if they are too close for ``depth``."""
        m, a, config = self.map, self.map.arrays, self.config
        baseline = np.linalg.norm(
            camera_centre(a.kf_T_cam_map[other]) - camera_centre(a.kf_T_cam_map[keyframe])
        )
        if depth <= 0 or baseline < config.min_baseline * depth:
            return np.empty(0, np.int64)
        own, theirs, xyz = self.rules.new_points(keyframe, other, nearest, expected)
        first = m.reserve_points(len(own))
        kernels.create_points(m.arrays, first, xyz, own, theirs, m.view)
        return np.arange(first, first + len(own))

    def _fuse_neighbours(self, keyframe: int) -> None:
        """Fuse duplicate points of the keyframe and its first and second neighbours."""
        m, a = self.map, self.map.arrays
        rules = self.rules
        targets = rules.targets(keyframe)
        own = m.observed_points(keyframe)
        for target in targets:
            with self.lock:
                rules.seek(target, own[own >= 0])
        with self.lock:
            theirs = [m.observed_points(target) for target in targets]
            if theirs:
                candidates = np.unique(np.concatenate(theirs))
                rules.seek(keyframe, candidates[candidates >= 0])
            own = m.observed_points(keyframe)
            kernels.refresh_points(a, own[own >= 0], m.view)

    def _cull_keyframes(self, keyframe: int) -> None:
        """Cull neighbours whose points are nearly all seen as well by three others."""
        m, rules = self.map, self.rules
        for k in m.neighbours(keyframe, m.n_keyframes):
            if m.parent(int(k)) < 0:
                continue
            if rules.redundant(int(k)) > self.config.redundancy:
                m.cull_keyframe(int(k))
