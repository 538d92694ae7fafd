"""Dual-SLAM: save the map at a breakage, start a new one, recover backward, fuse.

Source: paper, Sec. II and III, Fig. 3.
"""

from collections import deque
from collections.abc import Iterable
from copy import deepcopy
from dataclasses import asdict, dataclass

import numpy as np

from slam.config import SlamConfig
from slam.core import events as ev
from slam.core.camera import PinholeCamera
from slam.core.events import TrackingState
from slam.core.frame import Frame
from slam.core.results import TrackingResult
from slam.dual.buffer import FeatureBuffer
from slam.dual.config import DualConfig
from slam.dual.fusion.map_merger import MapMerger
from slam.dual.recovery.interface import RecoveryResult
from slam.dual.recovery_jobs import NewMap, RecoveryJob, RecoveryJobs
from slam.initialization.initializer import InitialMap
from slam.map.map import Map
from slam.runtime.backend import ExecutionMode
from slam.system import MonocularSlam, MonocularSystem
from slam.tracking.tracker import TrackingOutcome


@dataclass
class Restart:
    """The way from a breakage to the recovery of the map that follows.

    Attributes:
        since: index of the frame of the breakage.
        recoverable: the buffer reaches a saved map, so that a recovery is due once the new map is fit.
        held: no map is sought until :meth:`DualSlam.restart`.
        new: the new map, once it is initialized.
    """

    since: int
    recoverable: bool
    held: bool = False
    new: NewMap | None = None


