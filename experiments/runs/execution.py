"""Run a SLAM system over a sequence and keep all of its results and events."""

import time
from collections.abc import Callable, Iterable
from collections.abc import Sequence as Many
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, Protocol

import numpy as np

from dslab.experiments.runs.ending import FINISHED, Declares, Ending, EndKind
from dslab.experiments.runs.memory import peak_rss_mb, reset_peak
from dslab.experiments.runs.pacing import RealTime
from dslab.scenarios.errors import InputError, notice
from dslab.sim.io.truth import MOST_POSITION_M
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import Sequence
from dslab.slam.config import SlamConfig
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import Event, TrackingState
from dslab.slam.core.results import MapTrajectory, TrackingResult
from dslab.slam.dual.config import DualConfig
from dslab.slam.map.map import Map

SystemKind = Literal["base", "dual", "dual+", "orbslam", "paper", "paper+", "dso", "ldso"]
"""Our systems, see ``slam.factory``; a plug-in goes by any other name."""
Mode = Literal["lockstep", "threaded"]
"""Schedule of tracking, mapping and loop closing: ``slam.runtime.backend.ExecutionMode`` by name."""
Progress = Callable[[int, int], None]


class SlamSystem(Protocol):
    """Interface of a SLAM system: see ``slam.system``."""

    @property
    def events(self) -> list[Event]: ...
    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult: ...
    def finish(self) -> None: ...
    def trajectories(self) -> list[MapTrajectory]: ...
    def keyframe_trajectories(self) -> list[MapTrajectory]: ...
    def map_points(self, map_id: int) -> np.ndarray: ...
    def maps(self) -> list[int]: ...
    def map(self, map_id: int) -> Map: ...
    @property
    def camera(self) -> PinholeCamera: ...
    @property
    def config(self) -> Any: ...


SystemFactory = Callable[[Any, PinholeCamera, int], SlamSystem]
"""Makes a system from its name, the camera and a seed."""
AtEnd = Callable[[SlamSystem, Sequence], None]
"""Called with the finished system and the frames it was fed."""


class Observer(Protocol):
    """Observer of a run, such as a recording."""

    def frame(self, image: np.ndarray, result: TrackingResult, system: SlamSystem) -> None:
        """Called after every frame."""
        ...


@dataclass(frozen=True)
class RunRecord:
    """The complete record of one run.

    Attributes:
        sequence: the input, without dropped frames.
        system_kind, seed, config: of the system.
        results: one per frame, in order, without keypoints.
        events: all events of the system.
        trajectories: final paths, the map with most frames first.
        keyframes: final keyframe poses per map.
        live: the poses as returned frame by frame, per map.
        map_points: number of points per map.
        wall_s: time spent in the system.
        peak_rss_mb: largest resident memory of the process during the run.
        dropped_frames: number of frames that were too late to be fed.
        unreadable_frames: number of frames that could not be read, and were left out.
        ending: how the run ended.
        declares: what the system says of itself.
        has_live_poses: False if ``live`` had to be made from the final poses.
        cpu_s: CPU seconds of a program and of what it starts, its start and reading included; else None.
        input: digests of what the run was given, see :func:`experiments.runs.inputs.input_digests`; empty if
            they were not made.
    """

    sequence: Sequence
    system_kind: str
    seed: int
    config: dict
    results: tuple[TrackingResult, ...]
    events: tuple[Event, ...]
    trajectories: tuple[MapTrajectory, ...]
    keyframes: tuple[MapTrajectory, ...]
    live: dict[int, MapTrajectory]
    map_points: dict[int, int]
    wall_s: float
    peak_rss_mb: float
    dropped_frames: int = 0
    unreadable_frames: int = 0
    ending: Ending = FINISHED
    declares: Declares = Declares.EVENTS
    has_live_poses: bool = True
    cpu_s: float | None = None
    input: dict[str, str] = field(default_factory=dict)


def slam_camera(camera: Intrinsics) -> PinholeCamera:
    """Convert the simulator's camera to the estimator's. Raises InputError if it takes no such camera."""
    try:
        return PinholeCamera(**asdict(camera))
    except ValueError as error:
        raise InputError("camera", str(error), "give the camera of a calibration") from None


def exposure_of(system: SlamSystem, sequence: Sequence, index: int) -> tuple[float, ...]:
    """The exposure of a frame, for a system that takes it, as the rest of the arguments of ``process``."""
    if sequence.exposure_s is None or not getattr(system, "takes_exposure", False):
        return ()
    return (float(sequence.exposure_s[index]),)


