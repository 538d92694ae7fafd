"""A system of which only poses are known: an adapter of the protocol that a run needs."""

import time
from collections.abc import Callable
from itertools import islice
from typing import Any

import numpy as np

from dslab.experiments.plugins import log_of, no_exit, words_of
from dslab.experiments.runs.ending import Declares, Ending, EndKind
from dslab.experiments.runs.systems.left_events import EVENT_FAULTS, checked_event
from dslab.experiments.runs.systems.left_files import no_rotations
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import Breakage, Event, TrackingState
from dslab.slam.core.results import MapTrajectory, TrackingResult
from dslab.slam.map.map import Map

_NO_FEATURES = np.empty((0, 2), np.float32), np.empty(0, bool)


class PosesOnly:
    """Adapter of an object that only gives poses: one map, no points, no keyframes.

    Its ``process(image, stamp_s)`` returns T_map_cam (4, 4) of a frame, image (H, W) uint8, or None without a
    pose. It may also have ``finish()``, which returns the final poses of all frames so far, each (4, 4) or
    None, or None if those that were given stand; and a list ``events``, of ``slam.events`` or of (stamp_s,
    words) for each loss that it declares.

    What the source raises ends its part in the run, not the run: later frames have no pose. A pose that is
    none counts as no pose, and an event that is none as no event.

    Args:
        source: the object to ask for poses; None for none that is asked.
        camera: of the images, if it is known.
        name: of the system, for ``settings``.

    Attributes:
        ending: how it ended so far.
        events: what it declared so far, in order; each of its (stamp_s, words) is a breakage.
        declares: whether it says anything of itself.
    """

    def __init__(self, source: Any, camera: Any, name: str) -> None:
        self.camera: PinholeCamera = camera
        self.config = None
        self.settings: dict[str, Any] = {"system": name}
        self.ending = Ending()
        self.events: list[Event] = []
        self.declares = Declares.NOTHING
        self._source = source
        self._stamps_s: list[float] = []
        self._poses: list[np.ndarray | None] = []
        self._declared = 0  # entries of its list that were looked at
        self._was_initialized = False

    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult:
        """Ask for the pose of a frame."""
        image = image.copy()  # of its own: other systems are given these frames too
        started_s, started_cpu_s = time.perf_counter(), time.thread_time()
        given = None if self._is_over else self._ask(lambda: self._source.process(image, stamp_s))
        ms = {"process": 1e3 * (time.perf_counter() - started_s)}
        cpu_ms = {"process": 1e3 * (time.thread_time() - started_cpu_s)}
        self._stamps_s.append(stamp_s)
        self._poses.append(self._ask(lambda: self._checked(given, stamp_s)))
        self._ask(self._take_events)
        self._was_initialized |= self._poses[-1] is not None
        frame = len(self._poses) - 1
        reason = self.ending.kind.value if self._is_over else ""
        return frame_result(frame, stamp_s, self._poses[-1], self._was_initialized, reason, ms, cpu_ms)

    def finish(self) -> None:
        """Take the final poses, if the source has any."""
        if not self._is_over and (final := self._ask(self._final)) is not None:
            self._poses = final
        self._ask(lambda: self._take_events(ended=True))

    def trajectories(self) -> list[MapTrajectory]:
        """The one path; none without a pose."""
        frames = [frame for frame, pose in enumerate(self._poses) if pose is not None]
        if not frames:
            return []
        poses = np.array([self._poses[frame] for frame in frames])
        return [MapTrajectory(0, np.array(frames), np.array(self._stamps_s)[frames], poses)]

    def keyframe_trajectories(self) -> list[MapTrajectory]:
        """None is known."""
        return []

    def maps(self) -> list[int]:
        """Ids of its maps, as far as they are seen from outside."""
        return [trajectory.map_id for trajectory in self.trajectories()]

    def map_points(self, map_id: int) -> np.ndarray:
        """(0, 3): points are not known."""
        return np.empty((0, 3))

    def map(self, map_id: int) -> Map:
        """Raises ValueError: maps are not known."""
        raise ValueError("only poses are known of this system")

    @property
    def _is_over(self) -> bool:
        return self.ending.kind in (EndKind.CRASHED, EndKind.OUT_OF_MEMORY)

    def _ask(self, question: Callable[[], Any]) -> Any:
        """The answer of the source, or None; whatever it raises is the outcome, but for an interrupt."""
        try:
            with no_exit():
                return question()
        except KeyboardInterrupt:
            raise
        except MemoryError as error:
            self.ending = Ending(EndKind.OUT_OF_MEMORY, words_of(error), log=log_of(error))
        except BaseException as error:
            remedy = "see its log, or run it in a debugger on this sequence"
            self.ending = Ending(EndKind.CRASHED, words_of(error), remedy, log_of(error))
        return None

    def _final(self) -> list[np.ndarray | None] | None:
        """Its final poses, checked; None if those that were given stand."""
        finish, count = getattr(self._source, "finish", None), len(self._stamps_s)
        given = finish() if callable(finish) else None
        if given is None:
            return None
        final = list(islice(given, count + 1)) if hasattr(given, "__len__") else []
        if len(final) != count:
            problem = f"finish() gives no {count} poses, one per frame"
            self._end(EndKind.UNREADABLE, problem, "return one pose or None per frame that was processed")
            return None
        return [self._checked(T, s) for T, s in zip(final, self._stamps_s, strict=True)]

    def _take_events(self, ended: bool = False) -> None:
        """Take what the source has declared since it was last looked at, but for what is still to come."""
        declared = getattr(self._source, "events", None)
        if not isinstance(declared, list):
            return
        declared = list(declared)
        ours = declared and all(isinstance(event, Event) for event in declared)
        self.declares = Declares.EVENTS if ours else Declares.LOSSES
        for given in declared[self._declared :]:
            self._declared += 1
            try:
                event = self._event(given)
                if event is None and not ended:
                    self._declared -= 1
                    return
                if event is None:
                    raise ValueError("its frame never came")
                self.events.append(checked_event(event, np.array(self._stamps_s)))
            except EVENT_FAULTS as error:
                remedy = "declare events of `slam.events`, or (stamp_s, words) with the stamp of a frame"
                self._end(EndKind.UNREADABLE, f"an event is none: {words_of(error)}", remedy)

    def _event(self, declared: Any) -> Event | None:
        """The event of what was declared; None if its frame is still to come. Raises EVENT_FAULTS."""
        if isinstance(declared, Event):
            return declared if declared.frame < len(self._stamps_s) else None
        stamp_s, words = declared
        frame = int(np.searchsorted(self._stamps_s, float(stamp_s) - 1e-9))
        if frame >= len(self._stamps_s):
            return None
        return Breakage(frame=frame, stamp_s=self._stamps_s[frame], map_id=0, reason=str(words), inliers=0)

    def _checked(self, given: Any, stamp_s: float) -> np.ndarray | None:
        if given is None:
            return None
        try:
            T = np.array(given, float)
        except (TypeError, ValueError, OverflowError):
            T = np.empty(0)
        at = f"the pose at {stamp_s:.6f} s"
        if T.shape == (4, 4) and not np.isfinite(T).all():
            self._end(EndKind.NOT_FINITE, f"{at} is not finite", "return None for a frame without a pose")
            return None
        if T.shape != (4, 4) or no_rotations(T[None])[0] or not np.allclose(T[3], [0, 0, 0, 1], atol=1e-2):
            remedy = "return T_map_cam (4, 4), a rotation and a position, or None"
            self._end(EndKind.UNREADABLE, f"{at} is no rigid transform", remedy)
            return None
        return T

    def _end(self, kind: EndKind, message: str, remedy: str) -> None:
        """Note the first thing that went wrong."""
        if self.ending.kind is EndKind.FINISHED:
            self.ending = Ending(kind, message, remedy)


def frame_result(
    frame: int,
    stamp_s: float,
    T_map_cam: np.ndarray | None,
    was_initialized: bool,
    reason: str = "",
    ms: dict[str, float] | None = None,
    cpu_ms: dict[str, float] | None = None,
    is_keyframe: bool = False,
) -> TrackingResult:
    """The outcome of a frame of which only the pose is known.

    Args:
        frame, stamp_s, reason, ms, cpu_ms, is_keyframe: as of ``TrackingResult``.
        T_map_cam: (4, 4) or None.
        was_initialized: a frame had a pose by now, so that none means lost.
    """
    lost = TrackingState.LOST if was_initialized else TrackingState.NOT_INITIALIZED
    keypoints_px, inlier_mask = _NO_FEATURES
    return TrackingResult(
        frame=frame,
        stamp_s=stamp_s,
        state=lost if T_map_cam is None else TrackingState.TRACKING,
        T_map_cam=T_map_cam,
        map_id=0,
        inliers=0,
        matches=0,
        reason=reason,
        is_keyframe=is_keyframe,
        keypoints_px=keypoints_px,
        inlier_mask=inlier_mask,
        cpu_ms=cpu_ms or {},
        ms=ms or {},
    )
