"""Map merger: fuses maps that a recovery has aligned, or a place.

As a loop is corrected, so are maps fused: on copies, beside tracking, after the keyframes and loops that come
before (``Backend.beside``). The copies take the place of the maps between two frames. No keyframe or point is
added meanwhile, so that nothing of the maps is lost; what tracking has done is carried over: the poses of its
frames, and those that wait to become keyframes.
"""

from collections.abc import Callable, Sequence
from functools import partial

from dslab.slam.core import events as ev
from dslab.slam.core.frame import Frame
from dslab.slam.dual.fusion.fuse import FusionConfig, seam_frame
from dslab.slam.dual.fusion.merge_recovered import Recovered, Whereabouts, in_present_map, merge_recovered
from dslab.slam.dual.fusion.place_merging import PlaceMerger, inverted
from dslab.slam.dual.fusion.prepared import PreparedFusion
from dslab.slam.dual.fusion.rebase import rebase_frames, rebase_tracking
from dslab.slam.engine import SlamEngine
from dslab.slam.loop_closing.map_alignment import Alignment
from dslab.slam.map.map import Map
from dslab.slam.map.relation import Relation
from dslab.slam.map_store import Loss
from dslab.slam.runtime.backend import TakeOver

STAGE = "fusion"
"""Stage of a frame in which the tracking thread takes over a fusion."""


