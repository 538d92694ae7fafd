"""Backend: local mapping, loop closing and self-calibration, in lockstep or in threads.

In lockstep mode each keyframe is processed before the next frame. In threaded mode mapping and loop closing
have a thread each; they change the map step by step under a lock. Changes to anything else (poses of frames,
the tracker, events) are handed to the tracking thread, which applies them between two frames. So is what is
made on a copy of a map: a corrected loop, a fusion.
"""

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Frame
from dslab.slam.core.timing import StageTimer
from dslab.slam.loop_closing.correction import Loop, correct_loop
from dslab.slam.loop_closing.detection import LoopDetector, Refusal
from dslab.slam.loop_closing.global_adjustment import adjust_globally
from dslab.slam.map.adjustment import MapAdjustment
from dslab.slam.map.map import Map
from dslab.slam.mapping.local_mapping import LocalMapper
from dslab.slam.mapping.self_calibration import Refinement, SelfCalibration
from dslab.slam.runtime.worker import Worker


class ExecutionMode(StrEnum):
    """Mode in which tracking, mapping and loop closing share time."""

    LOCKSTEP = "lockstep"
    THREADED = "threaded"


@dataclass(eq=False)
class KeyframeTask:
    """A frame that is to become a keyframe.

    Attributes:
        frame: as tracked; mapping works on a copy of it.
        mapper, detector: of its map.
        rng: stream of loop detection.
        camera: the one so far, if lens and shutter are to be estimated from the map; else None.
        keyframe: its row in the map, -1 while it waits for mapping.
    """

    frame: Frame
    mapper: LocalMapper
    detector: LoopDetector
    rng: np.random.Generator
    camera: PinholeCamera | None = None
    keyframe: int = -1

    def rebase(self, detector: LoopDetector, keyframes: int) -> None:
        """Go on in a map that has absorbed its own, where the rows of keyframes begin at ``keyframes``."""
        self.detector = detector
        if self.keyframe >= 0:
            self.keyframe += keyframes


@dataclass(frozen=True)
class Mapped:
    """The frame has become a keyframe and the map has grown."""

    frame: Frame
    keyframe: int
    cpu_ms: float


@dataclass(frozen=True)
class Corrected:
    """A loop was found; ``corrected_map`` is the corrected copy, ``factor`` see :func:`correct_loop`."""

    task: KeyframeTask
    loop: Loop
    corrected_map: Map
    factor: np.ndarray
    cpu_ms: float


@dataclass(frozen=True)
class Adjusted:
    """Global bundle adjustment after a loop closure has ended."""

    task: KeyframeTask
    loop: Loop
    adjustment: MapAdjustment
    cpu_ms: float


@dataclass(frozen=True)
class Refused:
    """A loop was found and refused."""

    task: KeyframeTask
    refusal: Refusal


@dataclass(frozen=True)
class Searched:
    """Loop detection has found no loop."""

    cpu_ms: float


@dataclass(frozen=True)
class Calibrated:
    """The lens was estimated; ``refinement`` is None if it stays as it is."""

    task: KeyframeTask
    refinement: Refinement | None
    cpu_ms: float


class MapChange(ABC):
    """A change of maps that is prepared beside tracking, on copies, and committed between two frames.

    Attributes:
        stage: name under which the time of its commit is measured; empty for none.
    """

    stage = ""

    @abstractmethod
    def prepare(self) -> bool:
        """Make the change on copies; False if there is nothing to commit.

        It changes no map, and may read and copy maps without the lock.
        """

    @abstractmethod
    def is_still_valid(self) -> bool:
        """Return True if what it was prepared for still stands; asked just before the commit."""

    @abstractmethod
    def commit(self) -> None:
        """Put what was prepared in the place of what it was copied from."""


Change = Mapped | Corrected | Adjusted | Refused | Searched | Calibrated | MapChange


@dataclass
class _Pending:
    change: Change
    applied: threading.Event = field(default_factory=threading.Event)


