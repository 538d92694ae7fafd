"""Map of the corners of keyframes that have left the window, in which places are recognised.

It is a map as the base has, of descriptors, points and observations, so that recognition, similarity and
evidence are the base's own. A corner has a depth if its point had one when it left the window. The points of
the keyframes about are looked for in each new one: what is found makes keyframes covisible, and how often it
is found says what to expect of a view.
"""

import numpy as np
from scipy.spatial import cKDTree

from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import ViewGeometry
from dslab.slam.ldso._corner_kernels import find_points
from dslab.slam.ldso.config import CornerConfig
from dslab.slam.ldso.window import Keyframe
from dslab.slam.map.map import Map

_SAME_PX = 0.1


class CornerMap:
    """The map and which keyframe is which.

    Args:
        map_id: id.
        view: of the corners.
        config: settings.

    Attributes:
        map: the map.
        rows: row of each of its keyframes in the odometry's list.
    """

    def __init__(self, map_id: int, view: ViewGeometry, config: CornerConfig) -> None:
        self.map = Map(map_id, view)
        self.rows: list[int] = []
        self._config = config

    def insert(self, row: int, keyframe: Keyframe, intrinsics: np.ndarray) -> int:
        """Insert a keyframe whose pose and depths are final; its row in the map.

        Args:
            row: in the odometry's list.
            keyframe: with corners.
            intrinsics: (4,) of the ideal camera.
        """
        if keyframe.corners is None:
            raise ValueError("the keyframe has no corners")
        m, frame = self.map, Frame(keyframe.corners)
        frame.T_cam_map = keyframe.T_cam_map.copy()
        inverse_depth = depths_of(keyframe)
        self._find_points(frame, inverse_depth)
        k = m.add_keyframe(frame, self._parent(frame))
        self.rows.append(row)
        new = np.flatnonzero((frame.point < 0) & np.isfinite(inverse_depth))
        fx, fy, cx, cy = intrinsics
        rays = np.column_stack([(frame.features.xy[new] - [cx, cy]) / [fx, fy], np.ones(len(new))])
        xyz = (rays / inverse_depth[new, None] - frame.T_cam_map[:3, 3]) @ frame.T_cam_map[:3, :3]
        start = m.keypoints(k).start
        for at, keypoint in zip(xyz, new, strict=True):
            m.create_point(at, int(start + keypoint))
        return k

    def _find_points(self, frame: Frame, inverse_depth: np.ndarray) -> None:
        """Match corners with points of the keyframes nearest in time; depths (n,) must not disagree."""
        m, config, features = self.map, self._config, frame.features
        points = self._points_about(features.index)
        found, at, depth, keypoint = find_points(
            m.arrays, m.view, frame.T_cam_map, points, features.xy, features.octave, features.descriptors,
            features.cell_start, config.radius_px,
        )  # fmt: skip
        hit = keypoint >= 0
        hit[hit] = ~(np.abs(depth[hit] * inverse_depth[keypoint[hit]] - 1) > config.agreeing)  # NaN agrees
        m.arrays.pt_visible[found] += 1
        m.arrays.pt_found[found[hit]] += 1
        found, at, keypoint = found[hit], at[hit], keypoint[hit]
        distance = np.linalg.norm(features.xy[keypoint] - at, axis=1)
        order = np.lexsort((found, distance, keypoint))
        _, nearest = np.unique(keypoint[order], return_index=True)
        frame.point[keypoint[order[nearest]]] = found[order[nearest]]

    def _points_about(self, frame: int) -> np.ndarray:
        """(Q,) int32 points of the keyframes nearest to a frame in time."""
        m = self.map
        away = np.array([abs(m.frame_index(k) - frame) for k in range(m.n_keyframes)])
        about = np.argsort(away, kind="stable")[: self._config.around]
        points = [m.observed_points(int(k)) for k in about]
        points = np.unique(np.concatenate(points)) if points else np.empty(0, np.int32)
        return points[points >= 0].astype(np.int32)

    def _parent(self, frame: Frame) -> int:
        """The keyframe that shares most points, or else the last one; -1 for the first."""
        m = self.map
        points = frame.point[frame.point >= 0]
        shared = [int(np.isin(points, m.observed_points(k)).sum()) for k in range(m.n_keyframes)]
        if not shared:
            return -1
        return int(np.argmax(shared)) if max(shared) else m.n_keyframes - 1


def depths_of(keyframe: Keyframe) -> np.ndarray:
    """(n,) inverse depths of a keyframe's corners; NaN where its point has none."""
    if keyframe.corners is None:
        return np.empty(0)
    if not len(keyframe.uv):
        return np.full(len(keyframe.corners.xy), np.nan)
    # Where the lens was found to be another one, both have been moved from whole pixels.
    away, row = cKDTree(keyframe.uv).query(keyframe.corners.xy)
    return np.where(away < _SAME_PX, keyframe.inverse_depth[row], np.nan)