class MapMerger:
    """Fuses maps; tracker, mapper, frame poses and the list of saved maps follow.

    Args:
        engine: of the maps.
        by_place: acceptance of a saved map that is recognised by its places; None for never.
        fused: called after every fusion, on the tracking thread.
    """

    def __init__(self, engine: SlamEngine, by_place: FusionConfig | None, fused: Callable[[], None]) -> None:
        self._engine = engine
        self._places = PlaceMerger(by_place, engine.config.place, engine.seed) if by_place else None
        self._fused = fused
        self._corrections = 0
        self._searching = False
        self._absorbed: dict[int, Whereabouts] = {}

    # -- on the tracking thread --------------------------------------------------------------------------

    def merge_recovered(self, found: Recovered) -> None:
        """Merge a recovery's extended copy into the new map, and fuse that with the old one.

        Both maps may have changed since the recovery started. If they can no longer be fused, event
        ``fusion`` says why; if the new map is no longer there, nothing happens.

        Args:
            found: by the recovery; its extended map is not to be used afterwards.
        """
        self._engine.backend.beside(partial(self._prepare_recovered, found), STAGE)

    def merge_by_place(self) -> None:
        """Search the saved maps for the current map's newest keyframes; fuse with one that they recognise."""
        store, places = self._engine.store, self._places
        if places is None or self._searching or not store.saved or not places.is_due(store.current):
            return
        self._searching = True
        self._engine.backend.beside(partial(self._prepare_by_place, places), STAGE)

    def merge_found(self, map_id: int, frames: Sequence[Frame]) -> None:
        """Fuse the current map with a saved one in which frames of it have been confirmed.

        Args:
            map_id: the saved map.
            frames: tracked in it; those that are keyframes of the current map relate the two.
        """
        if self._places is not None:
            self._searching = True
            self._engine.backend.beside(partial(self._prepare_found, self._places, map_id, frames), STAGE)

    def skip_present_keyframes(self) -> None:
        """Search no place of a keyframe that the current map has now."""
        if self._places is not None and self._engine.store.current_id in self._engine.store:
            self._places.skip(self._engine.store.current)

    # -- beside tracking, where no keyframe or point is added meanwhile ----------------------------------

    def _prepare_recovered(self, found: Recovered) -> TakeOver | None:
        engine, accepted = self._engine, found.alignments[-1]
        if found.new_id not in engine.store:
            return None
        new, old_id = engine.store[found.new_id].copy(), self._whereabouts(accepted.old_map_id).map_id
        alignments = [self._in_present_map(found, a) for a in found.alignments]
        refuse = partial(self._refuse, old_id, new.map_id, "recovery", accepted)
        if alignments[-1] is None:
            return partial(refuse, "old_map_has_changed")
        merged = merge_recovered(new, found.extended, found.keyframes, found.points)
        if merged is None:
            return partial(refuse, "new_map_has_changed")
        moved = [merged.moved(a, new) for a in alignments if a is not None]
        seam = seam_frame(engine.store[old_id], moved)
        prepared = self._prepare(engine.store[old_id], new, moved, found.since)
        rebase_frames(found.frames, merged.keyframes, prepared.fused, moved[-1].scale)

        def take_over() -> None:
            self._withdraw_passed_over(engine.store[old_id], seam, found)
            self._take_over(prepared, "recovery")
            for tracked in found.frames:
                if tracked.features.index > seam:
                    engine.store.poses.add(old_id, tracked)

        return take_over

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

    def _prepare_by_place(self, places: PlaceMerger) -> TakeOver | None:
        engine, store = self._engine, self._engine.store
        if self._corrections != engine.corrections:
            self._corrections = engine.corrections
            places.reset_alignments()
        current, saved = store.current, [store[k] for k in store.saved]
        alignments = places.search(current, saved, store.places, engine.backend.lock)
        self._searching, refused = False, tuple(places.refused)
        if not (alignments or refused):
            return None
        prepared = self._prepare_joined(current, alignments) if alignments else None
        fusions = len(self._absorbed)

        def take_over() -> None:
            for alignment, reason in refused:
                self._refuse(alignment.old_map_id, current.map_id, "place", alignment, reason)
            if prepared is not None and fusions == len(self._absorbed):
                self._take_over(prepared, "place")

        return take_over

    def _prepare_found(self, places: PlaceMerger, map_id: int, frames: Sequence[Frame]) -> TakeOver | None:
        store, fusions = self._engine.store, len(self._absorbed)
        self._searching = False
        if map_id not in store.saved:  # joined meanwhile
            return None
        alignments = places.of_frames(store.current, store[map_id], frames)
        if not alignments:
            return None
        prepared = self._prepare_joined(store.current, alignments)

        def take_over() -> None:
            if fusions == len(self._absorbed):
                self._take_over(prepared, "place")

        return take_over

    def _prepare_joined(self, current: Map, alignments: Sequence[Alignment]) -> PreparedFusion:
        """Fuse the current map with a saved one; the older of the two keeps its frame."""
        saved = self._engine.store[alignments[-1].old_map_id]
        if saved.map_id < current.map_id:
            return self._prepare(saved, current.copy(), alignments)
        return self._prepare(current, saved.copy(), [inverted(a, current.map_id) for a in alignments])

    def _prepare(
        self, old: Map, new: Map, alignments: Sequence[Alignment], renewed_until: int | None = None
    ) -> PreparedFusion:
        """Fuse copies; ``renewed_until``: last frame of the old map that a recovery has covered again."""
        by_recovery, mapping = renewed_until is not None, self._engine.config.mapping
        last = -1 if renewed_until is None else renewed_until
        return PreparedFusion.of(old, new, alignments, mapping, by_recovery, last)

    # -- on the tracking thread, between two frames ------------------------------------------------------

    def _take_over(self, prepared: PreparedFusion, by: str) -> None:
        """Put the fused map in the place of the two; all that refers to them follows."""
        store, old, new_id = self._engine.store, self._engine.store[prepared.old_id], prepared.new_id
        fused, accepted = prepared.fused, prepared.accepted
        old.adopt(prepared.map)
        store.poses.join(old.map_id, new_id, fused.keyframes, accepted.scale)
        store.poses.rescale(old.map_id, fused.factor)
        store.places(old.map_id).database.foresee(prepared.bows)
        both = (old.map_id, new_id)
        if store.current_id in both:
            if store.current_id == new_id:
                store.current_id = old.map_id
                self._rebase(old, prepared)
            store.saved = [k for k in store.saved if k not in both]
            self.skip_present_keyframes()
        else:  # the result counts as saved when the younger of the two was
            place = min(map(store.saved.index, both))
            store.saved[place] = old.map_id
            store.saved = [k for i, k in enumerate(store.saved) if k not in both or i == place]
            last = max((store.loss(k).at for k in both), key=lambda at: at.index)
            store.note_loss(old.map_id, Loss(last, store.loss(old.map_id).doubt))
        store.forget(new_id)
        self._absorbed[new_id] = Whereabouts(old.map_id, fused.keyframes, fused.points)
        if self._places is not None:
            self._places.reset_alignments()
        self._emit(old.map_id, old.map_id, new_id, by, accepted, "", prepared.relation)
        self._fused()

    def _withdraw_passed_over(self, old: Map, seam: int, found: Recovered) -> None:
        """Take back the old map's poses between seam and breakage: the breakage may have corrupted them.

        The frames that the recovery has placed get other poses; it has passed over the others.
        """
        taken = self._engine.store.poses.take_back(old.map_id, seam + 1, found.since)
        placed = {tracked.features.index for tracked in found.frames}
        gone = [index for index in taken if index not in placed]
        if gone:
            self._engine.emit_at(
                self._newest, ev.PosesWithdrawn, old.map_id,
                first_frame=gone[0], last_frame=gone[-1], frames=len(gone),
                keyframes=sum(old.frame_index(int(k)) in gone for k in old.keyframes()),
                reason="passed_over_by_recovery",
            )  # fmt: skip

    @property
    def _newest(self) -> Frame:
        """The newest frame, at which events happen."""
        if self._engine.newest is None:
            raise RuntimeError("there is no frame yet")
        return self._engine.newest

    def _rebase(self, old: Map, prepared: PreparedFusion) -> None:
        """Move tracking and mapping to the old map, with the keyframes in work."""
        engine, fused = self._engine, prepared.fused
        tasks = [task for task in engine.backend.in_work if task.mapper is engine.mapper]
        waiting = [task.frame for task in tasks if task.keyframe < 0]
        rebase_tracking(engine.tracker, engine.mapper, old, fused, prepared.accepted.scale, waiting)
        engine.second_motion = None  # the start is the old map's
        for task in tasks:
            task.rebase(engine.store.places(old.map_id).loops, fused.keyframes)

    def _refuse(self, old_id: int, new_id: int, by: str, alignment: Alignment, reason: str) -> None:
        self._emit(new_id, old_id, new_id, by, alignment, reason)

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
        self._engine.emit_at(
            self._newest, ev.Fusion, map_id, old_map_id=old_id, new_map_id=new_id, by=by,
            accepted=not reason, scale=alignment.scale, inliers=alignment.inliers, reason=reason,
            relation=relation,
        )  # fmt: skip
