"""What a recovery has added to its copy of the new map, taken over by the map itself.

Tracking has gone on meanwhile: the new map has grown forward while its copy grew backward.
"""

from dataclasses import dataclass, replace

import numpy as np

from slam.loop_closing.map_alignment import Alignment
from slam.map import _map_kernels as kernels
from slam.map.map import Map
from slam.optimization.sim3 import horn_sim3, sim3_decompose, sim3_inverse, sim3_matrix

_MIN_SHARED = 20


@dataclass(frozen=True)
class MergedRecovery:
    """Where the copy has gone.

    Attributes:
        keyframes, points: offsets of its rows in the map.
        S_map_copy: (4, 4) similarity from the copy's frame to the map's.
    """

    keyframes: int
    points: int
    S_map_copy: np.ndarray

    def moved(self, alignment: Alignment, grown: Map) -> Alignment:
        """An alignment of the copy with an old map, as one of the map itself."""
        new_points = alignment.new_points + np.int32(self.points)
        kernels.resolve_points(grown.arrays, new_points)
        known = new_points >= 0
        S_old_new = alignment.S_old_new @ sim3_inverse(self.S_map_copy)
        return replace(
            alignment,
            S_old_new=S_old_new,
            scale=sim3_decompose(S_old_new)[0],
            new_keyframe=alignment.new_keyframe + self.keyframes,
            old_points=alignment.old_points[known],
            new_points=new_points[known],
        )


def merge_recovered(grown: Map, copy: Map, keyframes: int, points: int) -> MergedRecovery | None:
    """Take over the rows that a copy of this map has gained since it was made.

    The rows that both had then are one again, as this map has them now.

    Args:
        grown: the map; changed in place.
        copy: its copy, extended; spent.
        keyframes, points: rows that both had when the copy was made.

    Returns:
        Where the copy's rows are; its old keyframes are culled there and follow their originals, its old
        points are replaced by their originals. None, and nothing done, where the two have too few points
        left in common to tell how the map has moved meanwhile.
    """
    S = _similarity(grown, copy, points)
    if S is None:
        return None
    copy.transform(*sim3_decompose(S))
    K, P = grown.absorb(copy)
    _join_points(grown, P, points)
    for k in range(keyframes):
        twin = K + k
        if grown.arrays.kf_bad[twin]:  # the copy has culled it: it follows another twin, and goes on doing so
            continue
        if not grown.arrays.kf_bad[k]:
            _hand_over(grown, twin, k)
        _let_go(grown, twin)
        grown.set_parent(twin, grown.live(k))
        grown.cull_keyframe(twin)
    return MergedRecovery(K, P, S)


def _similarity(grown: Map, copy: Map, points: int) -> np.ndarray | None:
    """(4, 4) from the copy's frame to the map's, by points that both have; None if they do not tell."""
    a, b = grown.arrays, copy.arrays
    both = np.flatnonzero(~a.pt_bad[:points] & ~b.pt_bad[:points])
    if len(both) < _MIN_SHARED:
        return None
    near = both[_near(a.pt_xyz[both]) & _near(b.pt_xyz[both])]
    xyz_a, xyz_b = a.pt_xyz[near], b.pt_xyz[near]
    try:
        for _ in range(2):  # the worst of them twice left out: points just being refined
            s, R, t = horn_sim3(xyz_a, xyz_b)
            error = np.linalg.norm(xyz_a - (s * xyz_b @ R.T + t), axis=1)
            keep = error <= np.quantile(error, 0.7)
            xyz_a, xyz_b = xyz_a[keep], xyz_b[keep]
        return sim3_matrix(*horn_sim3(xyz_a, xyz_b))
    except ValueError:  # on a line
        return None


def _near(xyz: np.ndarray) -> np.ndarray:
    """Which points are not among the tenth farthest off: one as good as at infinity outweighs all others."""
    distance = np.linalg.norm(xyz - np.median(xyz, axis=0), axis=1)
    return distance <= np.quantile(distance, 0.9)


def _join_points(grown: Map, offset: int, points: int) -> None:
    """The copies of points become the points that they were copied from."""
    originals = np.arange(points, dtype=np.int32)
    kernels.resolve_points(grown.arrays, originals)
    copies = np.arange(offset, offset + points, dtype=np.int32)
    kernels.replace_points(grown.arrays, copies, originals, grown.view.scale)


def _hand_over(grown: Map, twin: int, original: int) -> None:
    """The original observes what only its copy has found out to observe.

    Where each has found a point of its own in the same keypoint, the two are one.
    """
    kernels.take_over(grown.arrays, original, grown.observed_points(twin).copy(), grown.view.scale)


def _let_go(grown: Map, twin: int) -> None:
    """Undo what a keyframe observes; a point that is left to a single observer goes.

    Culling would drop points left with two: here these are as good as they were before they were copied.
    """
    span = grown.keypoints(twin)
    kernels.erase_observations(grown.arrays, np.arange(span.start, span.stop), 2)
