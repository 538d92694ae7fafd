"""Dual-SLAM: save the map at a breakage, start a new one, recover backward, fuse.

Source: paper, Sec. II and III, Fig. 3.
"""

from copy import deepcopy
from dataclasses import asdict
from functools import partial

import numpy as np

from dslab.slam.belief.config import BeliefConfig
from dslab.slam.config import SlamConfig
from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import TrackingState
from dslab.slam.core.frame import Frame
from dslab.slam.core.results import TrackingResult
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.fusion.map_merger import MapMerger
from dslab.slam.dual.fusion.merge_recovered import RecoveredFusion
from dslab.slam.dual.fusion.place_merging import PlaceFusion, PlaceMerger
from dslab.slam.dual.phases import Held, Lost, Phase, Restarting, Starting, Tracking
from dslab.slam.dual.recovery_jobs import RecoveryJob, RecoveryJobs
from dslab.slam.map.map import Map
from dslab.slam.runtime.backend import ExecutionMode, MapChange
from dslab.slam.system import MonocularSlam, MonocularSystem
from dslab.slam.tracking.tracker import TrackingOutcome


class DualSlam(MonocularSystem):
    """SLAM with backward recovery and map fusion after a breakage.

    There are several ways home, and the first one counts: the recoveries, of which several may run at a time;
    the places of a new map's keyframes in saved maps; and those of its frames, before and after recoveries. A
    new map that breaks while its recovery runs is saved, and still fused if that succeeds.

    Attributes:
        phase: where it stands with the current map.
        jobs: the recoveries, which run beside.
        buffer: of the features of the last frames.
        merger: of the maps.
        places: recognises saved maps by keyframes; None for never.
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
        self.phase: Phase = Starting()
        self.jobs = RecoveryJobs(self.dual, self.engine)
        self.buffer = self.jobs.buffer
        self.merger = MapMerger(self.engine, self.note_fusion)
        joins = self.dual.place_merging
        beliefs = self.engine.config.belief or BeliefConfig()
        self.places = PlaceMerger(joins, beliefs, seed) if joins else None

    @property
    def settings(self) -> dict:
        """All settings, those of Dual-SLAM under ``dual``."""
        return {**super().settings, "dual": asdict(self.dual)}

    # -- Sec. III of the paper ---------------------------------------------------------------------------

    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult:
        """Process one frame; see :meth:`MonocularSystem.process`."""
        engine, is_keyframe = self.engine, False
        frame = engine.receive(image, stamp_s)
        match self.phase:
            case Tracking() | Restarting():
                frame, outcome, is_keyframe = self._track(frame)
            case Held():
                outcome = TrackingOutcome(False, 0, 0, "held")
            case Lost() | Starting():
                frame, outcome = self._find_back(frame)
                if not (outcome.success or engine.search.undecided):
                    outcome, is_keyframe = self._initialize(frame)
        engine.record(frame, outcome)
        self.buffer.undistort_with(engine.camera)
        self.buffer.append(frame.features, image)  # Sec. III-A
        for recovered in self.jobs.ended():  # Sec. III-B, Algorithm 1
            engine.backend.beside(RecoveredFusion(self.merger, recovered))  # Sec. III-C
        self._recover(outcome)
        self._merge_by_place(frame, outcome)
        return engine.result(frame, outcome, is_keyframe)

    def finish(self) -> None:
        """Complete running and waiting recoveries, then end the input.

        Raises:
            Exception: the exception of a recovery or of mapping on its thread.
        """
        try:
            for recovered in self.jobs.rest():
                self.engine.backend.beside(RecoveredFusion(self.merger, recovered))
                self.engine.backend.drain()
        finally:
            self.jobs.close()
            super().finish()

    def _enter(self, phase: Phase) -> None:
        self.phase, self.buffer.frozen = phase, phase.recoverable

    # -- the current map ---------------------------------------------------------------------------------

    def _track(self, frame: Frame) -> tuple[Frame, TrackingOutcome, bool]:
        """Track the current map; the frame with its pose, the outcome, and True if it is a keyframe."""
        engine = self.engine
        outcome, is_keyframe = engine.track(frame)
        if engine.is_begun_wrong:
            outcome, is_keyframe = self._drop_wrong_map(frame, outcome), False
        elif not outcome.success:
            engine.declare_breakage(frame, outcome)
            self._save_or_drop_map(frame)
            self._lose(frame)
        elif self._is_new_and_small or (engine.search.probation is not None and not self._is_settled):
            frame, outcome = self._find_back(frame, outcome)
        if outcome.success and self._is_begun_smeared(frame):
            outcome, is_keyframe = self._begin_again(frame, outcome), False
        return frame, outcome, is_keyframe

    def _save_or_drop_map(self, frame: Frame) -> None:
        """Save the map, or drop it if it is too small to be recovered from.

        The frames of a dropped map are still in the buffer: the next map's recovery goes back over them too.
        """
        engine, phase = self.engine, self.phase
        if isinstance(phase, Restarting) and phase.recoverable:
            if not self._fit_for_recovery:
                engine.drop_map(frame, "broke_before_recovery")
                return
            start = RecoveryStart(self, phase)
            with engine.timer.apart():
                start.prepare()
                start.commit()
        elif not self.jobs.are_extending(engine.store.current_id) and engine.is_young:
            engine.drop_map(frame, "too_few_keyframes")
            return
        m = engine.store.current
        engine.emit(frame, ev.MapSaved, keyframes=len(m.keyframes()), points=len(m.points()))
        engine.store.save_current()
        engine.lose(frame)
        engine.seek_new_map()

    def _lose(self, frame: Frame, kind: type[Lost] = Lost) -> None:
        """Seek a new map from the next frames on, unless it is held."""
        self._enter(kind(frame.features.index, self.jobs.any_threads and bool(self.jobs.reachable())))
        if kind is not Held:
            self.engine.emit(frame, ev.ReinitStart)

    def _is_begun_smeared(self, frame: Frame) -> bool:
        """Note a frame of a new map; True if a recovery would start from a map whose frames are smeared."""
        phase = self.phase
        if not (isinstance(phase, Restarting) and phase.is_due):
            return False
        phase.noise.append(frame.noise)
        return self._fit_for_recovery and float(np.median(phase.noise)) > self.dual.max_start_noise

    def _begin_again(self, frame: Frame, outcome: TrackingOutcome) -> TrackingOutcome:
        """Drop a map begun from smeared frames, and seek another one for the recovery that was due."""
        engine, phase = self.engine, self.phase
        engine.backend.drain()
        if self.phase is not phase:  # joined meanwhile
            return outcome
        engine.drop_map(frame, "smeared")
        self._seek_another(frame)
        return TrackingOutcome(False, outcome.inliers, outcome.matches, "smeared")

    def _drop_wrong_map(self, frame: Frame, outcome: TrackingOutcome) -> TrackingOutcome:
        """Drop a map begun from the wrong motion, and seek another one for the recovery that goes with it."""
        outcome = self.engine.drop_wrong_map(frame, outcome)
        if not outcome.success:
            self.jobs.cancel("map_dropped")
            self._seek_another(frame)
        return outcome

    def _seek_another(self, frame: Frame) -> None:
        """Seek another map in place of a dropped one, for the same recovery if one was due."""
        if isinstance(self.phase, Restarting):
            self.engine.emit(frame, ev.ReinitStart)
            self._enter(Lost(self.phase.since, self.phase.recoverable))
        elif self.engine.store.saved:
            self._lose(frame)
        else:
            self._enter(Starting())

    # -- back in a saved map, or a new one ---------------------------------------------------------------

    @property
    def _sought(self) -> list[int]:
        """Saved maps in which frames are sought."""
        return self.engine.store.saved[: self.dual.relocalization_maps] if self.dual.relocalization else []

    @property
    def _fit_for_recovery(self) -> bool:
        return len(self.current_map.keyframes()) >= self.dual.start_keyframes

    @property
    def _is_new_and_small(self) -> bool:
        """True if a new map is tracked from which no recovery can start yet."""
        return isinstance(self.phase, Restarting) and not self._fit_for_recovery

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
        engine.store.saved.remove(engine.store.current_id)
        self._skip_present_keyframes()
        self._enter(Tracking())
        self.jobs.cancel("returned_to_saved_map")
        return again, found

    def _initialize(self, frame: Frame) -> tuple[TrackingOutcome, bool]:
        """Try to initialize a new map; the outcome, and True if it succeeded."""
        engine, lost = self.engine, self.phase
        outcome, initial = engine.initialize(frame)
        if initial is None:
            return outcome, False
        self._skip_present_keyframes()
        self._enter(Tracking())
        if isinstance(lost, Lost):
            self._enter(Restarting(initial.map, initial.first, initial.second, lost.since, lost.recoverable))
            taken = initial.second.features.index - lost.since
            engine.emit(initial.second, ev.ReinitDone, frames_taken=taken)
        return outcome, True

    def _skip_present_keyframes(self) -> None:
        """Search no place of a keyframe that the current map has now."""
        if self.places is not None:
            self.places.skip(self.engine.store.current)

    # -- recovery and fusion -----------------------------------------------------------------------------

    def _recover(self, outcome: TrackingOutcome) -> None:
        """Start the recovery that is due, as soon as mapping and loop closing have done what they are at."""
        phase = self.phase
        if isinstance(phase, Restarting) and phase.is_due and outcome.success and self._fit_for_recovery:
            phase.starting = True
            # Recovery runs beside tracking: even in lockstep it does not count as tracking's time.
            with self.engine.timer.apart():
                self.engine.backend.beside(RecoveryStart(self, phase))

    def begin_recovery(self, job: RecoveryJob) -> None:
        """Start the threads of the recovery that was due; from now on no other is."""
        self._enter(Tracking())
        self.jobs.start(job)

    def note_fusion(self, fused: Map) -> None:
        """End recoveries of maps that have been joined, also the one that is due; places are sought anew."""
        if self.places is not None:
            if fused.map_id == self.engine.store.current_id:
                self.places.skip(fused)
            self.places.reset_alignments()
        self.jobs.cancel("maps_are_joined")
        if isinstance(self.phase, Restarting) and self.phase.map.map_id not in self.engine.store:
            self._enter(Tracking())

    def _merge_by_place(self, frame: Frame, outcome: TrackingOutcome) -> None:
        """Fuse with a saved map whose place is recognised."""
        engine, places = self.engine, self.places
        if places is None or not outcome.success:
            return
        if engine.store.saved and places.is_due(engine.store.current):
            engine.backend.beside(PlaceFusion(self.merger, places))
        probation = engine.search.probation
        if probation is not None and self._is_settled:  # its place is sought by keyframes now
            engine.search.reject(probation, frame, "another_map_is_tracked")

    @property
    def _is_settled(self) -> bool:
        """True if no recovery of the current map is due or under way: it is not given up for a place."""
        waits = not isinstance(self.phase, Tracking) or self.jobs.are_extending(self.engine.store.current_id)
        return self.places is not None and not waits

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
        if self.state is not TrackingState.TRACKING:
            raise RuntimeError("there is no healthy map to cut")
        newest = self.engine.newest
        self.engine.backend.drain()
        self.engine.emit(newest, ev.MapCut)
        self._save_or_drop_map(newest)
        self._lose(newest, Held)

    def restart(self) -> None:
        """Start a new map from the next frame on, after :meth:`cut`.

        Raises:
            RuntimeError: there was no cut before.
        """
        if not isinstance(self.phase, Held):
            raise RuntimeError("restart without a cut")
        newest = self.engine.newest
        self._enter(Lost(newest.features.index, self.phase.recoverable))
        self.engine.emit(newest, ev.ReinitStart)


class RecoveryStart(MapChange):
    """Start of the recovery that is due: maps are copied beside tracking, then its threads start."""

    def __init__(self, system: DualSlam, due: Restarting) -> None:
        self._system = system
        self._due = due
        self._reachable = system.jobs.reachable(due)
        self._job: RecoveryJob | None = None

    def prepare(self) -> bool:
        """Copy the maps for the recovery threads."""
        self._job = self._system.jobs.copies(self._due, self._reachable)
        return True

    def is_still_valid(self) -> bool:
        """Return True unless the maps were joined since the recovery was due."""
        return self._system.phase is self._due

    def commit(self) -> None:
        """Start the threads."""
        if self._job is not None:
            self._system.begin_recovery(self._job)
