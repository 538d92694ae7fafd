"""Map of keyframes, map points and their associations in flat, growing arrays."""

from dataclasses import replace

import numpy as np

from dslab.slam.core.frame import Frame, FrameFeatures
from dslab.slam.core.geometry import ViewGeometry
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map._map_kernels import MapArrays
from dslab.slam.map.compaction import culled_keypoints, drop_culled_keypoints
from dslab.slam.map.noise import KeypointNoise
from dslab.slam.optimization.sim3 import sim3_decompose

_MIN_CULLED_SHARE = 0.25  # culled share of the keypoints in use, from which they are removed
MIN_SHARED = 15
"""Points that covisible keyframes share: ORB-SLAM, III-D."""
MIN_OBSERVATIONS = 3  # a point with fewer, once it has lost an observation, is dropped


class Map:
    """A map; keyframes and points are row numbers, and kernels read ``arrays`` directly.

    Rows never move: a culled keyframe or dropped point keeps its row and is marked bad. A culled keyframe's
    pose is kept relative to its parent in the spanning tree, so that frames that refer to it still follow
    the map.

    Attributes:
        loop_edges: pairs of keyframes connected by loop closures.
        noise: of the keypoints that are found again.
    """

    def __init__(self, map_id: int, view: ViewGeometry) -> None:
        self.map_id = map_id
        self.view = view
        self.n_keyframes = 0
        self.n_points = 0
        self._features: list[FrameFeatures] = []
        self._parent: list[int] = []
        self._T_cam_parent: dict[int, np.ndarray] = {}
        self.noise = KeypointNoise()
        self.loop_edges: list[tuple[int, int]] = []
        self.arrays = _allocate(16, 16_384, 8_192, view.cols * view.rows + 1)

    @property
    def noise2(self) -> float:
        """Variance of the keypoints that are found again, over what the view says."""
        return self.noise.variance

    # -- keyframes ---------------------------------------------------------------------------------------

    def add_keyframe(self, frame: Frame, parent: int) -> int:
        """Append a keyframe with the frame's pose and features; its matches become observations.

        Args:
            frame: tracked frame; its ``point`` rows refer to this map.
            parent: its parent in the spanning tree, -1 for a root.

        Returns:
            The keyframe's row.
        """
        if not np.isfinite(frame.T_cam_map).all():
            raise ValueError("a keyframe needs a pose")
        k, features = self.n_keyframes, frame.features
        self._make_room(len(features))
        start = int(self.arrays.kf_start[k])
        end = start + len(features)
        self._reserve(keyframes=k + 1, keypoints=end)
        a = self.arrays
        a.kf_T_cam_map[k] = frame.T_cam_map
        a.kf_start[k + 1] = end
        a.kf_bad[k] = False
        a.kf_cells[k] = features.cell_start
        a.kp_xy[start:end] = features.xy
        a.kp_octave[start:end] = features.octave
        a.kp_angle[start:end] = features.angle_deg
        a.kp_descriptor[start:end] = features.descriptors
        a.kp_keyframe[start:end] = k
        a.kp_point[start:end] = -1
        a.kp_next[start:end] = -1
        self.n_keyframes += 1
        self._features.append(features)
        self._parent.append(parent)
        kernels.attach_frame(a, k, frame.point, self.view)
        return k

    def features(self, keyframe: int) -> FrameFeatures:
        """Features of the frame that became this keyframe; empty once it is culled."""
        return self._features[keyframe]

    def take_features(self, keyframe: int, features: FrameFeatures) -> None:
        """Take over a keyframe's features as another camera sees them; its order and matches stay."""
        self._features[keyframe] = features
        self.arrays.kp_xy[self.keypoints(keyframe)] = features.xy

    def frame_index(self, keyframe: int) -> int:
        """Index of the frame that became this keyframe."""
        return self._features[keyframe].index

    def keyframes(self) -> np.ndarray:
        """(n,) rows of the keyframes that are not culled, in order of insertion."""
        return np.flatnonzero(~self.arrays.kf_bad[: self.n_keyframes])

    def parent(self, keyframe: int) -> int:
        """Parent in the spanning tree, -1 for a root."""
        return self._parent[keyframe]

    def live(self, keyframe: int) -> int:
        """Return the keyframe itself or, if it is culled, its nearest live ancestor."""
        while self.arrays.kf_bad[keyframe]:
            keyframe = self._parent[keyframe]
        return keyframe

    def T_cam_map(self, keyframe: int) -> np.ndarray:
        """(4, 4) pose of a keyframe, culled or not."""
        T = np.eye(4)
        while self.arrays.kf_bad[keyframe]:
            T = T @ self._T_cam_parent[keyframe]
            keyframe = self._parent[keyframe]
        return T @ self.arrays.kf_T_cam_map[keyframe]

    def cull_keyframe(self, keyframe: int) -> None:
        """Cull a keyframe; its children in the spanning tree go to its parent."""
        parent = self._parent[keyframe]
        if parent < 0:
            raise ValueError("a root keyframe cannot be culled")
        self._T_cam_parent[keyframe] = self.T_cam_map(keyframe) @ np.linalg.inv(self.T_cam_map(parent))
        for child in self.keyframes():
            if self._parent[child] == keyframe:
                self._parent[child] = parent
        kernels.detach_keyframe(self.arrays, keyframe, MIN_OBSERVATIONS)
        self._features[keyframe] = self._features[keyframe].emptied()

    def neighbours(self, keyframe: int, limit: int, min_shared: int = MIN_SHARED) -> np.ndarray:
        """Covisible keyframes, most shared points first.

        The best one is returned even if it shares fewer points than ``min_shared``.
        """
        shared = self.arrays.covisibility[keyframe, : self.n_keyframes]
        order = np.argsort(-shared, kind="stable")
        count = max(int((shared >= min_shared).sum()), int(shared.max(initial=0) > 0))
        return order[: min(count, limit)]

    def observed_points(self, keyframe: int) -> np.ndarray:
        """(n_keypoints,) int32 view of the map point of each keypoint, -1 for none."""
        return self.arrays.kp_point[self.keypoints(keyframe)]

    def keypoints(self, keyframe: int) -> slice:
        """Slice of the keyframe in the keypoint arrays."""
        return slice(int(self.arrays.kf_start[keyframe]), int(self.arrays.kf_start[keyframe + 1]))

    # -- points ------------------------------------------------------------------------------------------

    def points(self) -> np.ndarray:
        """(n,) rows of the points that are not dropped."""
        return np.flatnonzero(~self.arrays.pt_bad[: self.n_points])

    def reserve_points(self, count: int) -> int:
        """Reserve rows for ``count`` new points, marked bad until they are filled; the first row."""
        first = self.n_points
        self._reserve(points=first + count)
        self.arrays.pt_bad[first : first + count] = True
        self.arrays.pt_replaced[first : first + count] = -1
        self.arrays.pt_head[first : first + count] = -1
        self.n_points += count
        return first

    def create_point(self, xyz: np.ndarray, keypoint: int) -> int:
        """Create a point at ``xyz`` (3,) observed by one keypoint; its row."""
        p = self.reserve_points(1)
        kernels.create_point(self.arrays, p, xyz, keypoint, self.view)
        return p

    # -- whole map ---------------------------------------------------------------------------------------

    def transform(self, scale: float, rotation: np.ndarray, translation: np.ndarray) -> None:
        """Transform the whole map by ``x_new = scale * rotation @ x + translation``.

        Args:
            scale: factor on all lengths.
            rotation: (3, 3).
            translation: (3,).
        """
        a, K, P = self.arrays, self.n_keyframes, self.n_points
        a.pt_xyz[:P] = scale * a.pt_xyz[:P] @ rotation.T + translation
        a.pt_normal[:P] = a.pt_normal[:P] @ rotation.T
        a.pt_covariance[:P] = _transformed(a.pt_covariance[:P], scale * rotation)
        a.pt_max_distance[:P] *= scale
        R = a.kf_T_cam_map[:K, :3, :3] @ rotation.T
        t = scale * a.kf_T_cam_map[:K, :3, 3] - R @ translation
        a.kf_T_cam_map[:K, :3, :3] = R
        a.kf_T_cam_map[:K, :3, 3] = t
        for T in self._T_cam_parent.values():
            T[:3, 3] *= scale

    def move_keyframes(self, S_cam_map: np.ndarray) -> np.ndarray:
        """Set the pose of every live keyframe from a similarity; lengths around it are rescaled.

        Args:
            S_cam_map: (n_keyframes, 4, 4) similarities; rows of culled keyframes are not read.

        Returns:
            (n_keyframes,) scale change of lengths around each keyframe; culled ones as their parents.
        """
        factor = np.ones(self.n_keyframes)
        for k in self.keyframes():
            s, R, t = sim3_decompose(S_cam_map[k])
            self.arrays.kf_T_cam_map[k, :3, :3], self.arrays.kf_T_cam_map[k, :3, 3] = R, t / s
            factor[k] = 1.0 / s
        for k, T in self._T_cam_parent.items():
            factor[k] = factor[self.live(k)]
            T[:3, 3] *= factor[k]
        return factor

    def copy(self, map_id: int | None = None) -> "Map":
        """Return an independent copy; features are shared, since they never change."""
        copied = Map.__new__(Map)
        copied.map_id = self.map_id if map_id is None else map_id
        copied.view = self.view
        copied.noise = replace(self.noise)
        copied.n_keyframes, copied.n_points = self.n_keyframes, self.n_points
        copied._features = list(self._features)
        copied._parent = list(self._parent)
        copied.loop_edges = list(self.loop_edges)
        copied._T_cam_parent = {k: T.copy() for k, T in self._T_cam_parent.items()}
        copied.arrays = MapArrays(*(array.copy() for array in self.arrays))
        return copied

    def adopt(self, changed: "Map") -> None:
        """Take over the state of a changed copy, which must not be used afterwards."""
        self.n_keyframes, self.n_points = changed.n_keyframes, changed.n_points
        self._features, self._parent = changed._features, changed._parent
        self._T_cam_parent, self.loop_edges = changed._T_cam_parent, changed.loop_edges
        self.arrays = changed.arrays

    def absorb(self, other: "Map") -> tuple[int, int]:
        """Append all keyframes and points of another map, already in this map's frame.

        Args:
            other: left unchanged.

        Returns:
            Offsets to add to the other map's keyframe and point rows.
        """
        K, P, N = self.n_keyframes, self.n_points, int(self.arrays.kf_start[self.n_keyframes])
        k, p, n = other.n_keyframes, other.n_points, int(other.arrays.kf_start[other.n_keyframes])
        self._reserve(keyframes=K + k, points=P + p, keypoints=N + n)
        a, b = self.arrays, other.arrays
        for name, first, offset in _ROWS:
            start = {"kf": K, "kp": N, "pt": P}[first]
            rows = {"kf": k, "kp": n, "pt": p}[first]
            shift = {"kf": K, "kp": N, "pt": P, "": 0}[offset]
            values = getattr(b, name)[:rows]
            getattr(a, name)[start : start + rows] = (
                np.where(values >= 0, values + shift, values) if offset else values
            )
        a.kf_start[K : K + k + 1] = b.kf_start[: k + 1] + N
        a.covisibility[K : K + k, K : K + k] = b.covisibility[:k, :k]
        self._features += other._features
        self._parent += [q + K if q >= 0 else -1 for q in other._parent]
        self.loop_edges += [(i + K, j + K) for i, j in other.loop_edges]
        self._T_cam_parent |= {q + K: T.copy() for q, T in other._T_cam_parent.items()}
        self.n_keyframes += k
        self.n_points += p
        return K, P

    def set_parent(self, keyframe: int, parent: int) -> None:
        """Set the parent of a keyframe in the spanning tree."""
        self._parent[keyframe] = parent

    def _make_room(self, keypoints: int) -> None:
        """Remove the keypoints of culled keyframes if the arrays would otherwise have to grow."""
        a, used = self.arrays, int(self.arrays.kf_start[self.n_keyframes])
        short = used + keypoints > len(a.kp_octave)
        if short and culled_keypoints(a, self.n_keyframes) > _MIN_CULLED_SHARE * used:
            drop_culled_keypoints(a, self.n_keyframes, self.n_points)

    def _reserve(self, keyframes: int = 0, keypoints: int = 0, points: int = 0) -> None:
        a = self.arrays
        K, N, P = len(a.kf_bad), len(a.kp_octave), len(a.pt_bad)
        if keyframes <= K and keypoints <= N and points <= P:
            return
        bigger = _allocate(
            _capacity(K, keyframes), _capacity(N, keypoints), _capacity(P, points), a.kf_cells.shape[1]
        )
        for new, old in zip(bigger, a, strict=True):
            new[tuple(slice(0, s) for s in old.shape)] = old
        self.arrays = bigger


