"""A system of which only poses are known: an adapter of the protocol that a run needs."""

import time
from collections.abc import Iterable
from typing import Any

import numpy as np

from dslab.experiments.runs.ending import Declares, Ending, EndKind
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
    none counts as no pose.

    Args:
        source: the object to ask for poses; None for none that is asked.
        camera: of the images, if it is known.
        name: of the system, for ``settings``.

    Attributes:
        ending: how it ended so far.
        events: what it declared, in order.
    """

    def __init__(self, source: Any, camera: Any, name: str) -> None:
        self.camera: PinholeCamera = camera
        self.config = None
        self.settings: dict[str, Any] = {"system": name}
        self.ending = Ending()
        self._source = source
        self._stamps_s: list[float] = []
        self._poses: list[np.ndarray | None] = []
        self._was_initialized = False

    @property
    def events(self) -> list[Event]:
        """Events of the source; each of its (stamp_s, words) is a breakage."""
        return [e for e in map(self._event, self._declared()) if e is not None]

    @property
    def declares(self) -> Declares:
        """Whether the source says anything of itself."""
        declared = getattr(self._source, "events", None)
        if not isinstance(declared, list):
            return Declares.NOTHING
        ours = declared and all(isinstance(event, Event) for event in declared)
        return Declares.EVENTS if ours else Declares.LOSSES

    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult:
        """Ask for the pose of a frame."""
        image = image.copy()  # of its own: other systems are given these frames too
        started_s, started_cpu_s = time.perf_counter(), time.thread_time()
        T_map_cam = self._ask(lambda: self._source.process(image, stamp_s))
        ms = {"process": 1e3 * (time.perf_counter() - started_s)}
        cpu_ms = {"process": 1e3 * (time.thread_time() - started_cpu_s)}
        self._stamps_s.append(stamp_s)
        self._poses.append(self._checked(T_map_cam, stamp_s))
        self._was_initialized |= self._poses[-1] is not None
        frame = len(self._poses) - 1
        return frame_result(frame, stamp_s, self._poses[-1], self._was_initialized, ms=ms, cpu_ms=cpu_ms)

    def finish(self) -> None:
        """Take the final poses, if the source has any."""
        finish = getattr(self._source, "finish", None)
        final = self._ask(finish) if callable(finish) else None
        if final is None:
            return
        if not hasattr(final, "__len__") or len(final) != len(self._stamps_s):
            problem = f"finish() gives no {len(self._stamps_s)} poses, one per frame"
            self._end(EndKind.UNREADABLE, problem, "return one pose or None per frame that was processed")
            return
        self._poses = [self._checked(T, s) for T, s in zip(final, self._stamps_s, strict=True)]

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

    def _ask(self, question: Any) -> Any:
        if self.ending.kind in (EndKind.CRASHED, EndKind.OUT_OF_MEMORY):
            return None
        try:
            return question()
        except MemoryError as error:
            self.ending = Ending(EndKind.OUT_OF_MEMORY, _line(error))
        except (Exception, SystemExit) as error:  # another's code: whatever it raises is the outcome
            self.ending = Ending(EndKind.CRASHED, _line(error), "run it in a debugger on this sequence")
        return None

    def _declared(self) -> Iterable[Any]:
        declared = getattr(self._source, "events", ())
        return declared if isinstance(declared, list) else ()

    def _event(self, declared: Any) -> Event | None:
        if isinstance(declared, Event):
            return declared
        try:
            stamp_s, words = declared
            frame = int(np.searchsorted(self._stamps_s, float(stamp_s) - 1e-9))
        except (TypeError, ValueError):
            return None
        if frame >= len(self._stamps_s):
            return None
        return Breakage(frame=frame, stamp_s=self._stamps_s[frame], map_id=0, reason=str(words), inliers=0)

    def _checked(self, given: Any, stamp_s: float) -> np.ndarray | None:
        if given is None:
            return None
        try:
            T = np.array(given, float)
        except (TypeError, ValueError):
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


def _line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
