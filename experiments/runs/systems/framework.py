"""Dual-SLAM over any system of the lab: what each kind of system gives to ``slam.framework``."""

from collections.abc import Sequence as Many
from contextlib import suppress
from dataclasses import replace

import numpy as np

from dslab.experiments.runs.ending import FINISHED, Ending
from dslab.experiments.runs.execution import RunRecord, SystemFactory, live_trajectories
from dslab.experiments.runs.slam_settings import SettingsFactory
from dslab.experiments.runs.systems.command import CommandSystem, run_command
from dslab.experiments.runs.systems.own_class import ClassSystem
from dslab.experiments.runs.systems.poses_only import PosesOnly
from dslab.experiments.runs.systems.registry import DualSystem, OwnSystem, System
from dslab.scenarios.errors import InputError
from dslab.sim.sequence import ChosenFrames, Sequence
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import Event
from dslab.slam.core.results import MapTrajectory, TrackingResult
from dslab.slam.factory import build_system, parts_of
from dslab.slam.framework.dual_of import DualOf
from dslab.slam.framework.odometry import Begin, Kind, Odometry, Parts

_MOST = 0.9  # of the poses that a program gave of a map; final ones of so many frames are of that map


class ProgramRun:
    """A program that is given frames: it is run over all of them at the first, and replayed one by one.

    Its poses are the final ones of that run, up to the frame at hand; of maps that it has not left, those
    that it gave.

    Args:
        system: the program.
        sequence: the frames, without truth.
        seed: given to it.
    """

    def __init__(self, system: CommandSystem, sequence: Sequence, seed: int, camera: PinholeCamera) -> None:
        self.camera = camera
        self._system, self._sequence, self._seed = system, sequence, seed
        self._record: RunRecord | None = None
        self._row_of: dict[float, int] = {}  # of the record, by stamp
        self._rows: list[int] = []  # of the record, of the frames so far; -1 for one that it could not read

    @property
    def events(self) -> list[Event]:
        """Losses that it declares, up to the frame at hand."""
        return [e for e in self._record.events if e.frame in self._rows] if self._record else []

    @property
    def ending(self) -> Ending:
        """How it ended."""
        return self._record.ending if self._record else FINISHED

    def process(self, image: np.ndarray, stamp_s: float, *exposure_s: float) -> TrackingResult:
        """What it said of the next frame."""
        if self._record is None:
            self._record = run_command(self._system, self._sequence, self._seed)
            self._row_of = {result.stamp_s: row for row, result in enumerate(self._record.results)}
        self._rows.append(self._row_of.get(float(self._sequence.stamps_s[len(self._rows)]), -1))
        result = self._record.results[self._rows[-1]]
        return result if self._rows[-1] >= 0 else replace(result, T_map_cam=None)

    def finish(self) -> None:
        """Nothing is pending."""

    def trajectories(self) -> list[MapTrajectory]:
        """Poses so far."""
        if self._record is None:
            return []
        live = live_trajectories(self._record.results[row] for row in self._rows if row >= 0)
        return [self._final(path) for path in live.values()]

    def keyframe_trajectories(self) -> list[MapTrajectory]:
        """Keyframes so far."""
        paths = self._record.keyframes if self._record else ()
        return [path.where(np.isin(path.frames, self._rows)) for path in paths]

    def map_points(self, map_id: int) -> np.ndarray:
        """(0, 3): points are not known."""
        return np.empty((0, 3))

    def _final(self, path: MapTrajectory) -> MapTrajectory:
        assert self._record is not None
        for final in self._record.trajectories:
            if np.isin(path.frames, final.frames).mean() >= _MOST:
                return replace(final.where(np.isin(final.frames, path.frames)), map_id=path.map_id)
        return path


class DualRun(DualOf):
    """Dual-SLAM over a system of the lab."""

    @property
    def ending(self) -> Ending:
        """How the system at work ended."""
        system = self._fed.system
        return system.ending if isinstance(system, PosesOnly | ProgramRun) else FINISHED


def dual_builder(
    system: DualSystem,
    sequence: Sequence,
    build: SystemFactory | None = None,
    begun: Odometry | None = None,
) -> SystemFactory:
    """What builds Dual-SLAM over a system.

    Args:
        system: what it is made of.
        sequence: the frames that it will be given; programs are given copies of parts of it, without truth.
        build: makes ours; None for ``slam.factory.build_system``.
        begun: the forward system of the first frame, if it is at hand; for one run.
    """
    config = build.settings.framework if isinstance(build, SettingsFactory) else None
    if any(isinstance(part, CommandSystem) for part in system.parts):
        sequence = _readable(sequence)  # those that Dual-SLAM is given, and counts

    def made(name: str, camera: PinholeCamera, seed: int) -> DualRun:
        forward, *recoveries = (_kind(part, sequence, camera, build or build_system) for part in system.parts)
        if begun is not None:
            forward = replace(forward, begin=_after(begun, forward.begin))
        return DualRun(camera, seed, forward, recoveries, config)

    return made


def parts(system: System) -> Parts:
    """Which parts of the protocol a system has. A class says that it finds back by ``relocalizes = True``."""
    if isinstance(system, DualSystem):
        return Parts(losses=True)
    if isinstance(system, OwnSystem):
        return parts_of(system.name)
    if isinstance(system, ClassSystem):
        return Parts(losses=False, returns=bool(getattr(system.make, "relocalizes", False)))
    declares = bool(system.spec.lost_states or system.spec.events)
    return Parts(losses=declares, returns=declares)


def _kind(system: System, sequence: Sequence, camera: PinholeCamera, build: SystemFactory) -> Kind:
    def begin(seed: int, first: int, backward: Many[int] | None) -> Odometry:
        if isinstance(system, CommandSystem):
            order = np.arange(first, len(sequence)) if backward is None else np.array(backward)
            return ProgramRun(system, _in_order(sequence, order), seed, camera)
        if isinstance(system, ClassSystem):
            return system.build(camera, seed)
        return build(system.name, camera, seed)

    return Kind(system.name, parts(system), begin)


def _after(begun: Odometry, begin: Begin) -> Begin:
    """As ``begin``, but for the system of the first frame, which is at hand."""
    return lambda seed, first, back: begin(seed, first, back) if first or back is not None else begun


def _readable(sequence: Sequence) -> Sequence:
    """The frames of a sequence that can be read."""
    kept = []
    for frame in range(len(sequence)):
        with suppress(InputError):
            sequence.frames[frame]
            kept.append(frame)
    return sequence.only(np.array(kept, int))


def _in_order(sequence: Sequence, order: np.ndarray) -> Sequence:
    """Frames of a sequence in another order, with stamps that rise by the time between them; no truth."""
    stamps_s = sequence.stamps_s[order]
    if len(order) > 1 and stamps_s[1] < stamps_s[0]:
        stamps_s = stamps_s[0] - stamps_s
    frames = ChosenFrames(sequence.frames, order)
    return Sequence(sequence.name, sequence.camera, stamps_s, frames, None, None, (), {})