# array, kind of its rows, kind of rows that its values refer to
_ROWS = (
    ("kf_T_cam_map", "kf", ""),
    ("kf_bad", "kf", ""),
    ("kf_cells", "kf", ""),
    ("kp_xy", "kp", ""),
    ("kp_octave", "kp", ""),
    ("kp_angle", "kp", ""),
    ("kp_descriptor", "kp", ""),
    ("kp_keyframe", "kp", "kf"),
    ("kp_point", "kp", "pt"),
    ("kp_next", "kp", "kp"),
    ("pt_xyz", "pt", ""),
    ("pt_normal", "pt", ""),
    ("pt_descriptor", "pt", ""),
    ("pt_covariance", "pt", ""),
    ("pt_max_distance", "pt", ""),
    ("pt_bad", "pt", ""),
    ("pt_head", "pt", "kp"),
    ("pt_observations", "pt", ""),
    ("pt_reference", "pt", "kf"),
    ("pt_first_keyframe", "pt", "kf"),
    ("pt_visible", "pt", ""),
    ("pt_found", "pt", ""),
    ("pt_replaced", "pt", "pt"),
)


_ROW, _COLUMN = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])
"""Of the six entries of a symmetric matrix (3, 3)."""


def _transformed(covariance: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Covariances (n, 6) of points that are multiplied by a matrix (3, 3)."""
    full = np.empty((len(covariance), 3, 3))
    full[:, _ROW, _COLUMN] = full[:, _COLUMN, _ROW] = covariance
    return (factor @ full @ factor.T)[:, _ROW, _COLUMN]


def _capacity(have: int, need: int) -> int:
    return have if need <= have else max(need, 2 * have)


def _allocate(keyframes: int, keypoints: int, points: int, cells: int) -> MapArrays:
    return MapArrays(
        kf_T_cam_map=np.zeros((keyframes, 4, 4)),
        kf_start=np.zeros(keyframes + 1, np.int64),
        kf_bad=np.ones(keyframes, np.bool_),
        kf_cells=np.zeros((keyframes, cells), np.int32),
        covisibility=np.zeros((keyframes, keyframes), np.int32),
        kp_xy=np.zeros((keypoints, 2)),
        kp_octave=np.zeros(keypoints, np.int32),
        kp_angle=np.zeros(keypoints, np.float32),
        kp_descriptor=np.zeros((keypoints, 4), np.uint64),
        kp_keyframe=np.zeros(keypoints, np.int32),
        kp_point=np.full(keypoints, -1, np.int32),
        kp_next=np.full(keypoints, -1, np.int32),
        pt_xyz=np.zeros((points, 3)),
        pt_normal=np.zeros((points, 3)),
        pt_descriptor=np.zeros((points, 4), np.uint64),
        pt_covariance=np.zeros((points, 6)),
        pt_max_distance=np.zeros(points),
        pt_bad=np.ones(points, np.bool_),
        pt_head=np.full(points, -1, np.int32),
        pt_observations=np.zeros(points, np.int32),
        pt_reference=np.zeros(points, np.int32),
        pt_first_keyframe=np.zeros(points, np.int32),
        pt_visible=np.zeros(points, np.int32),
        pt_found=np.zeros(points, np.int32),
        pt_replaced=np.full(points, -1, np.int32),
    )
