"""Dual-SLAM: save the map at a breakage, start a new one, recover backward, fuse.

Source: paper, Sec. II and III, Fig. 3.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import asdict

import numpy as np

from slam.config import SlamConfig
from slam.core import events as ev
from slam.core.camera import PinholeCamera
from slam.core.events import TrackingState
from slam.core.frame import Frame
from slam.dual.attempts import Attempt, NewMap, RecoveryAttempts
from slam.dual.buffer import FeatureBuffer
from slam.dual.config import DualConfig
from slam.dual.fusion.fuse import Fused, fuse, seam_frame
from slam.dual.fusion.merge_recovered import merge_recovered
from slam.dual.fusion.place_merging import PlaceMerger, inverted
from slam.dual.fusion.rebase import rebase_frames, rebase_tracking
from slam.dual.recovery.interface import RecoveryResult
from slam.dual.restarting import RestartingSlam
from slam.initialization.initializer import InitialMap
from slam.loop_closing.map_alignment import Alignment
from slam.map.map import Map
from slam.map.relation import fusion_relation
from slam.runtime.backend import Adjusted, Change, Corrected, ExecutionMode, Mapped
from slam.tracking.tracker import TrackingOutcome


class DualSlam(RestartingSlam):
    """SLAM with backward recovery and map fusion after a breakage.

    One recovery runs at a time. Meanwhile its maps are neither dropped nor fused: a new map that breaks is
    saved, and still fused if the recovery succeeds. A map that breaks while its recovery waits for another
    one's end is saved, and its recovery stays in the queue.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        seed: int = 0,
        config: SlamConfig | None = None,
        dual: DualConfig | None = None,
        mode: ExecutionMode = ExecutionMode.LOCKSTEP,
    ) -> None:
        self.dual = dual or DualConfig()
        relocalization_maps = self.dual.relocalization_maps if self.dual.relocalization else 0
        super().__init__(camera, seed, config, mode, relocalization_maps)
        self._attempts = RecoveryAttempts(self.dual, camera, seed, mode, self._emit_at)
        self._buffer = FeatureBuffer(self.dual.buffer_s, self.dual.buffer_cap_s, self._attempts.needs_images)
        self._place_merger = PlaceMerger(self.dual.place_merging, seed) if self.dual.place_merging else None
        self._new: NewMap | None = None
        self._recovery_due = False
        self._waiting: deque[NewMap] = deque()

    @property
    def settings(self) -> dict:
        """All settings, those of Dual-SLAM under ``dual``."""
        return {**super().settings, "dual": asdict(self.dual)}

    @property
    def buffer(self) -> FeatureBuffer:
        """The frames over which a recovery goes backward."""
        return self._buffer

    # -- camera ------------------------------------------------------------------------------------------

    def _may_refine_camera(self) -> bool:
        return super()._may_refine_camera() and not self._saved and self._attempts.under_way is None

    def _camera_refined(self) -> None:
        self._buffer.undistort_with(self.camera)
        self._attempts.camera = self.camera

    # -- breakage ----------------------------------------------------------------------------------------

    def _save_or_drop_map(self, frame: Frame) -> None:
        """Save the map, or drop it if it is too small to be recovered from.

        The frames of a dropped map are still in the buffer: the next map's recovery goes back over them too.
        """
        attempt = self._attempts.under_way
        if self._recovery_due and not self._fit_for_recovery():
            self._drop(frame, "broke_before_recovery")
        elif self._recovery_due:
            self._waiting.append(self._take_new_map())
            self._save(frame)
        elif attempt is not None and attempt.new_id == self._map_id:
            self._save(frame)
        else:
            super()._save_or_drop_map(frame)

    def _take_new_map(self) -> NewMap:
        """Return the new map whose recovery is due, and clear the due flag."""
        new, self._new = self._new, None
        if new is None:
            raise RuntimeError("there is no new map to extend")
        self._recovery_due = False
        return new

    def _fit_for_recovery(self) -> bool:
        return len(self.current_map.keyframes()) >= self.dual.start_keyframes

    def _start_reinitialization(self, frame: Frame) -> None:
        if self._place_merger is not None:
            self._place_merger.reset_keyframes()
        self._recovery_due = self._attempts.possible and bool(self._reachable())
        self._buffer.frozen = self._recovery_due
        super()._start_reinitialization(frame)

    def _reachable(self) -> list[int]:
        """Saved maps that the buffer reaches, newest first."""
        return [k for k in self._saved if self._buffer.reaches(_newest_frame(self._maps[k]))]

    def _relocalization_maps(self) -> Sequence[int]:
        return () if self._attempts.under_way else super()._relocalization_maps()

    def _resume_saved_map(self, map_id: int) -> None:
        super()._resume_saved_map(map_id)
        self._recovery_due = self._buffer.frozen = False

    def _start_map(self, initial: InitialMap) -> None:
        super()._start_map(initial)
        self._new = NewMap(initial.map, initial.first, initial.second, self._reinit_start)

    # -- after every frame -------------------------------------------------------------------------------

    def _after_frame(self, frame: Frame, outcome: TrackingOutcome, image: np.ndarray) -> None:
        self._buffer.append(frame.features, image)
        self._take_recovered(frame, self._attempts.ended(frame))
        if self._waiting and not self._attempts.under_way:
            self._recover(frame, self._waiting.popleft())
        if not outcome.success or self.state is not TrackingState.TRACKING or self._attempts.under_way:
            return
        if not self._recovery_due:
            self._merge_by_place(frame)
        elif self._fit_for_recovery():
            self._recover(frame, self._take_new_map())

    def _recover(self, frame: Frame, new: NewMap) -> None:
        """Start the recovery threads."""
        self._backend.drain()
        self._buffer.frozen = self._recovery_due or bool(self._waiting)
        older = [k for k in self._saved if k < new.map.map_id]
        reachable = [self._maps[k] for k in self._reachable() if k in older]
        if reachable:
            # Recovery runs beside tracking: even in lockstep it does not count as tracking's time.
            with self.timer.apart():
                self._attempts.begin(frame, new, reachable, self._buffer)
            self._take_recovered(frame, self._attempts.ended(frame))
        else:
            self._attempts.give_up(frame, new.map, older[0])

    def finish(self) -> None:
        """Complete running and waiting recoveries, then finish as the base does.

        Raises:
            Exception: the exception of a recovery or of mapping on its thread.
        """
        try:
            if self._newest is not None:
                self._take_recovered(self._newest, self._attempts.rest(self._newest))
                while self._waiting:
                    self._recover(self._newest, self._waiting.popleft())
                    self._take_recovered(self._newest, self._attempts.rest(self._newest))
        finally:
            self._attempts.close()
            super().finish()

    # -- fusion ------------------------------------------------------------------------------------------

    def _take_recovered(self, frame: Frame, succeeded: Iterable[tuple[Attempt, RecoveryResult]]) -> None:
        """Fuse the maps that recovery threads have aligned; only a recovery's first success counts."""
        for attempt, result in succeeded:
            if result.alignment is not None and attempt.new_id in self._maps:
                self._fuse_recovered(frame, attempt, result, result.alignment)

    def _fuse_recovered(
        self, frame: Frame, attempt: Attempt, result: RecoveryResult, alignment: Alignment
    ) -> None:
        """Merge the recovered part into the new map, then fuse it with the old one."""
        self._backend.drain()
        old, new = self._maps[alignment.old_map_id], self._maps[attempt.new_id]
        merged = merge_recovered(new, result.map, attempt.keyframes, attempt.points)
        if merged is None:
            self._refuse(frame, old.map_id, new.map_id, "recovery", alignment, "new_map_has_changed")
            return
        alignments = [merged.moved(a, new) for a in (*result.confirming, alignment)]
        seam = seam_frame(old, alignments)
        fused = self._fuse(frame, old, new, alignments, "recovery")
        rebase_frames(result.frames, merged.keyframes, fused, alignment.scale)
        for tracked in result.frames:
            if tracked.features.index > seam:
                self._poses.add(old.map_id, tracked)

    def _fuse(self, frame: Frame, old: Map, new: Map, alignments: Sequence[Alignment], by: str) -> Fused:
        """Fuse the new map into the old one; tracker, poses and saved maps follow."""
        accepted, renewed = alignments[-1], by == "recovery"
        relation = fusion_relation(
            old, new, accepted.old_keyframe, accepted.new_keyframe, accepted.S_old_new,
            seam_frame(old, alignments) if renewed else None,
        )  # fmt: skip
        fused = fuse(old, new, alignments, self.config.mapping, renewed)
        self._poses.join(old.map_id, new.map_id, fused.keyframes, accepted.scale)
        self._poses.rescale(old.map_id, fused.factor)
        both = (old.map_id, new.map_id)
        saved = [k for k in self._saved if k not in both]
        if self._map_id in both:
            if self._map_id == new.map_id:
                self._map_id = old.map_id
                rebase_tracking(self.tracker, self.mapper, old, fused, accepted.scale)
            if self._place_merger is not None:
                self._place_merger.reset_keyframes()
        else:  # the result counts as saved when the younger of the two was
            saved.insert(min(map(self._saved.index, both)), old.map_id)
            self._note_break(old.map_id, max((self._broken_at[k] for k in both), key=lambda f: f.index))
        self._saved = saved
        self._forget(new.map_id)
        if self._place_merger is not None:
            self._place_merger.reset_alignments()
        self._emit_at(
            frame, ev.Fusion, old.map_id, old_map_id=old.map_id, new_map_id=new.map_id, by=by,
            accepted=True, scale=accepted.scale, inliers=accepted.inliers, reason="", relation=relation,
        )  # fmt: skip
        return fused

    def _refuse(
        self, frame: Frame, old_id: int, new_id: int, by: str, alignment: Alignment, reason: str
    ) -> None:
        self._emit_at(
            frame, ev.Fusion, new_id, old_map_id=old_id, new_map_id=new_id, by=by,
            accepted=False, scale=alignment.scale, inliers=alignment.inliers, reason=reason,
        )  # fmt: skip

    # -- merging by place recognition --------------------------------------------------------------------

    def _apply(self, change: Change) -> None:
        super()._apply(change)
        if self._place_merger is None:
            return
        if isinstance(change, Mapped) and self._saved:
            self._place_merger.note(change.keyframe)
        elif isinstance(change, Corrected | Adjusted):
            self._place_merger.reset_alignments()

    def _merge_by_place(self, frame: Frame) -> None:
        """Fuse with a saved map that the newest keyframes recognise, if any."""
        if self._place_merger is None or not self._saved:
            return
        current = self.current_map
        alignments = self._place_merger.search(
            current,
            [self._maps[k] for k in self._saved],
            lambda map_id: self._places(map_id).database,
            self._backend.lock,
        )
        for alignment, reason in self._place_merger.refused:
            self._refuse(frame, alignment.old_map_id, current.map_id, "place", alignment, reason)
        if not alignments:
            return
        happened = len(self.events)
        self._backend.drain()
        if len(self.events) != happened or current.arrays.kf_bad[alignments[-1].new_keyframe]:
            return  # the map has just changed: the alignments are no longer valid
        saved = self._maps[alignments[-1].old_map_id]
        if saved.map_id < current.map_id:
            self._fuse(frame, saved, current, alignments, "place")
        else:
            self._fuse(frame, current, saved, [inverted(a, current.map_id) for a in alignments], "place")


def _newest_frame(map_: Map) -> int:
    return max(map_.frame_index(int(k)) for k in map_.keyframes())
