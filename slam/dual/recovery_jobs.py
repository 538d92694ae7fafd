"""Recovery jobs: build the threads' tasks, run the threads, emit their events."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from math import inf

import numpy as np

from dslab.slam.config import SlamConfig
from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import share_of_motion
from dslab.slam.core.seeds import rng_for
from dslab.slam.dual.buffer import FeatureBuffer
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.interface import RecoveryResult, RecoveryTask
from dslab.slam.dual.recovery.registry import build_thread
from dslab.slam.dual.recovery.scheduler import RecoveryRun, build_scheduler
from dslab.slam.features.remembered import Remembered
from dslab.slam.loop_closing.map_alignment import Alignment
from dslab.slam.map.map import Map
from dslab.slam.runtime.backend import ExecutionMode


@dataclass(frozen=True)
class NewMap:
    """Map initialized after a breakage.

    Attributes:
        map: the new map.
        first, second: the two frames that it was initialized from.
        since: index of the frame at which the search for a new map started.
    """

    map: Map
    first: Frame
    second: Frame
    since: int


@dataclass(frozen=True)
class Copies:
    """Copies of maps for a recovery.

    Attributes:
        old: of the saved maps that it may reach, newest first.
        starts: per thread a copy of the new map, its first frame in it, T_cam_last (4, 4) one frame backward.
        keyframes, points: rows of the new map.
    """

    old: tuple[Map, ...]
    starts: tuple[tuple[Map, Frame, np.ndarray], ...]
    keyframes: int
    points: int


@dataclass(eq=False)
class RecoveryJob:
    """Recovery of one breakage, by one or more threads.

    Attributes:
        new_id: the map that is extended backward.
        old_maps: copies of the saved maps that it may reach, newest first.
        keyframes, points: rows of the new map when it was copied.
        since: index of the frame of the breakage.
        buffered_frames: number of buffered frames before the new map.
        runs: of the threads that are still to be reported, in their order.
    """

    new_id: int
    old_maps: tuple[Map, ...]
    keyframes: int
    points: int
    since: int
    buffered_frames: int
    runs: list[RecoveryRun] = field(default_factory=list)

    @property
    def old_ids(self) -> tuple[int, ...]:
        """Ids of the saved maps, newest first."""
        return tuple(m.map_id for m in self.old_maps)


class RecoveryJobs:
    """Runs recoveries side by side and emits their events.

    Args:
        config: settings.
        system: settings of the system.
        seed, mode: the system's.
        emit: emits an event: the frame, the kind, the map, the kind's own fields.

    Attributes:
        running: the recoveries with threads that are still to be reported, the oldest first.
    """

    def __init__(
        self,
        config: DualConfig,
        system: SlamConfig,
        seed: int,
        mode: ExecutionMode,
        emit: Callable[..., None],
    ) -> None:
        self.running: list[RecoveryJob] = []
        self._system = system
        self._seed = seed
        self._exhaustive = config.exhaustive
        self._emit = emit
        self._threads = [(build_thread(spec), spec.seed) for spec in config.recovery_threads]
        self._scheduler = build_scheduler(mode, config.workers)

    @property
    def any_threads(self) -> bool:
        """True if there is at least one thread."""
        return bool(self._threads)

    @property
    def needs_images(self) -> bool:
        """True if any thread works on images."""
        return any(thread.needs_images for thread, _ in self._threads)

    def copies(self, new: NewMap, old_maps: Sequence[Map]) -> Copies:
        """Copy the maps for the threads, as they will change.

        Args:
            new: the map to be extended.
            old_maps: the saved maps that the buffer reaches, newest first.
        """
        starts = tuple(_ready_to_extend(new) for _ in self._threads)
        return Copies(tuple(m.copy() for m in old_maps), starts, new.map.n_keyframes, new.map.n_points)

    def start(
        self,
        frame: Frame,
        new: NewMap,
        copies: Copies,
        buffer: FeatureBuffer,
        camera: PinholeCamera,
        remembered: Remembered | None = None,
    ) -> None:
        """Start the threads.

        Args:
            frame: the newest frame.
            new: the map to be extended.
            copies: of it and of the saved maps, not to be used afterwards.
            buffer: the frames over which the threads go backward.
            camera: of these frames.
            remembered: what threads of copies of the system have found in images.
        """
        backward, images = tuple(buffer.backward_from(new.first.features.index)), buffer.images()
        sizes = (copies.keyframes, copies.points)
        job = RecoveryJob(new.map.map_id, copies.old, *sizes, new.since, len(backward))
        threads = zip(self._threads, copies.starts, strict=True)
        for number, ((thread, seed), (own, start, step)) in enumerate(threads, start=1):
            rng = rng_for(self._seed, "recovery", number, seed, new.since)
            task = RecoveryTask(
                own, start, backward, copies.old, step, rng, camera, images,
                system=self._system, remembered=remembered,
            )  # fmt: skip
            job.runs.append(RecoveryRun(number, thread, task, frame.features.stamp_s))
            self._scheduler.submit(job.runs[-1])
        self.running.append(job)
        self._start_runs(frame, frame.features.stamp_s)

    def give_up(self, frame: Frame, new_map: Map, old_map: Map) -> None:
        """Report every thread as failed: the buffer no longer reaches any saved map."""
        job = RecoveryJob(new_map.map_id, (old_map,), 0, 0, frame.features.index, 0)
        for number, (thread, _) in enumerate(self._threads, start=1):
            self._emit_start(frame, job, number, thread.name)
            result = RecoveryResult(new_map, stage="overlap", reason="buffer_exceeded")
            self._emit_end(frame, job, number, thread.name, result, 0.0)

    def ended(self, frame: Frame) -> Iterator[tuple[RecoveryJob, RecoveryResult]]:
        """Report the threads that have ended, those of a recovery in their order; yield each success at once.

        Raises:
            Exception: the exception of a thread.
        """
        return self._conclude(frame, frame.features.stamp_s)

    def rest(self, frame: Frame) -> Iterator[tuple[RecoveryJob, RecoveryResult]]:
        """Wait for all threads, doing as :meth:`ended`."""
        while self.running:
            self._scheduler.wait()
            yield from self._conclude(frame, inf)

    def cancel(self, frame: Frame, is_pointless: Callable[[RecoveryJob], bool], reason: str) -> None:
        """End recoveries on which nothing depends any more, unless every thread is to be run to its end."""
        if not self._exhaustive:
            for job in self.running:
                if is_pointless(job):
                    self._cancel_runs(frame, job, reason)
            self.running = [job for job in self.running if job.runs]

    def close(self) -> None:
        """Stop the worker threads, if there are any."""
        self._scheduler.close()

    def _conclude(self, frame: Frame, now_s: float) -> Iterator[tuple[RecoveryJob, RecoveryResult]]:
        while (found := self._next_ended(frame, now_s)) is not None:
            job, run = found
            del job.runs[0]
            result = run.execute()
            self._emit_end(frame, job, run.number, run.thread.name, result, run.cpu_ms)
            if result.success:
                if not self._exhaustive:
                    self._cancel_runs(frame, job, "not_needed")
                yield job, result
            self.running = [job for job in self.running if job.runs]

    def _next_ended(self, frame: Frame, now_s: float) -> tuple[RecoveryJob, RecoveryRun] | None:
        self._start_runs(frame, now_s)
        for job in self.running:
            if self._scheduler.has_ended(job.runs[0], now_s):
                return job, job.runs[0]
        return None

    def _start_runs(self, frame: Frame, now_s: float) -> None:
        for run in self._scheduler.start(now_s):
            job = next(job for job in self.running if run in job.runs)
            self._emit_start(frame, job, run.number, run.thread.name)

    def _cancel_runs(self, frame: Frame, job: RecoveryJob, reason: str) -> None:
        for run in job.runs:
            self._scheduler.cancel(run, frame.features.stamp_s)
            if run.started_s is not None:
                result = RecoveryResult(run.task.new_map, stage=ev.CANCELLED, reason=reason)
                self._emit_end(frame, job, run.number, run.thread.name, result, run.cpu_ms)
        job.runs = []

    def _emit_start(self, frame: Frame, job: RecoveryJob, number: int, method: str) -> None:
        self._emit(
            frame, ev.RecoveryStart, job.new_id,
            thread=number, method=method, old_map_id=job.old_ids[0], buffered_frames=job.buffered_frames,
        )  # fmt: skip

    def _emit_end(
        self, frame: Frame, job: RecoveryJob, number: int, method: str, result: RecoveryResult, cpu_ms: float
    ) -> None:
        found = result.alignment
        self._emit(
            frame,
            ev.RecoveryEnd,
            job.new_id,
            thread=number,
            method=method,
            old_map_id=found.old_map_id if found else job.old_ids[0],
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


def _ready_to_extend(new: NewMap) -> tuple[Map, Frame, np.ndarray]:
    """Copy of the new map, its first frame tracked in it, T_cam_last one frame backward."""
    own = new.map.copy()
    start = Frame(new.first.features)
    start.point[:] = own.observed_points(0)
    start.T_cam_map, start.T_cam_reference = own.T_cam_map(0), np.eye(4)
    start.reference_keyframe = 0
    steps = new.second.features.index - new.first.features.index
    motion = own.T_cam_map(0) @ np.linalg.inv(own.T_cam_map(1))
    return own, start, share_of_motion(motion, 1.0 / steps)
