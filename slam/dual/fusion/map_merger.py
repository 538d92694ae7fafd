"""Map merger: puts a fused map in the place of two, between two frames.

No keyframe or point was added since the maps were copied (``Backend.beside``). What tracking has done since
is carried over: the poses of its frames, and those that wait to become keyframes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dslab.slam.core import events as ev
from dslab.slam.core.frame import Frame
from dslab.slam.core.relation import Relation
from dslab.slam.dual.fusion.fuse import Fused, FusedMaps
from dslab.slam.engine import SlamEngine
from dslab.slam.loop_closing.map_alignment import Alignment
from dslab.slam.map._map_kernels import resolve_points
from dslab.slam.map.map import Map
from dslab.slam.map_store import Loss

STAGE = "fusion"
"""Stage of a frame in which the tracking thread commits a fusion."""


@dataclass(frozen=True)
class RowOffsets:
    """Position of a map's rows in the map that has absorbed it, or in itself.

    Attributes:
        map_id: the map that holds them.
        keyframes, points: number of rows before them.
    """

    map_id: int
    keyframes: int = 0
    points: int = 0


class MapMerger:
    """Commits fusions; tracker, mapper, frame poses and the list of saved maps follow.

    Args:
        engine: of the maps.
        on_fusion: called after every fusion with the map that is left.
    """

    def __init__(self, engine: SlamEngine, on_fusion: Callable[[Map], None]) -> None:
        self.engine = engine
        self._on_fusion = on_fusion
        self._absorbed: dict[int, RowOffsets] = {}

    def find(self, map_id: int) -> RowOffsets:
        """Position of a map's rows, also if others have absorbed it."""
        at = RowOffsets(map_id)
        while at.map_id in self._absorbed:
            by = self._absorbed[at.map_id]
            at = RowOffsets(by.map_id, at.keyframes + by.keyframes, at.points + by.points)
        return at

    def has_both(self, fusion: FusedMaps) -> bool:
        """Return True if both maps of a fusion are still there."""
        return fusion.old_id in self.engine.store and fusion.new_id in self.engine.store

    def commit(self, fusion: FusedMaps, by: str) -> None:
        """Put the fused map in the place of the two; all that refers to them follows."""
        store, old, new_id = self.engine.store, self.engine.store[fusion.old_id], fusion.new_id
        fused, accepted = fusion.fused, fusion.accepted
        old.adopt(fusion.map)
        store.poses.join(old.map_id, new_id, fused.keyframes, accepted.scale)
        store.poses.rescale(old.map_id, fused.factor)
        store.places(old.map_id).database.foresee(fusion.bows)
        both = (old.map_id, new_id)
        if store.current_id in both:
            if store.current_id == new_id:
                store.current_id = old.map_id
                self._rebase(old, fusion)
            store.saved = [k for k in store.saved if k not in both]
        else:  # the result counts as saved when the younger of the two was
            place = min(map(store.saved.index, both))
            store.saved[place] = old.map_id
            store.saved = [k for i, k in enumerate(store.saved) if k not in both or i == place]
            last = max((store.loss(k).at for k in both), key=lambda at: at.index)
            store.note_loss(old.map_id, Loss(last, store.loss(old.map_id).doubt))
        store.forget(new_id)
        self._absorbed[new_id] = RowOffsets(old.map_id, fused.keyframes, fused.points)
        self._emit(old.map_id, old.map_id, new_id, by, accepted, "", fusion.relation)
        self._on_fusion(old)

    def refuse(self, old_id: int, new_id: int, by: str, alignment: Alignment, reason: str) -> None:
        """Report that two maps that were aligned are not fused."""
        self._emit(new_id, old_id, new_id, by, alignment, reason)

    def _rebase(self, old: Map, fusion: FusedMaps) -> None:
        """Move tracking and mapping to the old map, with the keyframes in work."""
        engine, fused = self.engine, fusion.fused
        tasks = [task for task in engine.backend.in_work if task.mapper is engine.mapper]
        last, scale = engine.tracker.last, fusion.accepted.scale
        if last is None:
            raise RuntimeError("the tracker has not been started")
        if engine.tracker.velocity is not None:
            engine.tracker.velocity = engine.tracker.velocity.copy()
            engine.tracker.velocity[:3, 3] *= scale * fused.factor[last.reference_keyframe + fused.keyframes]
        waiting = [task.frame for task in tasks if task.keyframe < 0 and task.frame is not last]
        rebase_frames([last, *waiting], fused.keyframes, fused, scale)
        for frame in (last, *waiting):
            frame.T_cam_map = frame.T_cam_reference @ old.T_cam_map(frame.reference_keyframe)
            frame.point[frame.point >= 0] += fused.points
            resolve_points(old.arrays, frame.point)
        engine.tracker.rebase(old, last)
        engine.mapper.rebase(old)
        engine.second_motion = None  # the start is the old map's
        for task in tasks:
            task.rebase(engine.store.places(old.map_id).loops, fused.keyframes)

    def _emit(
        self,
        map_id: int,
        old_id: int,
        new_id: int,
        by: str,
        alignment: Alignment,
        reason: str,
        relation: Relation | None = None,
    ) -> None:
        self.engine.emit_now(
            ev.Fusion, map_id, old_map_id=old_id, new_map_id=new_id, by=by,
            accepted=not reason, scale=alignment.scale, inliers=alignment.inliers, reason=reason,
            relation=relation, believed=alignment.believed,
        )  # fmt: skip


def rebase_frames(frames: Sequence[Frame], keyframes: int, fused: Fused, scale: float) -> None:
    """Refer tracked frames to the fused map.

    Args:
        frames: changed in place, their poses in the map and their points not updated.
        keyframes: offset of their reference keyframes' rows in the fused map.
        fused: position of the new map's rows.
        scale: factor from their lengths to the old map's.
    """
    for frame in frames:
        row = frame.reference_keyframe + keyframes
        frame.reference_keyframe = row
        frame.T_cam_reference = frame.T_cam_reference.copy()
        frame.T_cam_reference[:3, 3] *= scale * fused.factor[row]
