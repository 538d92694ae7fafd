"""Dual-SLAM: save the map at a breakage, start a new one, recover backward, fuse.

Source: paper, Sec. II and III, Fig. 3.
"""

from collections.abc import Iterable, Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from functools import partial

import numpy as np

from dslab.slam.config import SlamConfig
from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import TrackingState
from dslab.slam.core.frame import Frame
from dslab.slam.core.results import TrackingResult
from dslab.slam.dual.buffer import FeatureBuffer
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.fusion.map_merger import MapMerger
from dslab.slam.dual.fusion.merge_recovered import Recovered
from dslab.slam.dual.recovery.interface import RecoveryResult
from dslab.slam.dual.recovery_jobs import Copies, NewMap, RecoveryJob, RecoveryJobs
from dslab.slam.initialization.initializer import InitialMap
from dslab.slam.map.map import Map
from dslab.slam.runtime.backend import ExecutionMode, TakeOver
from dslab.slam.system import MonocularSlam, MonocularSystem
from dslab.slam.tracking.tracker import TrackingOutcome


@dataclass
class Restart:
    """The way from a breakage to the recovery of the map that follows.

    Attributes:
        since: index of the frame of the breakage.
        recoverable: the buffer reaches a saved map, so that a recovery is due once the new map is fit.
        held: no map is sought until :meth:`DualSlam.restart`.
        new: the new map, once it is initialized.
        noise: of the frames tracked in it, see :class:`slam.core.frame.Frame`.
        starting: its recovery is about to start.
    """

    since: int
    recoverable: bool
    held: bool = False
    new: NewMap | None = None
    noise: list[float] = field(default_factory=list)
    starting: bool = False