class DualSlam(MonocularSystem):
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
        super().__init__(camera, seed, config, mode)
        self.dual = dual or DualConfig()
        self.jobs = RecoveryJobs(self.dual, seed, mode, self.engine.emit_at)
        self.buffer = FeatureBuffer(self.dual.buffer_s, self.dual.buffer_cap_s, self.jobs.needs_images)
        self.merger = MapMerger(self.engine, self.dual.place_merging)
        self._restart: Restart | None = None  # since the last breakage, until its recovery is begun
        self._waiting: deque[NewMap] = deque()  # new maps whose recovery is due

    @property
    def settings(self) -> dict:
        """All settings, those of Dual-SLAM under ``dual``."""
        return {**super().settings, "dual": asdict(self.dual)}

    # -- Algorithm 1 -------------------------------------------------------------------------------------

    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult:
        """Process one frame; see :meth:`MonocularSystem.process`."""
        engine, is_keyframe = self.engine, False
        frame = engine.receive(image, stamp_s)
        if engine.state is TrackingState.TRACKING:
            outcome, is_keyframe = engine.track(frame)
            if not outcome.success:
                engine.declare_breakage(frame, outcome)
                self._save_or_drop_map(frame)
                self._start_anew(frame)
        elif self._restart is not None and self._restart.held:
            outcome = TrackingOutcome(False, 0, 0, "held")
        else:
            outcome = self._find_back(frame)
            if not (outcome.success or engine.search.undecided):
                outcome, is_keyframe = self._initialize(frame)
        engine.record(frame, outcome)
        self._fill_buffer(frame, image)
        self._fuse_recovered(frame, self.jobs.ended(frame))
        self._recover(frame, outcome)
        self._merge_by_place(frame, outcome)
        return engine.result(frame, outcome, is_keyframe)

    def finish(self) -> None:
        """Complete running and waiting recoveries, then end the input.

        Raises:
            Exception: the exception of a recovery or of mapping on its thread.
        """
        newest = self.engine.newest
        try:
            if newest is not None:
                self._fuse_recovered(newest, self.jobs.rest(newest))
                while self._waiting:
                    self._start_recovery(newest, self._waiting.popleft())
                    self._fuse_recovered(newest, self.jobs.rest(newest))
        finally:
            self.jobs.close()
            super().finish()

    # -- breakage ----------------------------------------------------------------------------------------

    def _save_or_drop_map(self, frame: Frame) -> None:
        """Save the map, or drop it if it is too small to be recovered from.

        The frames of a dropped map are still in the buffer: the next map's recovery goes back over them too.
        """
        engine, restart, running = self.engine, self._restart, self.jobs.running
        if restart is not None and restart.recoverable and restart.new is not None:
            if self._fit_for_recovery():
                self._waiting.append(restart.new)
                self._save(frame)
            else:
                engine.drop_map(frame, "broke_before_recovery")
        elif running is not None and running.new_id == engine.store.current_id:
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
        recoverable = self.jobs.possible and bool(self._reachable())
        self._restart = Restart(frame.features.index, recoverable, held)
        self.buffer.frozen = recoverable
        if not held:
            self.engine.emit(frame, ev.ReinitStart)

    def _find_back(self, frame: Frame) -> TrackingOutcome:
        """Relocalize the frame in saved maps; success if tracking goes on there."""
        engine, saved = self.engine, self.engine.store.saved
        sought = [] if self.jobs.running or not self.dual.relocalization else saved
        outcome = engine.relocalize(frame, sought[: self.dual.relocalization_maps])
        if outcome.success:
            saved.remove(engine.store.current_id)
            self.merger.skip_present_keyframes()
            self._restart, self.buffer.frozen = None, False
        return outcome

    def _initialize(self, frame: Frame) -> tuple[TrackingOutcome, bool]:
        """Try to initialize a new map; the outcome, and True if it succeeded."""
        outcome, initial = self.engine.initialize(frame)
        if initial is not None:
            self._note_new_map(initial)
        return outcome, initial is not None

    def _note_new_map(self, initial: InitialMap) -> None:
        self.engine.search.withdraw(initial.second, "new_map")
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

    def _reachable(self) -> list[int]:
        """Saved maps that the buffer reaches, newest first."""
        store = self.engine.store
        return [k for k in store.saved if self.buffer.reaches(_newest_frame(store[k]))]

    @property
    def _recovery_due(self) -> bool:
        """True if the map sought or tracked is to be recovered from once it is fit."""
        return self._restart is not None and self._restart.recoverable

    def _recover(self, frame: Frame, outcome: TrackingOutcome) -> None:
        """Start the recovery that is due, unless another one runs."""
        if self._waiting and not self.jobs.running:
            self._start_recovery(frame, self._waiting.popleft())
        tracking = outcome.success and self.state is TrackingState.TRACKING
        if not tracking or self.jobs.running or not self._recovery_due:
            return
        if self._fit_for_recovery() and self._restart is not None and self._restart.new is not None:
            new, self._restart = self._restart.new, None
            self._start_recovery(frame, new)

    def _start_recovery(self, frame: Frame, new: NewMap) -> None:
        """Start the recovery threads."""
        engine, store = self.engine, self.engine.store
        engine.backend.drain()
        self.buffer.frozen = self._recovery_due or bool(self._waiting)
        older = [k for k in store.saved if k < new.map.map_id]
        reachable = [store[k] for k in self._reachable() if k in older]
        if reachable:
            # Recovery runs beside tracking: even in lockstep it does not count as tracking's time.
            with engine.timer.apart():
                self.jobs.start(frame, new, reachable, self.buffer, engine.camera)
            self._fuse_recovered(frame, self.jobs.ended(frame))
        else:
            self.jobs.give_up(frame, new.map, older[0])

    # -- fusion ------------------------------------------------------------------------------------------

    def _fuse_recovered(self, frame: Frame, succeeded: Iterable[tuple[RecoveryJob, RecoveryResult]]) -> None:
        """Fuse the maps that recovery threads have aligned; only a recovery's first success counts."""
        for job, result in succeeded:
            if result.alignment is not None and job.new_id in self.engine.store:
                alignments = (*result.confirming, result.alignment)
                self.merger.merge_recovered(
                    frame, job.new_id, job.keyframes, job.points, result.map, result.frames, alignments
                )

    def _merge_by_place(self, frame: Frame, outcome: TrackingOutcome) -> None:
        """Fuse with a saved map whose place is recognised, if no recovery runs or is due."""
        tracking = outcome.success and self.state is TrackingState.TRACKING
        if tracking and not self.jobs.running and not self._recovery_due:
            self.merger.merge_by_place(frame)

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
