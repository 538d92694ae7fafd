"""Map merger: fuses maps that a recovery has aligned, or a place."""

from collections.abc import Sequence
from contextlib import AbstractContextManager

from slam.core import events as ev
from slam.core.frame import Frame
from slam.dual.fusion.fuse import Fused, FusionConfig, fuse, seam_frame
from slam.dual.fusion.merge_recovered import Recovered, Whereabouts, in_present_map, merge_recovered
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
        self._absorbed: dict[int, Whereabouts] = {}

    def merge_recovered(self, frame: Frame, found: Recovered) -> None:
        """Merge a recovery's extended copy into the new map, then fuse that with the old one.

        Both maps may have changed since the recovery started. If they can no longer be fused, event
        ``fusion`` says why; if the new map is no longer there, nothing happens.

        Args:
            frame: the newest frame.
            found: by the recovery; its extended map is not to be used afterwards.
        """
        engine, accepted = self._engine, found.alignments[-1]
        if found.new_id not in engine.store:
            return
        engine.backend.drain()
        new, old_id = engine.store[found.new_id], self._whereabouts(accepted.old_map_id).map_id
        alignments = [self._in_present_map(found, a) for a in found.alignments]
        if alignments[-1] is None:
            self._refuse(frame, old_id, new.map_id, "recovery", accepted, "old_map_has_changed")
            return
        old = engine.store[old_id]
        merged = merge_recovered(new, found.extended, found.keyframes, found.points)
        if merged is None:
            self._refuse(frame, old_id, new.map_id, "recovery", accepted, "new_map_has_changed")
            return
        moved = [merged.moved(a, new) for a in alignments if a is not None]
        seam = seam_frame(old, moved)
        self._withdraw_passed_over(frame, old, seam, found)
        fused = self._fuse(frame, old, new, moved, "recovery", found.since)
        rebase_frames(found.frames, merged.keyframes, fused, moved[-1].scale)
        for tracked in found.frames:
            if tracked.features.index > seam:
                engine.store.poses.add(old.map_id, tracked)

    def _withdraw_passed_over(self, frame: Frame, old: Map, seam: int, found: Recovered) -> None:
        """Take back the old map's poses between seam and breakage: the breakage may have corrupted them.

        The frames that the recovery has placed get other poses; it has passed over the others.
        """
        engine = self._engine
        taken = engine.store.poses.take_back(old.map_id, seam + 1, found.since)
        placed = {tracked.features.index for tracked in found.frames}
        gone = [index for index in taken if index not in placed]
        if gone:
            engine.emit_at(
                frame, ev.PosesWithdrawn, old.map_id,
                first_frame=gone[0], last_frame=gone[-1], frames=len(gone),
                keyframes=sum(old.frame_index(int(k)) in gone for k in old.keyframes()),
                reason="passed_over_by_recovery",
            )  # fmt: skip

    def _whereabouts(self, map_id: int) -> Whereabouts:
        """Where the rows of a map are, also if others have absorbed it."""
        at = Whereabouts(map_id)
        while at.map_id in self._absorbed:
            by = self._absorbed[at.map_id]
            at = Whereabouts(by.map_id, at.keyframes + by.keyframes, at.points + by.points)
        return at

    def _in_present_map(self, found: Recovered, alignment: Alignment) -> Alignment | None:
        """The alignment with the old map as it is now; None if it no longer holds."""
        then = next(m for m in found.old_maps if m.map_id == alignment.old_map_id)
        at = self._whereabouts(alignment.old_map_id)
        if at.map_id not in self._engine.store:
            return None
        return in_present_map(alignment, self._engine.store[at.map_id], then, at)

    def skip_present_keyframes(self) -> None:
        """Search no place of a keyframe that the current map has now."""
        if self._places is not None and self._engine.store.current_id in self._engine.store:
            self._places.skip(self._engine.store.current)

    def merge_by_place(self, frame: Frame) -> bool:
        """Fuse the current map with a saved one that its newest keyframes recognise; True if there is one."""
        engine, store = self._engine, self._engine.store
        if self._places is None or not store.saved:
            return False
        if self._corrections != engine.corrections:
            self._corrections = engine.corrections
            self._places.reset_alignments()
        current, lock = store.current, engine.backend.lock
        alignments = self._recognise(self._places, frame, current, lock)
        if not alignments:
            return False
        happened = len(engine.events)
        engine.backend.drain()
        if len(engine.events) != happened or current.arrays.kf_bad[alignments[-1].new_keyframe]:
            return False  # the map has just changed: the alignments are no longer valid
        saved = store[alignments[-1].old_map_id]
        if saved.map_id < current.map_id:
            self._fuse(frame, saved, current, alignments, "place")
        else:
            self._fuse(frame, current, saved, [inverted(a, current.map_id) for a in alignments], "place")
        return True

    def _recognise(
        self, places: PlaceMerger, frame: Frame, current: Map, lock: AbstractContextManager
    ) -> Sequence[Alignment]:
        store = self._engine.store
        saved = [store[k] for k in store.saved]
        alignments = places.search(current, saved, lambda k: store.places(k).database, lock)
        for alignment, reason in places.refused:
            self._refuse(frame, alignment.old_map_id, current.map_id, "place", alignment, reason)
        return alignments

    def _fuse(
        self,
        frame: Frame,
        old: Map,
        new: Map,
        alignments: Sequence[Alignment],
        by: str,
        renewed_until: int = -1,
    ) -> Fused:
        """Fuse the new map into the old one; all that refers to them follows."""
        engine, store, accepted = self._engine, self._engine.store, alignments[-1]
        relation = fusion_relation(
            old, new, accepted.old_keyframe, accepted.new_keyframe, accepted.S_old_new,
            seam_frame(old, alignments) if by == "recovery" else None,
        )  # fmt: skip
        fused = fuse(old, new, alignments, engine.config.mapping, renewed_until)
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
        self._absorbed[new.map_id] = Whereabouts(old.map_id, fused.keyframes, fused.points)
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
