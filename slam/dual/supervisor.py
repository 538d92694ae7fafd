"""Dual-SLAM: at a breakage, save the map, start another, recover backward, fuse.

Source: paper, Sec. II and III, Fig. 3.
"""

from dataclasses import asdict, dataclass, field

import numpy as np

from slam import events as ev
from slam._map_kernels import resolve_points
from slam.backend import ExecutionMode
from slam.camera import PinholeCamera
from slam.config import SlamConfig
from slam.dual.buffer import FeatureBuffer
from slam.dual.fusion import fuse
from slam.dual.orb_thread import OrbRecovery
from slam.dual.recovery import RecoveryConfig, RecoveryResult, RecoveryTask, RecoveryThread
from slam.frame import Frame
from slam.geometry import share_of_motion
from slam.initialization import InitialMap
from slam.map import Map
from slam.map_alignment import Alignment
from slam.seeds import rng_for
from slam.system import MonocularSlam
from slam.timing import StageTimer
from slam.tracking import TrackingOutcome


@dataclass(frozen=True)
class DualConfig:
    """Settings of Dual-SLAM.

    Attributes:
        buffer_s: span of the feature buffer; the paper finds 10 s to work well.
        buffer_cap_s: the most that it grows to before the new map stands.
        start_keyframes: keyframes of the new map when recovery starts: enough for a sound first geometry.
        recovery: settings of the recovery threads.
    """

    buffer_s: float = 10.0
    buffer_cap_s: float = 60.0
    start_keyframes: int = 5
    recovery: RecoveryConfig = field(default_factory=RecoveryConfig)