class DualSlam(MonocularSystem):
    """SLAM with backward recovery and map fusion after a breakage.

    There are several ways home, and the first one counts: the recoveries, of which several may run at a time;
    the places of a new map's keyframes in saved maps; and those of its frames, before and after recoveries. A
    new map that breaks while its recovery runs is saved, and still fused if that succeeds.
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
        self.jobs = RecoveryJobs(self.dual, self.config, seed, mode, self.engine.emit_at)
        self.buffer = FeatureBuffer(self.dual.buffer_s, self.dual.buffer_cap_s, self.jobs.needs_images)
        self.merger = MapMerger(self.engine, self.dual.place_merging, self._forget_joined)
        self._restart: Restart | None = None  # since the last breakage, until its recovery is begun

    @property
    def settings(self) -> dict:
        """All settings, those of Dual-SLAM under ``dual``."""
        return {**super().settings, "dual": asdict(self.dual)}

    # -- Sec. III of the paper ---------------------------------------------------------------------------

    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult:
        """Process one frame; see :meth:`MonocularSystem.process`."""
        engine, is_keyframe = self.engine, False
        frame = engine.receive(image, stamp_s)
        if engine.state is TrackingState.TRACKING:
            outcome, is_keyframe = engine.track(frame)
            if engine.is_begun_wrong:
                outcome, is_keyframe = self._drop_wrong_map(frame, outcome), False
            elif not outcome.success:
                engine.declare_breakage(frame, outcome)
                self._save_or_drop_map(frame)
                self._start_anew(frame)
            elif self._is_new_and_small or (engine.search.probation is not None and not self._is_settled):
                frame, outcome = self._find_back(frame, outcome)
            if outcome.success and self._is_begun_smeared(frame):
                outcome, is_keyframe = self._begin_again(frame, outcome), False
        elif self._restart is not None and self._restart.held:
            outcome = TrackingOutcome(False, 0, 0, "held")
        else:
            frame, outcome = self._find_back(frame)
            if not (outcome.success or engine.search.undecided):
                outcome, is_keyframe = self._initialize(frame)
        engine.record(frame, outcome)
        self._fill_buffer(frame, image)
        self._fuse_recovered(self.jobs.ended(frame))
        self._recover(outcome)
        self._merge_by_place(frame, outcome, is_keyframe)
        return engine.result(frame, outcome, is_keyframe)

    def finish(self) -> None:
        """Complete running and waiting recoveries, then end the input.

        Raises:
            Exception: the exception of a recovery or of mapping on its thread.
        """
        newest = self.engine.newest
        try:
            if newest is not None:
                for found in self.jobs.rest(newest):
                    self._fuse_recovered([found])
                    self.engine.backend.drain()
        finally:
            self.jobs.close()
            super().finish()

    # -- breakage ----------------------------------------------------------------------------------------

    def _save_or_drop_map(self, frame: Frame) -> None:
        """Save the map, or drop it if it is too small to be recovered from.

        The frames of a dropped map are still in the buffer: the next map's recovery goes back over them too.
        """
        engine, restart = self.engine, self._restart
        if restart is not None and restart.recoverable and restart.new is not None:
            if self._fit_for_recovery():
                with engine.timer.apart():
                    self._prepare_recovery(restart, restart.new, self._reachable(restart.new))()
                self._save(frame)
            else:
                engine.drop_map(frame, "broke_before_recovery")
        elif any(job.new_id == engine.store.current_id for job in self.jobs.running):
            self._save(frame)
        elif engine.is_young:
            engine.drop_map(frame, "too_few_keyframes")
        else:
            self._save(frame)

    def _save(self, frame: Frame) -> None:
        """Keep the current map, to be fused later."""
        engine, m = self.engine, self.engine.store.current
        engine.emit(frame, ev.MapSaved, keyframes=len(m.keyframes()), points=len(m.points()))
        engine.store.save_current()
        engine.lose(frame)
        engine.seek_new_map()

    def _start_anew(self, frame: Frame, held: bool = False) -> None:
        """Seek a new map from the next frames on."""
        recoverable = self.jobs.any_threads and bool(self._reachable())
        self._restart = Restart(frame.features.index, recoverable, held)
        self.buffer.frozen = recoverable
        if not held:
            self.engine.emit(frame, ev.ReinitStart)

    def _is_begun_smeared(self, frame: Frame) -> bool:
        """Note a frame of a new map; True if a recovery would start from a map whose frames are smeared."""
        restart = self._restart
        if restart is None or restart.new is None or restart.starting or not restart.recoverable:
            return False
        restart.noise.append(frame.noise)
        return self._fit_for_recovery() and float(np.median(restart.noise)) > self.dual.max_start_noise

    def _begin_again(self, frame: Frame, outcome: TrackingOutcome) -> TrackingOutcome:
        """Drop a map begun from smeared frames, and seek another one for the recovery that was due."""
        engine, restart = self.engine, self._restart
        engine.backend.drain()
        if restart is None or self._restart is not restart:  # joined meanwhile
            return outcome
        engine.drop_map(frame, "smeared")
        self._seek_another(frame, restart)
        return TrackingOutcome(False, outcome.inliers, outcome.matches, "smeared")

    def _drop_wrong_map(self, frame: Frame, outcome: TrackingOutcome) -> TrackingOutcome:
        """Drop a map begun from the wrong motion, and seek another one for the recovery that goes with it."""
        engine = self.engine
        outcome = engine.drop_wrong_map(frame, outcome)
        if outcome.success:
            return outcome
        self.jobs.cancel(frame, lambda job: job.new_id not in engine.store, "map_dropped")
        if self._restart is not None:
            self._seek_another(frame, self._restart)
        elif engine.store.saved:
            self._start_anew(frame)
        return outcome

    def _seek_another(self, frame: Frame, restart: Restart) -> None:
        """Seek another new map for the same recovery."""
        self.engine.emit(frame, ev.ReinitStart)
        restart.new, restart.starting = None, False
        restart.noise.clear()

    @property
    def _sought(self) -> list[int]:
        """Saved maps in which frames are sought."""
        return self.engine.store.saved[: self.dual.relocalization_maps] if self.dual.relocalization else []

    @property
    def _is_new_and_small(self) -> bool:
        """True if a new map is tracked from which no recovery can start yet."""
        return self._restart is not None and self._restart.new is not None and not self._fit_for_recovery()

    def _find_back(
        self, frame: Frame, outcome: TrackingOutcome | None = None
    ) -> tuple[Frame, TrackingOutcome]:
        """Relocalize a frame in saved maps; if it is found there, tracking goes on there.

        Args:
            frame: the newest frame.
            outcome: of tracking it in a new map, which is dropped if the frame is found; None if no map is
                tracked. Once the map is fit for recovery, no more than a probation under way is completed.

        Returns:
            The frame, with its pose if it was found, and the outcome.
        """
        engine, sought = self.engine, self._sought
        if not sought and engine.search.probation is None:
            return frame, outcome or TrackingOutcome(False, 0, 0, "no_candidates")
        again = engine.again(frame)  # its own: the frame is used otherwise meanwhile
        leave = partial(engine.drop_map, reason="returned_to_saved_map") if outcome is not None else None
        begin = outcome is None or self._is_new_and_small
        found = engine.relocalize(again, sought, leave, begin)
        if not found.success:
            return frame, outcome or found
        self._note_return()
        self.jobs.cancel(frame, lambda job: job.new_id not in engine.store, "returned_to_saved_map")
        return again, found

    def _note_return(self) -> None:
        """A saved map is tracked again."""
        self.engine.store.saved.remove(self.engine.store.current_id)
        self.merger.skip_present_keyframes()
        self._restart, self.buffer.frozen = None, False

    def _initialize(self, frame: Frame) -> tuple[TrackingOutcome, bool]:
        """Try to initialize a new map; the outcome, and True if it succeeded."""
        outcome, initial = self.engine.initialize(frame)
        if initial is not None:
            self._note_new_map(initial)
        return outcome, initial is not None

    def _note_new_map(self, initial: InitialMap) -> None:
        self.merger.skip_present_keyframes()
        if self._restart is not None:
            since = self._restart.since
            self._restart.new = NewMap(initial.map, initial.first, initial.second, since)
            taken = initial.second.features.index - since
            self.engine.emit(initial.second, ev.ReinitDone, frames_taken=taken)

    # -- recovery ----------------------------------------------------------------------------------------

    def _fill_buffer(self, frame: Frame, image: np.ndarray) -> None:
        self.buffer.undistort_with(self.engine.camera)
        self.buffer.append(frame.features, image)

    def _fit_for_recovery(self) -> bool:
        return len(self.current_map.keyframes()) >= self.dual.start_keyframes

    def _reachable(self, new: NewMap | None = None) -> list[int]:
        """Saved maps that the buffer reaches, newest first; those older than a new map, if one is given."""
        store = self.engine.store
        older = [k for k in store.saved if new is None or k < new.map.map_id]
        return [k for k in older if self.buffer.reaches(_newest_frame(store[k]))]

    def _recover(self, outcome: TrackingOutcome) -> None:
        """Start the recovery that is due, as soon as mapping and loop closing have done what they are at."""
        due = self._restart
        if due is None or due.new is None or due.starting or not due.recoverable:
            return
        if outcome.success and self.state is TrackingState.TRACKING and self._fit_for_recovery():
            due.starting = True
            # Recovery runs beside tracking: even in lockstep it does not count as tracking's time.
            with self.engine.timer.apart():
                self.engine.backend.beside(
                    partial(self._prepare_recovery, due, due.new, self._reachable(due.new))
                )

    def _prepare_recovery(self, due: Restart, new: NewMap, reachable: Sequence[int]) -> TakeOver:
        """Copy the maps for the recovery threads, to be started between two frames."""
        store = self.engine.store
        copies = self.jobs.copies(new, [store[k] for k in reachable if k in store])
        return partial(self._start_recovery, due, new, copies)

    def _start_recovery(self, due: Restart, new: NewMap, copies: Copies) -> None:
        """Start the recovery threads, unless the maps were joined since they were due."""
        engine, store, newest = self.engine, self.engine.store, self.engine.newest
        if self._restart is not due or newest is None:
            return
        self._restart, self.buffer.frozen = None, False
        older = [k for k in store.saved if k < new.map.map_id]
        if copies.old:
            self.jobs.start(newest, new, copies, self.buffer, engine.camera, engine.remembered)
        elif older:
            self.jobs.give_up(newest, new.map, store[older[0]])

    # -- fusion ------------------------------------------------------------------------------------------

    def _fuse_recovered(self, succeeded: Iterable[tuple[RecoveryJob, RecoveryResult]]) -> None:
        """Fuse the maps that recovery threads have aligned; only a recovery's first success counts."""
        for job, result in succeeded:
            if result.alignment is not None:
                alignments = (*result.confirming, result.alignment)
                found = Recovered(
                    job.new_id, result.map, job.keyframes, job.points,
                    result.frames, job.old_maps, alignments, job.since,
                )  # fmt: skip
                self.merger.merge_recovered(found)

    def _merge_by_place(self, frame: Frame, outcome: TrackingOutcome, is_keyframe: bool) -> None:
        """Fuse with a saved map whose place is recognised."""
        if outcome.success and self.state is TrackingState.TRACKING:
            self.merger.merge_by_place()
            if self._is_settled:
                self._seek_beside(frame, is_keyframe)

    @property
    def _is_settled(self) -> bool:
        """True if no recovery of the current map is due or under way: it is not given up for a place."""
        current = self.engine.store.current_id
        waits = self._restart is not None or any(job.new_id == current for job in self.jobs.running)
        return self.dual.place_merging is not None and not waits

    def _seek_beside(self, frame: Frame, is_keyframe: bool) -> None:
        """Seek the frames of a settled map in saved maps too; fuse with one in which they are confirmed.

        A search begins at a keyframe. It asks of the frames what a lost camera's must show.
        """
        engine, sought, probation = self.engine, self._sought, self.engine.search.probation
        if probation is not None and probation.frames[-1].features.index == frame.features.index:
            return  # offered before its recovery ended
        if probation is not None or (is_keyframe and sought):
            _, confirmed = engine.search.offer(engine.again(frame), sought, begin=is_keyframe)
            if confirmed is not None:
                self.merger.merge_found(confirmed.map_id, confirmed.frames)

    def _forget_joined(self) -> None:
        """End recoveries of maps that have been joined, also the one that is due."""
        store, restart, frame = self.engine.store, self._restart, self.engine.newest

        def is_joined(job: RecoveryJob) -> bool:
            return job.new_id not in store

        if frame is not None:
            self.jobs.cancel(frame, is_joined, "maps_are_joined")
        if restart is not None and restart.new is not None and restart.new.map.map_id not in store:
            self._restart, self.buffer.frozen = None, False

    # -- laboratory --------------------------------------------------------------------------------------

    def as_base(self) -> MonocularSlam:
        """Copy this system as the base system, which is identical until the first breakage.

        Raises:
            RuntimeError: there was a breakage or a cut, or the system is threaded.
        """
        engine = self.engine
        if engine.backend.mode is not ExecutionMode.LOCKSTEP:
            raise RuntimeError("a copy needs lockstep mode")
        if any(isinstance(event, ev.Breakage | ev.MapCut) for event in engine.events):
            raise RuntimeError("base and Dual-SLAM differ from the first breakage on")
        base = MonocularSlam(engine.camera, engine.seed, engine.config, engine.backend.mode)
        base.engine = deepcopy(engine)
        return base

    def cut(self) -> None:
        """Save the healthy map as at a breakage, then only buffer frames until :meth:`restart`.

        As at a breakage, a map with too few keyframes is dropped instead. The two methods make the crossing
        arm of a test of Eq. 1: recovery has to cross all frames in between, even those that tracking would
        have survived.

        Raises:
            RuntimeError: no map is being tracked.
        """
        newest = self.engine.newest
        if self.state is not TrackingState.TRACKING or newest is None:
            raise RuntimeError("there is no healthy map to cut")
        self.engine.backend.drain()
        self.engine.emit(newest, ev.MapCut)
        self._save_or_drop_map(newest)
        self._start_anew(newest, held=True)

    def restart(self) -> None:
        """Start a new map from the next frame on, after :meth:`cut`.

        Raises:
            RuntimeError: there was no cut before.
        """
        newest = self.engine.newest
        if self._restart is None or not self._restart.held or newest is None:
            raise RuntimeError("restart without a cut")
        self._restart.held = False
        self._restart.since = newest.features.index
        self.engine.emit(newest, ev.ReinitStart)


def _newest_frame(map_: Map) -> int:
    return max(map_.frame_index(int(k)) for k in map_.keyframes())