def execute(
    sequence: Sequence,
    system_kind: str,
    seed: int,
    observer: Observer | None = None,
    progress: Progress | None = None,
    build: SystemFactory | None = None,
    pace: RealTime | None = None,
    at_end: AtEnd | None = None,
) -> RunRecord:
    """Run a system over a sequence; its only inputs are image, time and intrinsics.

    A system numbers the frames that it is fed. If some are dropped, or cannot be read, the record is of a
    sequence without them.

    Args:
        sequence: frames, times, camera; its truth is not passed on.
        system_kind: name of the system: ``base``, ``dual`` or ``dual+``, or what ``build`` knows.
        seed: root of every random stream of the system.
        observer: called after every frame.
        progress: called with (frames done, frames in all).
        build: makes the system; ``slam.factory.build_system`` by default.
        pace: feeds in real time; None for as fast as possible.
        at_end: called with the finished system.

    Raises:
        InputError: no frame can be read.
    """
    system = (build or system_factory())(system_kind, slam_camera(sequence.camera), seed)
    reset_peak()
    results: list[TrackingResult] = []
    fed: list[int] = []
    unread: list[InputError] = []
    wall_s = 0.0
    for index, stamp_s in enumerate(sequence.stamps_s):
        if pace is not None and pace.is_late(index):
            continue
        try:
            image = sequence.frames[index]
        except InputError as fault:
            unread.append(fault)
            continue
        if pace is not None:
            pace.wait_for(index)
        fed.append(index)
        started = time.perf_counter()
        result = system.process(image, float(stamp_s), *exposure_of(system, sequence, index))
        wall_s += time.perf_counter() - started
        if observer is not None:
            observer.frame(image, result, system)
        results.append(without_features(result))
        if progress is not None:
            progress(index + 1, len(sequence))
    tell_unread(unread, len(fed))
    started = time.perf_counter()
    system.finish()
    wall_s += time.perf_counter() - started
    dropped = len(sequence) - len(fed)
    if dropped:
        sequence = sequence.only(np.array(fed, int))
    if at_end is not None:
        at_end(system, sequence)
    record = record_of(system, sequence, system_kind, seed, results, wall_s, dropped - len(unread))
    return replace(record, unreadable_frames=len(unread))


def tell_unread(faults: Many[InputError], fed: int) -> None:
    """Say that frames cannot be read and are left out. Raises the first fault if none is ``fed``."""
    if faults and not fed:
        raise faults[0]
    if faults:
        notice(faults[0].where, f"{faults[0].problem}; {len(faults)} frames that cannot be read are left out")


def record_of(
    system: SlamSystem,
    sequence: Sequence,
    system_kind: str,
    seed: int,
    results: Iterable[TrackingResult],
    wall_s: float,
    dropped: int = 0,
) -> RunRecord:
    """Make the record of a finished system; arguments as its fields.

    Poses too far away to be read again are left out of its paths, which its ending says.
    """
    results = tuple(results)
    paths, are_all = _near(system.trajectories())
    ending = getattr(system, "ending", FINISHED)
    if ending.kind is EndKind.FINISHED and not are_all:
        ending = Ending(EndKind.NOT_FINITE, f"poses further away than {MOST_POSITION_M:g} are left out")
    return RunRecord(
        sequence=sequence,
        system_kind=system_kind,
        seed=seed,
        config=system.settings,
        results=results,
        events=tuple(system.events),
        trajectories=paths,
        keyframes=_near(system.keyframe_trajectories())[0],
        live=live_trajectories(results),
        map_points={map_id: len(system.map_points(map_id)) for map_id in system.maps()},
        wall_s=wall_s,
        peak_rss_mb=peak_rss_mb(),
        dropped_frames=dropped,
        ending=ending,
        declares=getattr(system, "declares", Declares.EVENTS),
    )


def _near(paths: Many[MapTrajectory]) -> tuple[tuple[MapTrajectory, ...], bool]:
    """The paths without poses beyond the bound, and whether these are all."""
    near = [np.abs(path.T_map_cam[:, :3, 3]).max(axis=1, initial=0.0) <= MOST_POSITION_M for path in paths]
    if all(of.all() for of in near):
        return tuple(paths), True
    kept = [path.where(of) for path, of in zip(paths, near, strict=True) if of.any()]
    return tuple(sorted(kept, key=lambda path: -len(path.frames))), False


def system_factory(
    mode: Mode = "lockstep", dual: DualConfig | None = None, config: SlamConfig | None = None
) -> SystemFactory:
    """A factory of this project's systems.

    Args:
        mode: schedule of tracking, mapping and loop closing.
        dual: settings of Dual-SLAM; None for its own.
        config: settings of the base; None for the system's own.
    """
    from dslab.slam.factory import build_system
    from dslab.slam.runtime.backend import ExecutionMode

    execution_mode = ExecutionMode(mode)
    return lambda kind, camera, seed: build_system(kind, camera, seed, config, execution_mode, dual)


def live_trajectories(results: Iterable[TrackingResult]) -> dict[int, MapTrajectory]:
    """The poses returned frame by frame, grouped by map."""
    rows: dict[int, list[TrackingResult]] = {}
    for result in results:
        if result.state is TrackingState.TRACKING and result.T_map_cam is not None:
            rows.setdefault(result.map_id, []).append(result)
    return {
        map_id: MapTrajectory(
            map_id,
            np.array([r.frame for r in of_map], int),
            np.array([r.stamp_s for r in of_map]),
            np.array([r.T_map_cam for r in of_map]),
        )
        for map_id, of_map in rows.items()
    }


def without_features(result: TrackingResult) -> TrackingResult:
    """A copy of a frame's result without its features."""
    return replace(result, keypoints_px=np.empty((0, 2), np.float32), inlier_mask=np.empty(0, bool))
