"""A supposed similarity between two maps, or two ends of one, and what is believed of it."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from dslab.slam.belief.belief import Belief
from dslab.slam.belief.config import BeliefConfig
from dslab.slam.belief.log import note
from dslab.slam.belief.model import Unseen, come
from dslab.slam.belief.sight import rigid_of, settled, sight_of
from dslab.slam.core.geometry import camera_centre
from dslab.slam.core.results import MapTrajectory
from dslab.slam.loop_closing.map_alignment import Agreement, Alignment, agree
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.map.trajectory import keyframe_trajectory
from dslab.slam.optimization.sim3 import sim3_decompose, sim3_inverse
from dslab.slam.tracking.reach import Reach

_SAME_WAY_DEG = 45.0
_NONE = np.empty(0, np.int32)
_APART = Agreement(max_scale_change=0.2, max_rotation_deg=10.0, max_shift=0.3)
"""Beyond it two similarities are two places."""


class Supposed:
    """Where one map, or the end of one, is supposed to lie in another.

    The keyframes that proposed it are no evidence; those around them are, on both sides of a loop, and those
    that follow.

    Args:
        old, new: the maps; one and the same for a loop.
        found: the alignment that supposes it first.
        config: of beliefs.

    Attributes:
        old: the map.
        alignments: those that gave this similarity, the newest last.
        belief: what the views say.
        believed: chance that it is right, when it was last asked.
    """

    def __init__(self, old: Map, new: Map, found: Alignment, config: BeliefConfig) -> None:
        self.old, self.alignments, self._config = old, [found], config
        self._kind = "loop" if old is new else "join"
        self._first = new.frame_index(found.new_keyframe), old.frame_index(found.old_keyframe)
        self._unseen = _unseen(old, new, found)
        self._asked = {found.new_keyframe, found.old_keyframe} if old is new else {found.new_keyframe}
        self.belief = Belief(self._kind, self._unseen)
        self.believed = self.belief.chance()
        there = _side(old, found.old_keyframe, config.around)
        here = [k for k in _side(new, found.new_keyframe, config.around) if old is not new or k not in there]
        for keyframe in here[: config.views]:
            self.look(new, keyframe)
        if old is new:
            for keyframe in there[: config.views]:
                self._look(keyframe, new, found.S_old_new, here)

    @property
    def newest(self) -> Alignment:
        """Its last alignment."""
        return self.alignments[-1]

    def is_that_of(self, alignment: Alignment, bounds: Agreement) -> bool:
        """Return True if an alignment gives the same similarity."""
        same_map = self.newest.old_map_id == alignment.old_map_id
        return same_map and agree(self.old, self.newest, alignment, bounds)

    def look(self, new: Map, keyframe: int) -> None:
        """Ask the view of a keyframe of the new map, if it was not asked before."""
        S_new_old, there = sim3_inverse(self.newest.S_old_new), self.newest.old_keyframe
        if self.old is not new:
            there = _nearest(self.old, new.T_cam_map(keyframe) @ S_new_old)
        if there >= 0 and not new.arrays.kf_bad[keyframe]:
            side = [
                k for k in _side(self.old, there, self._config.around) if self.old is not new or k != keyframe
            ]
            self._look(keyframe, new, S_new_old, side)

    def is_believed(self, others: Iterable["Supposed"] = (), hoping: bool = False) -> bool:
        """Return True if the chance that the place is another one is small enough, others considered.

        Args:
            others: of which those that exclude it are rivals.
            hoping: that the map fits, as far as it was not asked.
        """
        rivals = [other.belief.log_odds for other in others if other is not self and _exclude(self, other)]
        self.believed = self.belief.chance(rivals)
        return self.belief.is_beyond(self._config.alpha, rivals, hoping)

    def tear(self, new: Map, share: float) -> None:
        """Take in which share of the map's observations the loop's correction tears."""
        self.belief.tear(share)
        newest = self.newest
        supposed = self.old.map_id, *self._first
        note(
            self._kind, supposed, self.old, newest.old_keyframe,
            new.T_cam_map(newest.new_keyframe) @ sim3_inverse(newest.S_old_new),
            new.features(newest.new_keyframe), _NONE, self.belief.log_odds, lambda: self._unseen, torn=share,
        )  # fmt: skip

    def _look(self, keyframe: int, new: Map, S_here_there: np.ndarray, there_side: list[int]) -> None:
        """Ask a keyframe for the points of the keyframes there; of joins these are of the old map."""
        if keyframe in self._asked or not there_side:
            return
        self._asked.add(keyframe)
        there = self.old
        points = np.unique(np.concatenate([there.observed_points(k) for k in there_side]))
        points = points[points >= 0].astype(np.int32)
        S_cam_there, features = new.T_cam_map(keyframe) @ S_here_there, new.features(keyframe)
        moved, depth = self._moved(new, keyframe), kernels.median_depth(there.arrays, there_side[0])
        T_cam_there = settled(there, points, rigid_of(S_cam_there), features, depth, moved)
        self.belief.add(sight_of(there, points, T_cam_there, features, depth))
        supposed = there.map_id, *self._first
        note(
            self._kind, supposed, there, there_side[0], S_cam_there, features, points,
            self.belief.log_odds, lambda: self._unseen, moved,
        )  # fmt: skip

    def _moved(self, new: Map, keyframe: int) -> float:
        """How far a keyframe is from the one that was aligned, lengths of the old map."""
        if self.old is new:
            return 0.0
        one, other = (camera_centre(new.T_cam_map(k)) for k in (keyframe, self.newest.new_keyframe))
        return sim3_decompose(self.newest.S_old_new)[0] * float(np.linalg.norm(one - other))


def suppose(
    known: list[Supposed], old: Map, new: Map, found: Alignment, bounds: Agreement, config: BeliefConfig
) -> Supposed:
    """Take an alignment as a further one of what was supposed before, or else for itself."""
    for supposed in known:
        if supposed.is_that_of(found, bounds):
            supposed.alignments.append(found)
            return supposed
    known.append(Supposed(old, new, found, config))
    return known[-1]


def _exclude(one: Supposed, other: Supposed) -> bool:
    """Return True if at most one of two can hold.

    Two places of one map are two. Those of two maps may be one; then they tell how these lie to each other,
    and the camera must have been able to come from one to the other.
    """
    if one.old is other.old:
        return not agree(one.old, one.newest, other.newest, _APART)
    older, younger = sorted((one, other), key=lambda each: each.old.map_id)
    S = np.ascontiguousarray(older.newest.S_old_new @ sim3_inverse(younger.newest.S_old_new))
    between = replace(older.newest, S_old_new=S)
    return come(_unseen(older.old, younger.old, between)) < 0


def _unseen(old: Map, new: Map, found: Alignment) -> Unseen:
    """The motion that an alignment supposes: between two maps, or within one."""
    depth = kernels.median_depth(old.arrays, found.old_keyframe) or np.nan
    before, after = keyframe_trajectory(old), keyframe_trajectory(new)
    if old is new:
        ends_s = [m.features(k).stamp_s for m, k in ((old, found.old_keyframe), (new, found.new_keyframe))]
        between = after.T_map_cam[(after.stamps_s >= min(ends_s)) & (after.stamps_s <= max(ends_s)), :3, 3]
        gone = float(np.linalg.norm(np.diff(between, axis=0), axis=1).sum())
        centre = camera_centre(new.T_cam_map(found.new_keyframe))
        moved = found.S_old_new[:3, :3] @ centre + found.S_old_new[:3, 3]
        return Unseen(ends_s[1] - ends_s[0], gone / depth, float(np.linalg.norm(moved - centre)) / depth)
    after = replace(after, T_map_cam=found.S_old_new @ after.T_map_cam)
    gap_s, i, j = _gap(before, after)
    speeds = [reach.speed for reach in map(Reach.of, (before, after)) if reach is not None]
    if not speeds:
        return Unseen(gap_s)
    start = Reach(before.T_map_cam[i, :3, 3], float(before.stamps_s[i]), max(speeds))
    return start.unseen(after.T_map_cam[j, :3, 3], float(after.stamps_s[j]), depth)


def _gap(one: MapTrajectory, other: MapTrajectory) -> tuple[float, int, int]:
    """Least time between two paths, s, and the index in either where it is."""
    gap_s = np.abs(one.stamps_s[:, None] - other.stamps_s[None])
    i, j = np.unravel_index(np.argmin(gap_s), gap_s.shape)
    return float(gap_s[i, j]), int(i), int(j)


def _side(map_: Map, keyframe: int, around: int) -> list[int]:
    """The keyframe, then its most covisible ones."""
    return [keyframe, *(int(k) for k in map_.neighbours(keyframe, around))]


def _nearest(map_: Map, S_cam_map: np.ndarray) -> int:
    """The keyframe nearest to a camera of those that look its way; -1 for none."""
    rows = map_.keyframes()
    _, R, _ = sim3_decompose(S_cam_map)
    T = map_.arrays.kf_T_cam_map[rows]
    facing = T[:, 2, :3] @ R[2] > np.cos(np.deg2rad(_SAME_WAY_DEG))
    if not facing.any():
        return -1
    centre = -np.linalg.inv(S_cam_map[:3, :3]) @ S_cam_map[:3, 3]
    centres = -np.einsum("nji,nj->ni", T[:, :3, :3], T[:, :3, 3])
    away = np.linalg.norm(centres - centre, axis=1)
    return int(rows[facing][np.argmin(away[facing])])
