"""Loops of direct sparse odometry: places recognised by corners, drift distributed by a pose graph.

A keyframe is compared with all before it when it leaves the window, where its pose and depths have become
final. The keyframes of the window are held and the past is moved to them: tracker, depth intervals,
first estimates and the marginalised prior all rest on their poses and scale, and nothing rests on the past.
So the window's frame is that of odometry alone, and each correction is found anew from what odometry and all
loops said.

Source: Gao, Wang, Demmel, Cremers, "LDSO: Direct Sparse Odometry with Loop Closure", 2018, Sec. III-C, III-D.
"""

from dataclasses import dataclass

import numpy as np

from dslab.slam.config import SlamConfig
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.geometry import ViewGeometry
from dslab.slam.core.relation import Relation
from dslab.slam.ldso.config import CornerConfig
from dslab.slam.ldso.corner_map import CornerMap
from dslab.slam.ldso.odometry import Odometry
from dslab.slam.loop_closing.correction import Loop, move_map
from dslab.slam.loop_closing.detection import LoopDetector, Refusal
from dslab.slam.map.relation import loop_relation
from dslab.slam.optimization.pose_graph import optimize_pose_graph
from dslab.slam.optimization.sim3_algebra import invert_sim3
from dslab.slam.places.recognition import KeyframeDatabase


@dataclass(frozen=True)
class Closed:
    """A loop that was closed.

    Attributes:
        keyframe, loop_keyframe: frame indices of the two keyframes.
        scale: factor on lengths around the keyframe beside those around the loop keyframe.
        matches: points matched.
        relation: what was asserted, before anything was corrected.
        believed: chance that it is right, if it was asked.
    """

    keyframe: int
    loop_keyframe: int
    scale: float
    matches: int
    relation: Relation
    believed: float | None


@dataclass(frozen=True)
class Refused:
    """A loop that was verified and yet refused.

    Attributes:
        keyframe, loop_keyframe: frame indices of the two keyframes.
        matches: points matched.
        reason: what speaks against it.
        believed: chance that it is right, if it was asked.
    """

    keyframe: int
    loop_keyframe: int
    matches: int
    reason: str
    believed: float | None


class LoopCloser:
    """Closes the loops of one map.

    Args:
        odometry: of the map.
        map_id: id.
        view: of the corners.
        config: settings of the base, of which those of loops and places are used.
        corners: settings of corners.

    Attributes:
        corners: the map in which places are recognised.
    """

    def __init__(
        self,
        odometry: Odometry,
        map_id: int,
        view: ViewGeometry,
        config: SlamConfig,
        corners: CornerConfig,
    ) -> None:
        self.corners = CornerMap(map_id, view, corners)
        self._odometry, self._config = odometry, config
        # Of each keyframe that a loop has moved: its pose by odometry alone; lengths around it beside those.
        self._T_odometry: dict[int, np.ndarray] = {}
        self._factor: dict[int, float] = {}
        self._loops: list[tuple[int, int, np.ndarray]] = []
        m = self.corners.map
        self._detector = LoopDetector(m, KeyframeDatabase(m), config.loops, config.belief)
        self._scale_weight = corners.scale_weight

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
                closed = Closed(*frames, outcome, len(loop.points), relation, loop.believed)
        return closed, [self._told(refusal) for refusal in refused]

    def _close(self, loop: Loop) -> float | str:
        """Distribute the drift of a loop, unless the map's own observations speak against it.

        Returns:
            Scale change of the keyframe beside the loop keyframe; or what speaks against it.
        """
        m, rows, odometry = self.corners.map, self.corners.rows, self._odometry
        i, j = rows[loop.keyframe], rows[loop.loop_keyframe]
        T = np.array([keyframe.T_cam_map for keyframe in odometry.keyframes])
        held = np.zeros(len(T), bool)
        held[odometry.rows_of(odometry.window.slots)] = True
        T_odometry, factor = T.copy(), np.ones(len(T))
        for row, pose in self._T_odometry.items():
            T_odometry[row], factor[row] = pose, self._factor[row]
        measured = loop.S_cam_map @ np.linalg.inv(T[j])
        measured[:3, 3] /= factor[i]
        measured[:3, :3] *= factor[j] / factor[i]
        loops = [*self._loops, (i, j, measured)]
        S = scaled(distributed(scaled(T, 1 / factor), T_odometry, loops, held, self._scale_weight), factor)
        corrected = m.copy()
        change = move_map(corrected, S[rows])
        if not self._detector.is_believed(loop, m, corrected):
            return "map_is_torn"
        m.adopt(corrected)
        m.loop_edges.append((loop.keyframe, loop.loop_keyframe))
        factor *= odometry.move_keyframes(S)
        for row in np.flatnonzero(~held):
            self._T_odometry.setdefault(int(row), T[row])
            self._factor[int(row)] = float(factor[row])
        self._loops = loops
        self._detector.closed(loop)
        return float(change[loop.keyframe] / change[loop.loop_keyframe])

    def _told(self, refusal: Refusal) -> Refused:
        m = self.corners.map
        frames = m.frame_index(refusal.keyframe), m.frame_index(refusal.loop_keyframe)
        return Refused(*frames, refusal.matches, refusal.reason, refusal.believed)


def scaled(S: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """(K, 4, 4) similarities after which lengths are (K,) times as long."""
    longer = S.copy()
    longer[:, :3] *= factor[:, None, None]
    return longer


def distributed(
    S_cam_map: np.ndarray,
    T_odometry: np.ndarray,
    loops: list[tuple[int, int, np.ndarray]],
    held: np.ndarray,
    scale_weight: float = 1.0,
) -> np.ndarray:
    """Pose graph of keyframes, each bound to the next one in time as odometry has it, and of all loops.

    Nothing of an earlier result is taken for an observation, so that loops of one place are averaged: the
    result does not depend on their order.

    Args:
        S_cam_map: (K, 4, 4) start, in lengths of the odometry.
        T_odometry: (K, 4, 4) poses by odometry alone, in order of time.
        loops: pairs of keyframes i, j and the (4, 4) similarity ``S_i S_j^-1`` of each as measured.
        held: (K,) bool, keyframes that do not move.
        scale_weight: of the loops' scales.

    Returns:
        (K, 4, 4) similarities.
    """
    next_ = np.arange(1, len(S_cam_map))
    pairs = np.concatenate([np.column_stack([next_, next_ - 1]), [pair for *pair, _ in loops]])
    relative = T_odometry[1:] @ invert_sim3(T_odometry[:-1])
    measured = np.concatenate([relative, [measured for *_, measured in loops]])
    weight = np.ones((len(pairs), 7))
    weight[len(next_) :, 6] = scale_weight
    return optimize_pose_graph(S_cam_map, pairs, measured, held, weight=weight).S_cam_map