class DualSlam(MonocularSlam):
    """The base system with the paper's handling of tracking failure."""

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
        self._buffer = FeatureBuffer(self.dual.buffer_s, self.dual.buffer_cap_s)
        self._threads: list[RecoveryThread] = [OrbRecovery(self.dual.recovery)]
        self._saved: list[int] = []
        self._recovery_due = False
        self._broke_at = -1
        self._first: Frame | None = None
        self._second: Frame | None = None

    @property
    def settings(self) -> dict:
        """Every setting in force, those of Dual-SLAM under ``dual``."""
        return {**super().settings, "dual": asdict(self.dual)}

    # -- breakage ----------------------------------------------------------------------------------------

    def _break(self, frame: Frame, outcome: TrackingOutcome) -> None:
        """Save the map, unless it is too young to be worth it, and seek another.

        A new map that breaks before its recovery has run is dropped: the frames it had are in the buffer, and
        the next map's recovery goes back over them too.
        """
        self._emit(frame, ev.Breakage, reason=outcome.reason, inliers=outcome.inliers)
        if self._recovery_due:
            self._drop(frame, "broke_before_recovery")
        elif not self._drop_if_young(frame):
            m = self.current_map
            self._emit(frame, ev.MapSaved, keyframes=len(m.keyframes()), points=len(m.points()))
            self._saved.insert(0, self._map_id)
            self._broke_at = frame.features.index
            self._seek_new_map()
        self._recovery_due = bool(self._reachable())
        self._buffer.frozen = self._recovery_due
        self._emit(frame, ev.ReinitStart)

    def _reachable(self) -> list[int]:
        """Saved maps that the buffer goes back to, newest first."""
        return [k for k in self._saved if self._buffer.reaches(_newest_frame(self._maps[k]))]

    def _start_map(self, initial: InitialMap) -> None:
        super()._start_map(initial)
        self._first, self._second = initial.first, initial.second
        if self._recovery_due:
            taken = initial.second.features.index - self._broke_at
            self._emit(initial.second, ev.ReinitDone, frames_taken=taken)

    def _after_frame(self, frame: Frame, outcome: TrackingOutcome) -> None:
        self._buffer.append(frame.features)
        if (
            self._recovery_due
            and outcome.success
            and len(self.current_map.keyframes()) >= self.dual.start_keyframes
        ):
            self._recover(frame)

    # -- recovery ----------------------------------------------------------------------------------------

    def _recover(self, frame: Frame) -> None:
        """Run the recovery threads in order until one succeeds, and fuse; the breakage is then settled."""
        self._backend.drain()
        old_ids = self._reachable()
        for number, thread in enumerate(self._threads, start=1):
            if not old_ids:
                break
            result = self._run_thread(frame, number, thread, old_ids)
            if result.alignment is not None:
                self._fuse(frame, result, result.alignment)
                break
        self._recovery_due = False
        self._buffer.frozen = False

    def _run_thread(
        self, frame: Frame, number: int, thread: RecoveryThread, old_ids: list[int]
    ) -> RecoveryResult:
        task = self._task(number, old_ids)
        self._emit(
            frame,
            ev.RecoveryStart,
            thread=number,
            method=thread.name,
            old_map_id=old_ids[0],
            buffered_frames=sum(1 for _ in self._buffer.backward_from(task.first.features.index)),
        )
        timer = StageTimer()
        with timer("recovery"):
            result = thread.run(task)
        self._emit(
            frame,
            ev.RecoveryEnd,
            thread=number,
            method=thread.name,
            old_map_id=result.alignment.old_map_id if result.alignment else old_ids[0],
            success=result.success,
            stage=result.stage,
            reason=result.reason,
            frames_covered=result.frames_covered,
            frames_passed_over=result.frames_passed_over,
            inliers=result.inliers,
            cpu_ms=timer.cpu_ms["recovery"],
        )
        return result

    def _task(self, number: int, old_ids: list[int]) -> RecoveryTask:
        new_map = self.current_map.copy()
        first, second = self._first, self._second
        if first is None or second is None:
            raise RuntimeError("the new map has no first frames")
        start = Frame(first.features)
        start.point[:] = new_map.observed_points(0)
        start.T_cam_map, start.T_cam_reference = new_map.T_cam_map(0), np.eye(4)
        start.reference_keyframe = 0
        steps = second.features.index - first.features.index
        motion = new_map.T_cam_map(0) @ np.linalg.inv(new_map.T_cam_map(1))
        return RecoveryTask(
            new_map,
            start,
            tuple(self._buffer.backward_from(first.features.index)),
            [self._maps[k] for k in old_ids],
            share_of_motion(motion, 1.0 / steps),
            rng_for(self.seed, "recovery", number, self._broke_at),
            self.camera,
            _no_image,
        )

    # -- fusion ------------------------------------------------------------------------------------------

    def _fuse(self, frame: Frame, result: RecoveryResult, alignment: Alignment) -> None:
        """The old map takes in the new one as the recovery extended it; tracking goes on in the result."""
        old_id, new_id = alignment.old_map_id, self._map_id
        old = self._maps[old_id]
        seam_frame = old.frame_index(alignment.old_keyframe)
        keyframes, points = fuse(old, result.map, alignment, self.config.mapping)
        self._poses.join(old_id, new_id, keyframes, alignment.scale)
        for tracked in result.frames:
            if tracked.features.index > seam_frame:
                _shift(tracked, keyframes, points, alignment.scale)
                self._poses.add(old_id, tracked)
        self._forget(new_id)
        self._saved.remove(old_id)
        self._map_id = old_id
        self._continue_in(old, frame, keyframes, points, alignment.scale)
        self._emit(
            frame,
            ev.Fusion,
            old_map_id=old_id,
            accepted=True,
            scale=alignment.scale,
            inliers=alignment.inliers,
            reason="",
        )

    def _continue_in(self, old: Map, frame: Frame, keyframes: int, points: int, scale: float) -> None:
        tracker, mapper = self.tracker, self.mapper
        _shift(frame, keyframes, points, scale)
        resolve_points(old.arrays, frame.point)
        if tracker.velocity is not None:
            tracker.velocity[:3, 3] *= scale
        tracker.rebase(old, frame)
        mapper.rebase(old, points)


def _no_image(index: int) -> np.ndarray:
    raise KeyError(f"frame {index} is not held as an image")


def _newest_frame(map_: Map) -> int:
    return max(map_.frame_index(int(k)) for k in map_.keyframes())


def _shift(frame: Frame, keyframes: int, points: int, scale: float) -> None:
    """Re-express a tracked frame in the map that has absorbed its own."""
    frame.reference_keyframe += keyframes
    frame.point[frame.point >= 0] += points
    frame.T_cam_reference = frame.T_cam_reference.copy()
    frame.T_cam_reference[:3, 3] *= scale
