"""Recovery jobs: Algorithm 1 for every breakage, beside tracking; its events. Source: paper, Sec. III-B."""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from math import inf

import numpy as np

from dslab.slam.core import events as ev
from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import share_of_motion
from dslab.slam.core.seeds import rng_for
from dslab.slam.dual.buffer import FeatureBuffer
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.fusion.merge_recovered import Recovered
from dslab.slam.dual.phases import Restarting
from dslab.slam.dual.recovery.interface import RecoveryResult, RecoveryTask
from dslab.slam.dual.recovery.registry import build_thread
from dslab.slam.dual.recovery.scheduler import RecoveryRun, build_scheduler
from dslab.slam.engine import SlamEngine
from dslab.slam.loop_closing.map_alignment import Alignment
from dslab.slam.map.map import Map


@dataclass(eq=False)
class RecoveryJob:
    """Recovery of one breakage, by one or more threads, on copies of the maps.

    Attributes:
        new: of the map that is extended backward.
        old_maps: copies of the saved maps that it may reach, newest first.
        starts: per thread a copy of the new map, its first frame in it, T_cam_last (4, 4) one frame backward.
        keyframes, points: rows of the new map when it was copied.
        buffered_frames: number of buffered frames before the new map.
        runs: of the threads, in their order; none before the start. Those whose result was returned are gone.
        has_succeeded: a result was returned.
    """

    new: Restarting
    old_maps: tuple[Map, ...]
    starts: tuple[tuple[Map, Frame, np.ndarray], ...]
    keyframes: int
    points: int
    buffered_frames: int = 0
    runs: list[RecoveryRun] = field(default_factory=list)
    has_succeeded: bool = False

    @property
    def new_id(self) -> int:
        """Id of the new map."""
        return self.new.map.map_id

    @property
    def open_runs(self) -> list[RecoveryRun]:
        """Runs whose end is still to be reported."""
        return [run for run in self.runs if not run.is_over]


@dataclass(frozen=True)
class RecoveryFailure:
    """No thread of a recovery has succeeded: the maps stay apart, unless their places are recognised later.

    Attributes:
        new_id: the map from which it went backward.
        since: index of the frame of the breakage.
        reasons: per thread the stage that failed and why, as in its ``recovery_end``.
    """

    new_id: int
    since: int
    reasons: tuple[tuple[str, str], ...]


def algorithm_1(job: RecoveryJob) -> Recovered | RecoveryFailure | None:
    """Algorithm 1 of the paper: the first thread that succeeds, in their order, else failure.

    It is asked at every frame. The threads run beside tracking meanwhile, a later one ahead of its turn where
    there are workers, as what comes of it counts only in its turn.

    Returns:
        The new map as extended backward, aligned with an old one; failure; None as long as threads run.
    """
    for run in job.runs:  # line 2: recovery thread 1; line 14: recovery thread 2
        if not run.is_over:
            return None  # lines 3-10, 16-20: propagate() is on its way back over the buffer
        result = run.execute()
        if result.success and result.alignment is not None:  # line 11; line 21: successful: return 3D-points
            alignments = (*result.confirming, result.alignment)
            return Recovered(
                job.new_id, result.map, job.keyframes, job.points,
                result.frames, job.old_maps, alignments, job.new.since,
            )  # fmt: skip
    reasons = tuple((run.execute().stage, run.execute().reason) for run in job.runs)
    return RecoveryFailure(job.new_id, job.new.since, reasons)  # line 23: else return failure


