"""Fusion after a recovery: its extended copy is merged into the new map, and that is fused with the old one.

While the copy grew backward, tracking went on and the new map grew forward; the old map may have changed too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dslab.slam.core import events as ev
from dslab.slam.core.frame import Frame
from dslab.slam.dual.fusion.fuse import FusedMaps, seam_frame
from dslab.slam.dual.fusion.map_merger import STAGE, MapMerger, RowOffsets, rebase_frames
from dslab.slam.loop_closing.map_alignment import Alignment
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import horn_sim3, sim3_decompose, sim3_inverse, sim3_matrix
from dslab.slam.runtime.backend import MapChange

_MIN_SHARED = 20


@dataclass(frozen=True)
class Recovered:
    """Success of a recovery, on copies of the maps as they were when it started.

    Attributes:
        new_id: id of the new map.
        extended: its copy, as extended backward.
        keyframes, points: rows of the new map when it was copied.
        frames: placed backward in the copy.
        old_maps: copies of the saved maps.
        alignments: with one old map, those that agree; the accepted one last.
        since: index of the frame of the breakage.
    """

    new_id: int
    extended: Map
    keyframes: int
    points: int
    frames: Sequence[Frame]
    old_maps: Sequence[Map]
    alignments: Sequence[Alignment]
    since: int


class RecoveredFusion(MapChange):
    """Fusion of the maps that a recovery has aligned.

    If they can no longer be fused, event ``fusion`` says why. If the new map is gone, nothing happens.

    Args:
        merger: of the maps.
        found: by the recovery; its extended map is not to be used afterwards.
    """

    stage = STAGE

    def __init__(self, merger: MapMerger, found: Recovered) -> None:
        self._merger = merger
        self._found = found
        self._old_id = found.alignments[-1].old_map_id
        self._refusal = ""
        self._fusion: FusedMaps | None = None
        self._seam = -1  # frame at which the maps meet

    def prepare(self) -> bool:
        """Merge what was recovered into a copy of the new map, and fuse a copy of the old map with that."""
        found, engine = self._found, self._merger.engine
        if found.new_id not in engine.store:
            return False
        at = self._merger.find(self._old_id)
        then = next(m for m in found.old_maps if m.map_id == self._old_id)
        self._old_id = at.map_id
        self._refusal = "old_map_has_changed"
        if at.map_id not in engine.store:
            return True
        old, new = engine.store[at.map_id], engine.store[found.new_id].copy()
        alignments = [in_present_map(a, old, then, at) for a in found.alignments]
        if alignments[-1] is None:
            return True
        merged = merge_recovered(new, found.extended, found.keyframes, found.points)
        if merged is None:
            self._refusal = "new_map_has_changed"
            return True
        moved = [merged.moved(a, new) for a in alignments if a is not None]
        self._seam = seam_frame(old, moved)
        self._fusion = FusedMaps.of(old, new, moved, engine.config.mapping, found.since)
        fused = self._fusion.fused
        rebase_frames(found.frames, merged.keyframes + fused.keyframes, fused, moved[-1].scale)
        return True

    def is_still_valid(self) -> bool:
        """Return True if both maps are still there."""
        return self._fusion is None or self._merger.has_both(self._fusion)

    def commit(self) -> None:
        """Fuse the maps, or report why not; the recovered poses replace those of the breakage."""
        found, merger = self._found, self._merger
        if self._fusion is None:
            merger.refuse(self._old_id, found.new_id, "recovery", found.alignments[-1], self._refusal)
            return
        self._withdraw_passed_over()
        merger.commit(self._fusion, "recovery")
        for tracked in found.frames:
            if tracked.features.index > self._seam:
                merger.engine.store.poses.add(self._old_id, tracked)

    def _withdraw_passed_over(self) -> None:
        """Take back the old map's poses between seam and breakage: the breakage may have corrupted them.

        The frames that the recovery has placed get other poses; it has passed over the others.
        """
        engine, found = self._merger.engine, self._found
        old = engine.store[self._old_id]
        taken = engine.store.poses.take_back(self._old_id, self._seam + 1, found.since)
        placed = {tracked.features.index for tracked in found.frames}
        gone = [index for index in taken if index not in placed]
        if gone:
            engine.emit_now(
                ev.PosesWithdrawn, self._old_id,
                first_frame=gone[0], last_frame=gone[-1], frames=len(gone),
                keyframes=sum(old.frame_index(int(k)) in gone for k in old.keyframes()),
                reason="passed_over_by_recovery",
            )  # fmt: skip


@dataclass(frozen=True)
class MergedRecovery:
    """Position of the copy's rows in the map.

    Attributes:
        keyframes, points: offsets of its rows in the map.
        S_map_copy: (4, 4) similarity from the copy's frame to the map's.
    """

    keyframes: int
    points: int
    S_map_copy: np.ndarray

    def moved(self, alignment: Alignment, grown: Map) -> Alignment:
        """Convert an alignment of the copy with an old map to the map itself."""
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


def in_present_map(alignment: Alignment, old: Map, then: Map, at: RowOffsets) -> Alignment | None:
    """Convert an alignment with a copy of an old map to the map that holds its rows now.

    Args:
        alignment: with the copy.
        old: the map, which may have changed since.
        then: the copy, as it was when the recovery started.
        at: position of the copy's rows in the map.

    Returns:
        The alignment; None if its keyframe is no longer there, or too few points to tell how the map has
        moved.
    """
    old_keyframe = alignment.old_keyframe + at.keyframes
    if old.arrays.kf_bad[old_keyframe]:
        return None
    old_points = alignment.old_points + np.int32(at.points)
    kernels.resolve_points(old.arrays, old_points)
    known = old_points >= 0
    S_old_new = alignment.S_old_new
    own = slice(at.points, at.points + then.n_points)
    if not np.array_equal(old.arrays.pt_xyz[own], then.arrays.pt_xyz[: then.n_points]):
        S = _similarity(old, then, then.n_points, at.points)
        if S is None:
            return None
        S_old_new = S @ S_old_new
    return replace(
        alignment,
        old_map_id=old.map_id,
        old_keyframe=old_keyframe,
        S_old_new=S_old_new,
        scale=sim3_decompose(S_old_new)[0],
        old_points=old_points[known],
        new_points=alignment.new_points[known],
    )


def merge_recovered(grown: Map, copy: Map, keyframes: int, points: int) -> MergedRecovery | None:
    """Add the rows that a copy of this map has gained since it was made.

    Rows that existed when the copy was made keep the map's present values.

    Args:
        grown: the map; changed in place.
        copy: its extended copy; not to be used afterwards.
        keyframes, points: number of rows when the copy was made.

    Returns:
        Position of the copy's rows. The copied keyframes are culled and refer to their originals; the copied
        points are replaced by their originals. None, and nothing changed, if too few common points are left
        to estimate how the map has moved since the copy was made.
    """
    S = _similarity(grown, copy, points)
    if S is None:
        return None
    copy.transform(*sim3_decompose(S))
    K, P = grown.absorb(copy)
    _join_points(grown, P, points)
    for k in range(keyframes):
        copied = K + k
        if grown.arrays.kf_bad[copied]:  # culled in the copy: it already refers to another copied keyframe
            continue
        if not grown.arrays.kf_bad[k]:
            _move_observations(grown, copied, k)
        _release_observations(grown, copied)
        grown.set_parent(copied, grown.live(k))
        grown.cull_keyframe(copied)
    return MergedRecovery(K, P, S)


def _similarity(grown: Map, copy: Map, points: int, offset: int = 0) -> np.ndarray | None:
    """(4, 4) similarity from the copy's frame to the map's, by common points; None if underdetermined."""
    a, b = grown.arrays, copy.arrays
    both = np.flatnonzero(~a.pt_bad[offset : offset + points] & ~b.pt_bad[:points])
    if len(both) < _MIN_SHARED:
        return None
    xyz_a, xyz_b = a.pt_xyz[both + offset], b.pt_xyz[both]
    near = _near(xyz_a) & _near(xyz_b)
    xyz_a, xyz_b = xyz_a[near], xyz_b[near]
    try:
        for _ in range(2):  # drop the worst points twice: they are still being refined
            s, R, t = horn_sim3(xyz_a, xyz_b)
            error = np.linalg.norm(xyz_a - (s * xyz_b @ R.T + t), axis=1)
            keep = error <= np.quantile(error, 0.7)
            xyz_a, xyz_b = xyz_a[keep], xyz_b[keep]
        return sim3_matrix(*horn_sim3(xyz_a, xyz_b))
    except ValueError:  # collinear points
        return None


def _near(xyz: np.ndarray) -> np.ndarray:
    """Mask of the nearest 90 % of the points: far ones would outweigh all others."""
    distance = np.linalg.norm(xyz - np.median(xyz, axis=0), axis=1)
    return distance <= np.quantile(distance, 0.9)


def _join_points(grown: Map, offset: int, points: int) -> None:
    """Replace copied points by their originals."""
    originals = np.arange(points, dtype=np.int32)
    kernels.resolve_points(grown.arrays, originals)
    copies = np.arange(offset, offset + points, dtype=np.int32)
    kernels.replace_points(grown.arrays, copies, originals, grown.view)


def _move_observations(grown: Map, copied: int, original: int) -> None:
    """Give the original keyframe the observations that only its copy has made.

    If both observe a point in the same keypoint, the two points are joined.
    """
    kernels.take_over(grown.arrays, original, grown.observed_points(copied).copy(), grown.view)


def _release_observations(grown: Map, copied: int) -> None:
    """Erase a keyframe's observations; drop points left with a single observer.

    Culling would drop points left with two; here they are as good as before they were copied.
    """
    span = grown.keypoints(copied)
    kernels.erase_observations(grown.arrays, np.arange(span.start, span.stop, dtype=np.int32), 2)
