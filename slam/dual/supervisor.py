"""Dual-SLAM: at a breakage, save the map, start another, recover backward, fuse.

Source: paper, Sec. II and III, Fig. 3.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from slam import events as ev
from slam._map_kernels import resolve_points
from slam.backend import Change, ExecutionMode, Mapped
from slam.camera import PinholeCamera
from slam.config import SlamConfig
from slam.dual.buffer import FeatureBuffer
from slam.dual.config import DualConfig
from slam.dual.fusion import Fused, fuse, seam_frame
from slam.dual.grafting import graft
from slam.dual.joining import MapJoiner
from slam.dual.recoveries import Recoveries, ThreadOutcome
from slam.dual.recovery import RecoveryResult, RecoveryTask
from slam.dual.registry import build_thread
from slam.events import TrackingState
from slam.frame import Frame
from slam.geometry import share_of_motion
from slam.initialization import InitialMap
from slam.map import Map
from slam.map_alignment import Alignment
from slam.seeds import rng_for
from slam.system import MonocularSlam
from slam.tracking import TrackingOutcome

_TO_PLACE = 3  # newest keyframes that are looked for in saved maps, when that has had to wait


@dataclass(frozen=True)
class _Attempt:
    """A recovery that is under way.

    Attributes:
        new_id: the map that is extended backward.
        old_ids: the saved maps that it aims at, newest first.
        keyframes, points: rows of the new map when it was copied.
    """

    new_id: int
    old_ids: tuple[int, ...]
    keyframes: int
    points: int


class DualSlam(MonocularSlam):
    """The base system with the paper's handling of tracking failure.

    One recovery is under way at a time. While it is, no map that it concerns is dropped or taken in by
    another: a new map that breaks meanwhile is saved, and fused all the same if the recovery succeeds.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        seed: int = 0,
        config: SlamConfig | None = None,
        dual: DualConfig | None = None,
        mode: ExecutionMode = ExecutionMode.LOCKSTEP,
    ) -> None:
        super().__init__(camera, seed, config, mode)
        self.dual = dual or DualConfig()
        self._threads = [(build_thread(spec), spec.seed) for spec in self.dual.threads]
        needs_images = any(thread.needs_images for thread, _ in self._threads)
        self._buffer = FeatureBuffer(self.dual.buffer_s, self.dual.buffer_cap_s, needs_images)
        self._recoveries = Recoveries(mode, self.dual.exhaustive)
        self._attempt: _Attempt | None = None
        self._joiner = MapJoiner(self.dual.joining) if self.dual.joining else None
        self._to_place: list[int] = []
        self._saved: list[int] = []
        self._recovery_due = False
        self._held = False
        self._broke_at = -1
        self._last_frame: Frame | None = None
        self._first: Frame | None = None
        self._second: Frame | None = None

    @property
    def settings(self) -> dict:
        """Every setting in force, those of Dual-SLAM under ``dual``."""
        return {**super().settings, "dual": asdict(self.dual)}

    @property
    def buffer(self) -> FeatureBuffer:
        """The frames that a recovery would go back over."""
        return self._buffer

    # -- breakage ----------------------------------------------------------------------------------------

    def _break(self, frame: Frame, outcome: TrackingOutcome) -> None:
        """Save the map, unless it is too young to be worth it, and seek another.

        A new map that breaks before it was fit for recovery is dropped: the frames it had are in the buffer,
        and the next map's recovery goes back over them too.
        """
        self._emit(frame, ev.Breakage, reason=outcome.reason, inliers=outcome.inliers)
        extended = self._attempt is not None and self._attempt.new_id == self._map_id
        if self._recovery_due and not self._fit_for_recovery():
            self._drop(frame, "broke_before_recovery")
        elif extended or not self._drop_if_young(frame):
            self._save(frame)
        self._seek_after(frame)

    def _fit_for_recovery(self) -> bool:
        return len(self.current_map.keyframes()) >= self.dual.start_keyframes

    def _save(self, frame: Frame) -> None:
        """Keep the current map as it is, to be fused later."""
        m = self.current_map
        self._emit(frame, ev.MapSaved, keyframes=len(m.keyframes()), points=len(m.points()))
        self._saved.insert(0, self._map_id)
        self._broken_at[self._map_id] = frame.features
        self._seek_new_map()

    def _seek_after(self, frame: Frame) -> None:
        """A new map is to start from the frames that come."""
        self._broke_at = frame.features.index
        self._to_place.clear()
        self._recovery_due = bool(self._threads and self._reachable())
        self._buffer.frozen = self._recovery_due
        if not self._held:
            self._emit(frame, ev.ReinitStart)

    def _reachable(self) -> list[int]:
        """Saved maps that the buffer goes back to, newest first."""
        return [k for k in self._saved if self._buffer.reaches(_newest_frame(self._maps[k]))]

    def _initialize(self, frame: Frame) -> tuple[TrackingOutcome, bool]:
        if self._held:
            return TrackingOutcome(False, 0, 0, "held"), False
        if self.dual.relocalization and self._attempt is None:
            for map_id in self._saved[: self.dual.relocalization_maps]:
                outcome = self._relocalize_in(map_id, frame)
                if outcome.success:
                    self._back_in(map_id)
                    return outcome, False
        return super()._initialize(frame)

    def _back_in(self, map_id: int) -> None:
        """A saved map is the current one again, and no other is sought."""
        self._saved.remove(map_id)
        self._initializer.reset()
        self._recovery_due = self._buffer.frozen = False

    def _start_map(self, initial: InitialMap) -> None:
        super()._start_map(initial)
        self._first, self._second = initial.first, initial.second
        if self._broke_at >= 0:
            taken = initial.second.features.index - self._broke_at
            self._emit(initial.second, ev.ReinitDone, frames_taken=taken)

    # -- after every frame -------------------------------------------------------------------------------

    def _after_frame(self, frame: Frame, outcome: TrackingOutcome, image: np.ndarray) -> None:
        self._buffer.append(frame.features, image)
        self._last_frame = frame
        for ended in self._recoveries.ended(frame.features.stamp_s):
            self._conclude(frame, ended)
        if not outcome.success or self.state is not TrackingState.TRACKING or self._attempt is not None:
            return
        if not self._recovery_due:
            self._join_by_place(frame)
        elif self._fit_for_recovery():
            self._recover(frame)

    def finish(self) -> None:
        """End of input: a recovery that is under way is waited for, then as in the base."""
        if self._last_frame is not None:
            for ended in self._recoveries.rest():
                self._conclude(self._last_frame, ended)
        self._recoveries.close()
        super().finish()

    # -- recovery ----------------------------------------------------------------------------------------

    def _recover(self, frame: Frame) -> None:
        """Set the recovery threads going."""
        self._backend.drain()
        self._recovery_due = self._buffer.frozen = False
        m = self.current_map
        self._attempt = _Attempt(self._map_id, tuple(self._reachable()), m.n_keyframes, m.n_points)
        if self._attempt.old_ids:
            threads = [thread for thread, _ in self._threads]
            tasks = [self._task(number, seed) for number, (_, seed) in enumerate(self._threads, start=1)]
            self._announce(frame, 1, len(tasks[0].backward))
            # What runs beside tracking is not tracking's time, in lockstep neither.
            with self.timer.apart():
                self._recoveries.start(threads, tasks, frame.features.stamp_s)
            for ended in self._recoveries.ended(frame.features.stamp_s):
                self._conclude(frame, ended)
        else:
            self._give_up(frame)

    def _task(self, number: int, seed: int) -> RecoveryTask:
        attempt, first, second = self._attempt, self._first, self._second
        if attempt is None or first is None or second is None:
            raise RuntimeError("there is no new map to extend")
        new_map = self.current_map.copy()
        start = Frame(first.features)
        start.point[:] = new_map.observed_points(0)
        start.T_cam_map, start.T_cam_reference = new_map.T_cam_map(0), np.eye(4)
        start.reference_keyframe = 0
        steps = second.features.index - first.features.index
        motion = new_map.T_cam_map(0) @ np.linalg.inv(new_map.T_cam_map(1))
        old_maps = [self._maps[k] for k in attempt.old_ids]
        if self._backend.mode is ExecutionMode.THREADED:
            old_maps = [m.copy() for m in old_maps]
        return RecoveryTask(
            new_map,
            start,
            tuple(self._buffer.backward_from(first.features.index)),
            old_maps,
            share_of_motion(motion, 1.0 / steps),
            rng_for(self.seed, "recovery", number, seed, self._broke_at),
            self.camera,
            self._buffer.images(),
        )

    def _announce(self, frame: Frame, number: int, buffered_frames: int) -> None:
        attempt = self._under_way
        self._emit_at(
            frame,
            ev.RecoveryStart,
            attempt.new_id,
            thread=number,
            method=self._threads[number - 1][0].name,
            old_map_id=attempt.old_ids[0] if attempt.old_ids else self._saved[0],
            buffered_frames=buffered_frames,
        )

    def _conclude(self, frame: Frame, ended: ThreadOutcome) -> None:
        """A recovery thread has ended: fuse where it is the first to succeed."""
        attempt, result = self._under_way, ended.result
        alignment = result.alignment if result.success else None
        self._emit_at(
            frame,
            ev.RecoveryEnd,
            attempt.new_id,
            thread=ended.number,
            method=ended.name,
            old_map_id=alignment.old_map_id if alignment else attempt.old_ids[0],
            success=result.success,
            stage=result.stage,
            reason=result.reason,
            frames_covered=result.frames_covered,
            frames_passed_over=result.frames_passed_over,
            inliers=result.inliers,
            cpu_ms=ended.cpu_ms,
        )
        if alignment is not None and attempt.new_id in self._maps:
            self._fuse_recovered(frame, attempt, result, alignment)
        if ended.is_last:
            self._attempt = None
        else:
            self._announce(frame, ended.number + 1, result.frames_covered)

    def _give_up(self, frame: Frame) -> None:
        """The buffer no longer reaches any saved map: every thread has failed before it began."""
        attempt = self._under_way
        for number, (thread, _) in enumerate(self._threads, start=1):
            self._announce(frame, number, 0)
            self._emit_at(
                frame, ev.RecoveryEnd, attempt.new_id, thread=number, method=thread.name,
                old_map_id=self._saved[0], success=False, stage="overlap", reason="buffer_exceeded",
                frames_covered=0, frames_passed_over=0, inliers=0, cpu_ms=0.0,
            )  # fmt: skip
        self._attempt = None

    @property
    def _under_way(self) -> _Attempt:
        if self._attempt is None:
            raise RuntimeError("no recovery is under way")
        return self._attempt

    # -- fusion ------------------------------------------------------------------------------------------

    def _fuse_recovered(
        self, frame: Frame, attempt: _Attempt, result: RecoveryResult, alignment: Alignment
    ) -> None:
        """The new map takes over what the recovery has found before it, and both go into the old map."""
        self._backend.drain()
        old, new = self._maps[alignment.old_map_id], self._maps[attempt.new_id]
        grafted = graft(new, result.map, attempt.keyframes, attempt.points)
        alignments = [grafted.moved(a, new) for a in (*result.confirming, alignment)]
        seam = seam_frame(old, alignments)
        fused = self._fuse(frame, old, new, alignments, "recovery")
        for tracked in result.frames:
            if tracked.features.index > seam:
                row = tracked.reference_keyframe + grafted.keyframes + fused.keyframes
                _shift(tracked, row, alignment.scale * fused.factor[row])
                self._poses.add(old.map_id, tracked)

    def _fuse(self, frame: Frame, old: Map, new: Map, alignments: Sequence[Alignment], by: str) -> Fused:
        """The old map takes in the new one; whoever was in the new one goes on in the result."""
        accepted = alignments[-1]
        fused = fuse(old, new, alignments, self.config.mapping, renewed=by == "recovery")
        self._poses.join(old.map_id, new.map_id, fused.keyframes, accepted.scale)
        self._poses.rescale(old.map_id, fused.factor)
        self._forget(new.map_id)
        if self._joiner is not None:
            self._joiner.forget()
        self._to_place.clear()
        self._saved = [k for k in self._saved if k not in (old.map_id, new.map_id)]
        if self._map_id == new.map_id:
            self._map_id = old.map_id
            self._continue_in(old, fused, accepted.scale)
        else:
            self._saved.insert(0, old.map_id)
        self._emit_at(
            frame, ev.Fusion, old.map_id, old_map_id=old.map_id, new_map_id=new.map_id, by=by,
            accepted=True, scale=accepted.scale, inliers=accepted.inliers, reason="",
        )  # fmt: skip
        return fused

    def _continue_in(self, old: Map, fused: Fused, scale: float) -> None:
        tracker, mapper = self.tracker, self.mapper
        last = tracker.last
        if last is None:
            raise RuntimeError("the tracker has not been started")
        row = last.reference_keyframe + fused.keyframes
        scale *= fused.factor[row]
        _shift(last, row, scale)
        last.point[last.point >= 0] += fused.points
        resolve_points(old.arrays, last.point)
        if tracker.velocity is not None:
            tracker.velocity = tracker.velocity.copy()
            tracker.velocity[:3, 3] *= scale
        tracker.rebase(old, last)
        mapper.rebase(old)

    # -- maps met again ----------------------------------------------------------------------------------

    def _apply(self, change: Change) -> None:
        super()._apply(change)
        if isinstance(change, Mapped) and self._saved:
            self._to_place = [*self._to_place[1 - _TO_PLACE :], change.keyframe]

    def _join_by_place(self, frame: Frame) -> None:
        """Look whether the newest keyframes show a saved map."""
        if self._joiner is None:
            return
        keyframes, self._to_place = self._to_place, []
        for keyframe in keyframes:
            for map_id in tuple(self._saved):
                old, new = self._maps[map_id], self.current_map
                rng = rng_for(self.seed, "joining", new.frame_index(keyframe), map_id)
                with self._backend.lock:
                    if new.arrays.kf_bad[keyframe]:
                        continue
                    alignments = self._joiner.offer(new, keyframe, old, self._places(map_id).database, rng)
                if alignments:
                    self._backend.drain()
                    self._fuse(frame, old, new, alignments, "place")
                    return

    # -- laboratory --------------------------------------------------------------------------------------

    def cut(self) -> None:
        """Save the healthy map as a breakage would, and only buffer frames until :meth:`restart`.

        Together they are the crossing arm of a test of Eq. 1: recovery then has to cross all of the frames
        between, whether or not tracking would have failed in them.

        Raises:
            RuntimeError: there is no map that is tracked in.
        """
        if self.state is not TrackingState.TRACKING or self._last_frame is None:
            raise RuntimeError("there is no healthy map to cut")
        self._backend.drain()
        self._emit(self._last_frame, ev.MapCut)
        self._held = True
        self._save(self._last_frame)
        self._seek_after(self._last_frame)

    def restart(self) -> None:
        """After :meth:`cut`: a new map is sought from the next frame on.

        Raises:
            RuntimeError: nothing is held.
        """
        if not self._held or self._last_frame is None:
            raise RuntimeError("nothing is held")
        self._held = False
        self._emit(self._last_frame, ev.ReinitStart)


def _newest_frame(map_: Map) -> int:
    return max(map_.frame_index(int(k)) for k in map_.keyframes())


def _shift(frame: Frame, keyframe: int, scale: float) -> None:
    """Refer a tracked frame to its keyframe's new row, in new lengths."""
    frame.reference_keyframe = keyframe
    frame.T_cam_reference = frame.T_cam_reference.copy()
    frame.T_cam_reference[:3, 3] *= scale
