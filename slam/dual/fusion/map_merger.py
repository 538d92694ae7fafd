"""Map merger: fuses maps that a recovery has aligned, or a place."""

from collections.abc import Sequence
from contextlib import AbstractContextManager

from slam.core import events as ev
from slam.core.frame import Frame
from slam.dual.fusion.fuse import Fused, FusionConfig, fuse, seam_frame
from slam.dual.fusion.merge_recovered import merge_recovered
from slam.dual.fusion.place_merging import PlaceMerger, inverted
from slam.dual.fusion.rebase import rebase_frames, rebase_tracking
from slam.engine import SlamEngine
from slam.loop_closing.map_alignment import Alignment
from slam.map.map import Map
from slam.map.relation import fusion_relation
from slam.map_store import Loss


class MapMerger:
    """Fuses maps; tracker, mapper, frame poses and the list of saved maps follow.

    Args:
        engine: of the maps.
        by_place: acceptance of a saved map that is recognised by its places; None for never.
    """

    def __init__(self, engine: SlamEngine, by_place: FusionConfig | None) -> None:
        self._engine = engine
        self._places = PlaceMerger(by_place, engine.seed) if by_place else None
        self._corrections = 0

    def merge_recovered(
        self,
        frame: Frame,
        new_id: int,
        keyframes: int,
        points: int,
        extended: Map,
        frames: Sequence[Frame],
        alignments: Sequence[Alignment],
    ) -> None:
        """Merge a recovery's extended copy into the new map, then fuse that with the old one.

        Args:
            frame: the newest frame.
            new_id: id of the new map.
            keyframes, points: rows of the new map when it was copied.
            extended: the copy, as extended backward; not to be used afterwards.
            frames: placed in it backward.
            alignments: with the old map, those that agree; the accepted one last.
        """
        engine, accepted = self._engine, alignments[-1]
        engine.backend.drain()
        old, new = engine.store[accepted.old_map_id], engine.store[new_id]
        merged = merge_recovered(new, extended, keyframes, points)
        if merged is None:
            self._refuse(frame, old.map_id, new.map_id, "recovery", accepted, "new_map_has_changed")
            return
        moved = [merged.moved(a, new) for a in alignments]
        seam = seam_frame(old, moved)
        fused = self._fuse(frame, old, new, moved, "recovery")
        rebase_frames(frames, merged.keyframes, fused, accepted.scale)
        for tracked in frames:
            if tracked.features.index > seam:
                engine.store.poses.add(old.map_id, tracked)

    def skip_present_keyframes(self) -> None:
        """Search no place of a keyframe that the current map has now."""
        if self._places is not None and self._engine.store.current_id in self._engine.store:
            self._places.skip(self._engine.store.current)

    def merge_by_place(self, frame: Frame) -> None:
        """Fuse the current map with a saved one that its newest keyframes recognise, if any."""
        engine, store = self._engine, self._engine.store
        if self._places is None or not store.saved:
            return
        if self._corrections != engine.corrections:
            self._corrections = engine.corrections
            self._places.reset_alignments()
        current, lock = store.current, engine.backend.lock
        alignments = self._recognise(self._places, frame, current, lock)
        if not alignments:
            return
        happened = len(engine.events)
        engine.backend.drain()
        if len(engine.events) != happened or current.arrays.kf_bad[alignments[-1].new_keyframe]:
            return  # the map has just changed: the alignments are no longer valid
        saved = store[alignments[-1].old_map_id]
        if saved.map_id < current.map_id:
            self._fuse(frame, saved, current, alignments, "place")
        else:
            self._fuse(frame, current, saved, [inverted(a, current.map_id) for a in alignments], "place")

    def _recognise(
        self, places: PlaceMerger, frame: Frame, current: Map, lock: AbstractContextManager
    ) -> Sequence[Alignment]:
        store = self._engine.store
        saved = [store[k] for k in store.saved]
        alignments = places.search(current, saved, lambda k: store.places(k).database, lock)
        for alignment, reason in places.refused:
            self._refuse(frame, alignment.old_map_id, current.map_id, "place", alignment, reason)
        return alignments

    def _fuse(self, frame: Frame, old: Map, new: Map, alignments: Sequence[Alignment], by: str) -> Fused:
        """Fuse the new map into the old one; all that refers to them follows."""
        engine, store = self._engine, self._engine.store
        accepted, renewed = alignments[-1], by == "recovery"
        relation = fusion_relation(
            old, new, accepted.old_keyframe, accepted.new_keyframe, accepted.S_old_new,
            seam_frame(old, alignments) if renewed else None,
        )  # fmt: skip
        fused = fuse(old, new, alignments, engine.config.mapping, renewed)
        store.poses.join(old.map_id, new.map_id, fused.keyframes, accepted.scale)
        store.poses.rescale(old.map_id, fused.factor)
        both = (old.map_id, new.map_id)
        if store.current_id in both:
            if store.current_id == new.map_id:
                store.current_id = old.map_id
                rebase_tracking(engine.tracker, engine.mapper, old, fused, accepted.scale)
            store.saved = [k for k in store.saved if k not in both]
            self.skip_present_keyframes()
        else:  # the result counts as saved when the younger of the two was
            place = min(map(store.saved.index, both))
            store.saved[place] = old.map_id
            store.saved = [k for i, k in enumerate(store.saved) if k not in both or i == place]
            last = max((store.loss(k).at for k in both), key=lambda at: at.index)
            store.note_loss(old.map_id, Loss(last, store.loss(old.map_id).doubt))
        store.forget(new.map_id)
        if self._places is not None:
            self._places.reset_alignments()
        engine.emit_at(
            frame, ev.Fusion, old.map_id, old_map_id=old.map_id, new_map_id=new.map_id, by=by,
            accepted=True, scale=accepted.scale, inliers=accepted.inliers, reason="", relation=relation,
        )  # fmt: skip
        return fused

    def _refuse(
        self, frame: Frame, old_id: int, new_id: int, by: str, alignment: Alignment, reason: str
    ) -> None:
        self._engine.emit_at(
            frame, ev.Fusion, new_id, old_map_id=old_id, new_map_id=new_id, by=by,
            accepted=False, scale=alignment.scale, inliers=alignment.inliers, reason=reason,
        )  # fmt: skip