class RecoveryJobs:
    """Runs recoveries side by side and emits their events.

    Args:
        config: settings.
        engine: of the maps.

    Attributes:
        buffer: of the features of the last frames.
        running: the recoveries with threads that are still to be reported, the oldest first.
        failures: the recoveries none of whose threads has succeeded, in the order of their ends.
    """

    def __init__(self, config: DualConfig, engine: SlamEngine) -> None:
        self.running: list[RecoveryJob] = []
        self.failures: list[RecoveryFailure] = []
        self._engine = engine
        self._exhaustive = config.exhaustive
        self._threads = [(build_thread(spec), spec.seed) for spec in config.recovery_threads]
        self._scheduler = build_scheduler(engine.backend.mode, config.workers)
        with_images = any(thread.needs_images for thread, _ in self._threads)
        self.buffer = FeatureBuffer(config.buffer_s, config.buffer_cap_s, with_images)

    @property
    def any_threads(self) -> bool:
        """True if there is at least one thread."""
        return bool(self._threads)

    def reachable(self, new: Restarting | None = None) -> list[int]:
        """Saved maps that the buffer reaches, newest first; those older than a new map, if one is given."""
        store = self._engine.store
        older = [k for k in store.saved if new is None or k < new.map.map_id]
        return [k for k in older if self.buffer.reaches(_newest_frame(store[k]))]

    def are_extending(self, map_id: int) -> bool:
        """Return True if a map is being extended backward."""
        return any(job.new_id == map_id for job in self.running)

    def copies(self, new: Restarting, reachable: Sequence[int]) -> RecoveryJob:
        """Copy the maps for the threads, as they will change.

        Args:
            new: of the map to be extended.
            reachable: the saved maps that the buffer reaches, newest first; those that are gone are left out.
        """
        store, m = self._engine.store, new.map
        olds = tuple(store[k].copy() for k in reachable if k in store)
        starts = tuple(_ready_to_extend(new) for _ in self._threads)
        return RecoveryJob(new, olds, starts, m.n_keyframes, m.n_points)

    def start(self, job: RecoveryJob) -> None:
        """Start the threads; they fail at once if the buffer no longer reaches a saved map."""
        engine, new, now_s = self._engine, job.new, self._now_s
        older = [k for k in engine.store.saved if k < job.new_id]
        if not job.old_maps:
            if older:
                self._give_up(job, older[0])
            return
        backward, images = tuple(self.buffer.backward_from(new.first.features.index)), self.buffer.images()
        job.buffered_frames = len(backward)
        threads = zip(self._threads, job.starts, strict=True)
        for number, ((thread, seed), (own, start, step)) in enumerate(threads, start=1):
            rng = rng_for(engine.seed, "recovery", number, seed, new.since)
            task = RecoveryTask(
                own, start, backward, job.old_maps, step, rng, engine.camera, images,
                motion=copy(engine.tracker.motion), system=engine.config, remembered=engine.remembered,
            )  # fmt: skip
            job.runs.append(RecoveryRun(number, thread, task, now_s))
            self._scheduler.submit(job.runs[-1])
        job.starts = ()
        self.running.append(job)
        self._start_runs(now_s)

    def ended(self) -> Iterator[Recovered]:
        """Report the threads that have ended, those of a recovery in their order; yield each success at once.

        Raises:
            Exception: the exception of a thread.
        """
        return self._conclude(self._now_s)

    def rest(self) -> Iterator[Recovered]:
        """Wait for all threads, doing as :meth:`ended`."""
        while self.running:
            self._scheduler.wait()
            yield from self._conclude(inf)

    def cancel(self, reason: str) -> None:
        """End the recoveries of maps that are gone, unless every thread is to be run to its end."""
        if not self._exhaustive:
            for job in self.running:
                if job.new_id not in self._engine.store:
                    self._cancel_runs(job, reason)
            self._forget_ended()

    def close(self) -> None:
        """Stop the worker threads, if there are any."""
        self._scheduler.close()

    def _give_up(self, job: RecoveryJob, old_id: int) -> None:
        """Report every thread as failed, and with them the recovery."""
        result = RecoveryResult(job.new.map, stage="overlap", reason="buffer_exceeded")
        for number, (thread, _) in enumerate(self._threads, start=1):
            self._emit_start(job, number, thread.name, old_id)
            self._emit_end(job, number, thread.name, result, 0.0, old_id)
        reasons = ((result.stage, result.reason),) * len(self._threads)
        self.failures.append(RecoveryFailure(job.new_id, job.new.since, reasons))

    @property
    def _now_s(self) -> float:
        return self._engine.newest.features.stamp_s

    def _conclude(self, now_s: float) -> Iterator[Recovered]:
        while (found := self._next_ended(now_s)) is not None:
            job, run = found
            result, run.is_over = run.execute(), True
            self._emit_end(job, run.number, run.thread.name, result, run.cpu_ms)
            outcome = algorithm_1(job)
            if isinstance(outcome, Recovered):
                # If all are run to their end: what would the others have returned without this one?
                job.runs, job.has_succeeded = job.open_runs, True
                if not self._exhaustive:
                    self._cancel_runs(job, "not_needed")
                yield outcome
            elif outcome is not None and not job.has_succeeded:
                self.failures.append(outcome)
            self._forget_ended()

    def _forget_ended(self) -> None:
        self.running = [job for job in self.running if job.open_runs]

    def _next_ended(self, now_s: float) -> tuple[RecoveryJob, RecoveryRun] | None:
        """The next run in the order of its job that has ended by now."""
        self._start_runs(now_s)
        for job in self.running:
            if self._scheduler.has_ended(job.open_runs[0], now_s):
                return job, job.open_runs[0]
        return None

    def _start_runs(self, now_s: float) -> None:
        for run in self._scheduler.start(now_s):
            job = next(job for job in self.running if run in job.runs)
            self._emit_start(job, run.number, run.thread.name, job.old_maps[0].map_id)

    def _cancel_runs(self, job: RecoveryJob, reason: str) -> None:
        for run in job.open_runs:
            self._scheduler.cancel(run, self._now_s)
            if run.started_s is not None:
                result = RecoveryResult(run.task.new_map, stage=ev.CANCELLED, reason=reason)
                self._emit_end(job, run.number, run.thread.name, result, run.cpu_ms)
        job.runs = []

    def _emit_start(self, job: RecoveryJob, number: int, method: str, old_id: int) -> None:
        self._engine.emit_now(
            ev.RecoveryStart, job.new_id,
            thread=number, method=method, old_map_id=old_id, buffered_frames=job.buffered_frames,
        )  # fmt: skip

    def _emit_end(
        self,
        job: RecoveryJob,
        number: int,
        method: str,
        result: RecoveryResult,
        cpu_ms: float,
        old_id: int | None = None,
    ) -> None:
        found = result.alignment
        if old_id is None:
            old_id = found.old_map_id if found else job.old_maps[0].map_id
        self._engine.emit_now(
            ev.RecoveryEnd,
            job.new_id,
            thread=number,
            method=method,
            old_map_id=old_id,
            success=result.success,
            stage=result.stage,
            reason=result.reason,
            frames_covered=result.frames_covered,
            frames_passed_over=result.frames_passed_over,
            inliers=result.inliers,
            cpu_ms=cpu_ms,
            placed=placed_keyframes(result.map, job.keyframes, found) if found else (),
        )


