"""Recovery jobs: build the threads' tasks, run the threads, emit their events."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from slam.core import events as ev
from slam.core.camera import PinholeCamera
from slam.core.frame import Frame
from slam.core.geometry import share_of_motion
from slam.core.seeds import rng_for
from slam.dual.buffer import FeatureBuffer
from slam.dual.config import DualConfig
from slam.dual.recovery.interface import RecoveryResult, RecoveryTask
from slam.dual.recovery.registry import build_thread
from slam.dual.recovery.scheduler import RecoveryScheduler, ThreadOutcome
from slam.loop_closing.map_alignment import Alignment
from slam.map.map import Map
from slam.runtime.backend import ExecutionMode


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
class RecoveryJob:
    """Recovery of one breakage, by one thread after another.

    Attributes:
        new_id: the map that is extended backward.
        old_ids: the saved maps that it may reach, newest first.
        keyframes, points: rows of the new map when it was copied.
        buffered_frames: number of buffered frames before the new map.
    """

    new_id: int
    old_ids: tuple[int, ...]
    keyframes: int
    points: int
    buffered_frames: int


class RecoveryJobs:
    """Runs recoveries, one at a time, and emits their events.

    Args:
        config: settings.
        seed, mode: the system's.
        emit: emits an event: the frame, the kind, the map, the kind's own fields.

    Attributes:
        running: the recovery with threads whose results are still to be handled, if any.
    """

    def __init__(self, config: DualConfig, seed: int, mode: ExecutionMode, emit: Callable[..., None]) -> None:
        self.running: RecoveryJob | None = None
        self._seed = seed
        self._mode = mode
        self._emit = emit
        self._threads = [(build_thread(spec), spec.seed) for spec in config.threads]
        self._scheduler = RecoveryScheduler(mode, config.exhaustive)

    @property
    def possible(self) -> bool:
        """True if there is at least one thread."""
        return bool(self._threads)

    @property
    def needs_images(self) -> bool:
        """True if any thread works on images."""
        return any(thread.needs_images for thread, _ in self._threads)

    def start(
        self,
        frame: Frame,
        new: NewMap,
        old_maps: Sequence[Map],
        buffer: FeatureBuffer,
        camera: PinholeCamera,
    ) -> None:
        """Start the threads.

        Args:
            frame: the newest frame.
            new: the map to be extended; each thread gets a copy of it.
            old_maps: the saved maps that the buffer reaches, newest first; they must not change meanwhile.
            buffer: the frames over which the threads go backward.
            camera: of these frames.
        """
        backward = tuple(buffer.backward_from(new.first.features.index))
        self.running = RecoveryJob(
            new.map.map_id,
            tuple(m.map_id for m in old_maps),
            new.map.n_keyframes,
            new.map.n_points,
            len(backward),
        )
        images = buffer.images()
        tasks = []
        for number, (_, seed) in enumerate(self._threads, start=1):
            own, start, step = _ready_to_extend(new)
            rng = rng_for(self._seed, "recovery", number, seed, new.since)
            old = self._for_thread(old_maps)
            tasks.append(RecoveryTask(own, start, backward, old, step, rng, camera, images))
        self._emit_start(frame, 1, self.running)
        self._scheduler.start([thread for thread, _ in self._threads], tasks, frame.features.stamp_s)

    def give_up(self, frame: Frame, new_map: Map, old_id: int) -> None:
        """Report every thread as failed: the buffer no longer reaches any saved map."""
        job = RecoveryJob(new_map.map_id, (old_id,), 0, 0, 0)
        for number, (thread, _) in enumerate(self._threads, start=1):
            self._emit_start(frame, number, job)
            result = RecoveryResult(new_map, stage="overlap", reason="buffer_exceeded")
            self._emit_end(frame, job, ThreadOutcome(number, thread.name, result, 0.0, 0.0, False))

    def ended(self, frame: Frame) -> Iterator[tuple[RecoveryJob, RecoveryResult]]:
        """Report the finished threads; yield each success before the next is reported.

        Raises:
            Exception: the exception of a thread.
        """
        return self._conclude(frame, self._scheduler.ended(frame.features.stamp_s))

    def rest(self, frame: Frame) -> Iterator[tuple[RecoveryJob, RecoveryResult]]:
        """Wait for all threads, then do as :meth:`ended`."""
        return self._conclude(frame, self._scheduler.rest())

    def close(self) -> None:
        """Stop the worker thread, if there is one."""
        self._scheduler.close()

    def _for_thread(self, old_maps: Sequence[Map]) -> list[Map]:
        """Saved maps that a thread can read beside tracking: copies in threaded mode."""
        return [m.copy() if self._mode is ExecutionMode.THREADED else m for m in old_maps]

    def _conclude(
        self, frame: Frame, outcomes: Iterable[ThreadOutcome]
    ) -> Iterator[tuple[RecoveryJob, RecoveryResult]]:
        for outcome in outcomes:
            job = self.running
            if job is None:
                raise RuntimeError("no recovery is under way")
            self._emit_end(frame, job, outcome)
            if outcome.result.success:
                yield job, outcome.result
            if outcome.is_last:
                self.running = None
            else:
                self._emit_start(frame, outcome.number + 1, job)

    def _emit_start(self, frame: Frame, number: int, job: RecoveryJob) -> None:
        self._emit(
            frame,
            ev.RecoveryStart,
            job.new_id,
            thread=number,
            method=self._threads[number - 1][0].name,
            old_map_id=job.old_ids[0],
            buffered_frames=job.buffered_frames,
        )

    def _emit_end(self, frame: Frame, job: RecoveryJob, outcome: ThreadOutcome) -> None:
        result, found = outcome.result, outcome.result.alignment
        self._emit(
            frame,
            ev.RecoveryEnd,
            job.new_id,
            thread=outcome.number,
            method=outcome.name,
            old_map_id=found.old_map_id if found else job.old_ids[0],
            success=result.success,
            stage=result.stage,
            reason=result.reason,
            frames_covered=result.frames_covered,
            frames_passed_over=result.frames_passed_over,
            inliers=result.inliers,
            cpu_ms=outcome.cpu_ms,
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
