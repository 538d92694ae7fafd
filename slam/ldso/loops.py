"""Loops of direct sparse odometry: places recognised by corners, drift distributed by a pose graph.

A keyframe is compared with all before it when it leaves the window, where its pose and depths have become
final. The keyframes of the window are held and the past is moved to them: tracker, depth intervals,
first estimates and the marginalised prior all rest on their poses and scale, and nothing rests on the past.

Source: Gao, Wang, Demmel, Cremers, "LDSO: Direct Sparse Odometry with Loop Closure", 2018, Sec. III-C, III-D.
"""

from dataclasses import dataclass

import numpy as np

from slam.core.camera import PinholeCamera
from slam.core.geometry import ViewGeometry
from slam.core.relation import Relation
from slam.ldso.config import CornerConfig
from slam.ldso.corner_map import CornerMap
from slam.ldso.odometry import Odometry
from slam.loop_closing.correction import Loop, move_map
from slam.loop_closing.detection import LoopClosingConfig, LoopDetector, Refusal
from slam.loop_closing.judgement import judge
from slam.map.relation import loop_relation
from slam.optimization.pose_graph import optimize_pose_graph
from slam.optimization.sim3_algebra import invert_sim3
from slam.places.recognition import KeyframeDatabase


@dataclass(frozen=True)
class Closed:
    """A loop that was closed.

    Attributes:
        keyframe, loop_keyframe: frame indices of the two keyframes.
        scale: factor on lengths around the keyframe beside those around the loop keyframe.
        matches: points matched.
        relation: what was asserted, before anything was corrected.
    """

    keyframe: int
    loop_keyframe: int
    scale: float
    matches: int
    relation: Relation


@dataclass(frozen=True)
class Refused:
    """A loop that was verified and yet refused.

    Attributes:
        keyframe, loop_keyframe: frame indices of the two keyframes.
        matches: points matched.
        reason: what speaks against it.
    """

    keyframe: int
    loop_keyframe: int
    matches: int
    reason: str


class LoopCloser:
    """Closes the loops of one map.

    Args:
        odometry: of the map.
        map_id: id.
        view: of the corners.
        config: bar of loops, that of the base.
        corners: settings of corners.

    Attributes:
        corners: the map in which places are recognised.
    """

    def __init__(
        self,
        odometry: Odometry,
        map_id: int,
        view: ViewGeometry,
        config: LoopClosingConfig,
        corners: CornerConfig,
    ) -> None:
        self.corners = CornerMap(map_id, view, corners)
        self._odometry, self._config = odometry, config
        m = self.corners.map
        self._detector = LoopDetector(m, KeyframeDatabase(m), config)

    def see_through(self, camera: PinholeCamera) -> None:
        """Undistort the corners of the map with another residual of the lens."""
        m = self.corners.map
        for k in m.keyframes():
            m.take_features(k, m.features(k).seen_by(camera))

    def offer(self, row: int, rng: np.random.Generator) -> tuple[Closed | None, list[Refused]]:
        """Take a keyframe that has left the window, and close a loop with it if there is one.

        Args:
            row: of the keyframe in the odometry's list.
            rng: stream of the RANSAC.
        """
        odometry, m = self._odometry, self.corners.map
        k = self.corners.insert(row, odometry.keyframes[row], odometry.intrinsics[0])
        found, refused = self._detector.detect(k, rng)
        closed = None
        if found is not None:
            loop, _ = found
            relation = loop_relation(m, loop.keyframe, loop.loop_keyframe, loop.S_cam_map)
            outcome = self._close(loop)
            if isinstance(outcome, str):
                refused.append(self._detector.refused(loop, outcome))
            else:
                frames = m.frame_index(loop.keyframe), m.frame_index(loop.loop_keyframe)
                closed = Closed(*frames, outcome, len(loop.points), relation)
        return closed, [self._told(refusal) for refusal in refused]

    def _close(self, loop: Loop) -> float | str:
        """Distribute the drift of a loop, unless the map's own observations speak against it.

        Returns:
            Scale change of the keyframe beside the loop keyframe; or what speaks against it.
        """
        m, S = self.corners.map, self._distributed(loop)
        corrected = m.copy()
        factor = move_map(corrected, S[self.corners.rows])
        reason = judge(m, corrected, loop).fault(self._config.judgement, adjusted=False)
        if reason:
            return reason
        m.adopt(corrected)
        m.loop_edges.append((loop.keyframe, loop.loop_keyframe))
        self._odometry.move_keyframes(S)
        self._detector.closed(loop)
        return float(factor[loop.keyframe] / factor[loop.loop_keyframe])

    def _distributed(self, loop: Loop) -> np.ndarray:
        """(K, 4, 4) similarities of all keyframes that agree with a loop; those of the window are held."""
        odometry, rows = self._odometry, self.corners.rows
        T = np.array([keyframe.T_cam_map for keyframe in odometry.keyframes])
        held = np.zeros(len(T), bool)
        held[odometry.rows_of(odometry.window.slots)] = True
        earlier = [(rows[i], rows[j]) for i, j in self.corners.map.loop_edges]
        measured = loop.S_cam_map @ np.linalg.inv(T[rows[loop.loop_keyframe]])
        return distributed(T, earlier, (rows[loop.keyframe], rows[loop.loop_keyframe]), measured, held)

    def _told(self, refusal: Refusal) -> Refused:
        m = self.corners.map
        frames = m.frame_index(refusal.keyframe), m.frame_index(refusal.loop_keyframe)
        return Refused(*frames, refusal.matches, refusal.reason)


def distributed(
    T_cam_map: np.ndarray,
    earlier: list[tuple[int, int]],
    loop: tuple[int, int],
    measured: np.ndarray,
    held: np.ndarray,
) -> np.ndarray:
    """Pose graph of keyframes, each bound to the next one in time as it lies to it, and of loops.

    Only neighbours in time are bound: drift arises between them, and equal edges distribute it evenly.

    Args:
        T_cam_map: (K, 4, 4) poses in order of time.
        earlier: pairs of keyframes of loops closed before.
        loop: the new pair i, j.
        measured: (4, 4) similarity ``S_i S_j^-1`` of it.
        held: (K,) bool, keyframes that do not move.

    Returns:
        (K, 4, 4) similarities.
    """
    old = [(k + 1, k) for k in range(len(T_cam_map) - 1)] + [pair for pair in earlier if pair != loop]
    pairs = np.array([*old, loop], int)
    i, j = pairs[:-1].T
    relative = T_cam_map[i] @ invert_sim3(T_cam_map[j])
    return optimize_pose_graph(
        T_cam_map, pairs, np.concatenate([relative, measured[None]]), held
    ).S_cam_map  # fmt: skip