class Backend:
    """Processes keyframes in the order in which they come.

    Args:
        apply: called with every change, always on the thread that calls this object.
        mode: see the module.
        calibration: estimates the lens.

    Attributes:
        lock: to be held while reading the map when mapping may run.
        newest: the keyframe submitted last, if any.
        in_work: the keyframes that mapping or loop closing have not done with, the oldest first.
    """

    def __init__(
        self,
        apply: Callable[[Change], None],
        mode: ExecutionMode,
        calibration: SelfCalibration | None = None,
    ) -> None:
        threaded = mode is ExecutionMode.THREADED
        self.mode = mode
        self.lock: AbstractContextManager = threading.RLock() if threaded else nullcontext()
        self.newest: KeyframeTask | None = None
        self.in_work: list[KeyframeTask] = []
        self._apply = apply
        self._calibration = calibration
        # Held while keyframes and points may be added or removed.
        self._gate: AbstractContextManager = threading.Lock() if threaded else nullcontext()
        self._pending: deque[_Pending] = deque()
        self._news = threading.Event() if threaded else None
        self._workers = (Worker("mapping"), Worker("loop closing")) if threaded else None

    @property
    def idle(self) -> bool:
        """True if mapping would start on a keyframe at once."""
        return self._workers is None or self._workers[0].pending == 0

    def submit(self, task: KeyframeTask) -> None:
        """Make a keyframe, extend the map, detect a loop and close it.

        Raises:
            Exception: the exception of an earlier task on its thread.
        """
        self.newest = task
        self.in_work.append(task)
        self._on(0, lambda: self._map(task))

    def beside(self, change: MapChange) -> None:
        """Prepare a change after what was submitted before, to be committed between two frames.

        No keyframe or point is added or removed from the beginning of the preparation to the end of the
        commit: tracking goes on, and keyframes that it asks for meanwhile wait.

        Raises:
            Exception: the exception of an earlier task on its thread.
        """
        self._on(1, lambda: self._prepare(change))

    def collect(self) -> None:
        """Apply the changes handed over by the threads since the last call; none in lockstep."""
        while self._pending:
            pending = self._pending.popleft()
            try:
                self._apply(pending.change)
            finally:  # whoever waits for it must not wait for ever
                pending.applied.set()

    def drain(self) -> None:
        """Wait until every keyframe has been processed, and apply the changes."""
        if self._workers is None or self._news is None:
            return
        while any(worker.pending for worker in self._workers):
            self._news.wait(0.002)
            self._news.clear()
            self.collect()
        for worker in self._workers:
            worker.drain()
        self.collect()

    def close(self) -> None:
        """Wait for pending work and stop the threads."""
        self.drain()
        for worker in self._workers or ():
            worker.close()

    # -- on the threads ----------------------------------------------------------------------------------

    def _on(self, worker: int, job: Callable[[], None]) -> None:
        if self._workers is None:
            job()
        else:
            self._workers[worker].submit(job)

    def _map(self, task: KeyframeTask) -> None:
        timer = StageTimer()
        with self._gate:
            with timer("mapping"):
                task.keyframe = task.mapper.insert(task.frame.copy())
            self._hand_over(Mapped(task.frame, task.keyframe, timer.cpu_ms["mapping"]))
        self._on(1, lambda: self._work_on_whole_map(task))

    def _work_on_whole_map(self, task: KeyframeTask) -> None:
        self._close_loop(task, task.keyframe)
        if task.camera is not None and self._calibration is not None:
            self._calibrate(task, task.camera, self._calibration)
        self.in_work.remove(task)

    def _prepare(self, change: MapChange) -> None:
        with self._gate:
            if change.prepare():
                self._hand_over(change, wait=True)

    def _close_loop(self, task: KeyframeTask, keyframe: int) -> None:
        map_, timer = task.mapper.map, StageTimer()
        with timer("detect"), self.lock:
            found, refused = task.detector.detect(keyframe, task.rng)
        for refusal in refused:
            self._hand_over(Refused(task, refusal))
        if found is None:
            self._hand_over(Searched(timer.cpu_ms["detect"]))
            return
        loop, around = found
        with self._gate:
            before = self._copy_of(map_)
        outcome = self._correct(before, loop, around, task, timer)
        with self._gate:
            if isinstance(outcome, str) or _changed(map_, loop):
                reason = outcome if isinstance(outcome, str) else _changed(map_, loop)
                with self.lock:
                    refusal = task.detector.refused(loop, reason)
                self._hand_over(Refused(task, refusal))
                self._hand_over(Searched(sum(timer.cpu_ms.values())))
                return
            corrected, factor, adjustment = outcome
            if map_.n_keyframes > before.n_keyframes:
                with timer("correct"):
                    corrected = self._copy_of(map_)
                    factor = correct_loop(corrected, loop, around, task.mapper.config)
            task.detector.closed(loop)
            cpu_ms = timer.cpu_ms["detect"] + timer.cpu_ms["correct"]
            self._hand_over(Corrected(task, loop, corrected, factor, cpu_ms), wait=True)
            if adjustment is not None:
                self._hand_over(Adjusted(task, loop, adjustment, timer.cpu_ms["adjust"]), wait=True)

    def _calibrate(self, task: KeyframeTask, camera: PinholeCamera, calibration: SelfCalibration) -> None:
        """Estimate the lens from a copy of the map."""
        timer = StageTimer()
        with timer("calibrate"):
            with self._gate:
                copied = self._copy_of(task.mapper.map)
            refinement = calibration.refine(copied, camera)
        with self._gate:
            self._hand_over(Calibrated(task, refinement, timer.cpu_ms["calibrate"]), wait=True)

    def _correct(
        self, before: Map, loop: Loop, around: np.ndarray, task: KeyframeTask, timer: StageTimer
    ) -> tuple[Map, np.ndarray, MapAdjustment | None] | str:
        """Correct, ask and adjust a copy of the map: copy, scale changes and adjustment, or a reason."""
        if _changed(before, loop):
            return _changed(before, loop)
        config = task.detector.config
        with timer("correct"):
            corrected = before.copy()
            factor = correct_loop(corrected, loop, around, task.mapper.config)
            believed = task.detector.is_believed(loop, before, corrected)
        if not believed:
            return "map_is_torn"
        if not config.adjustment_iterations:
            return corrected, factor, None
        with timer("adjust"):
            apart = self._news is not None
            return corrected, factor, adjust_globally(corrected, config.adjustment_iterations, apart)

    def _copy_of(self, map_: Map) -> Map:
        with self.lock:
            return map_.copy()

    def _hand_over(self, change: Change, wait: bool = False) -> None:
        if self._news is None:
            self._apply(change)
            return
        pending = _Pending(change)
        self._pending.append(pending)
        self._news.set()
        if wait:
            pending.applied.wait()


def _changed(map_: Map, loop: Loop) -> str:
    """Reason to refuse a loop one of whose keyframes was culled meanwhile; empty if both stand."""
    return "map_has_changed" if map_.arrays.kf_bad[[loop.keyframe, loop.loop_keyframe]].any() else ""