def placed_keyframes(extended: Map, keyframes: int, found: Alignment) -> tuple[ev.PlacedKeyframe, ...]:
    """Poses of the new map's keyframes in the old map, by a recovery's alignment.

    Args:
        extended: the recovery's copy of the new map, as extended.
        keyframes: number of keyframes when it started; those culled since are placed by their reference.
        found: the alignment of the copy with the old map.
    """
    placed = []
    for k in range(keyframes):
        T_old_cam = found.S_old_new @ np.linalg.inv(extended.T_cam_map(k))
        T_old_cam[:3, :3] /= found.scale
        features, rows = extended.features(k), tuple(map(tuple, T_old_cam.tolist()))
        placed.append(ev.PlacedKeyframe(features.index, features.stamp_s, rows))
    return tuple(placed)


def _newest_frame(map_: Map) -> int:
    return max(map_.frame_index(int(k)) for k in map_.keyframes())


def _ready_to_extend(new: Restarting) -> tuple[Map, Frame, np.ndarray]:
    """Copy of the new map, its first frame tracked in it, T_cam_last one frame backward."""
    own = new.map.copy()
    start = Frame(new.first.features)
    start.point[:] = own.observed_points(0)
    start.T_cam_map, start.T_cam_reference = own.T_cam_map(0), np.eye(4)
    start.reference_keyframe = 0
    steps = new.second.features.index - new.first.features.index
    motion = own.T_cam_map(0) @ np.linalg.inv(own.T_cam_map(1))
    return own, start, share_of_motion(motion, 1.0 / steps)
