"""Runs that units share: what a system has been given once is not given to it again.

A unit goes on from the lead-in that another cell of its replicate has run, and Dual-SLAM over X from X
itself, up to the last state before X broke: until then the two are one, bit for bit. Whatever a run depends
on is in its key: a unit's record is the same with or without an earlier one.
"""

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np

from dslab.experiments.eq1.branch_run import BranchRun, Saved
from dslab.experiments.eq1.units import content_hash
from dslab.experiments.runs.execution import RunRecord, slam_camera
from dslab.experiments.runs.slam_settings import SlamSettings, factory_of
from dslab.experiments.runs.systems.registry import DualSystem, OwnSystem
from dslab.sim.sequence import Sequence
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import Breakage, Event
from dslab.slam.core.results import MapTrajectory, TrackingResult

SAVE_EVERY_S = 1.0
"""Time between two states that are saved of a run until it breaks."""
_LEAD_INS_KEPT, _RUNS_KEPT = 4, 2
_lead_ins: dict[str, Saved] = {}
_runs: dict[str, Saved] = {}  # the last states before they broke; at the end where they did not


def run_own(
    system: OwnSystem, sequence: Sequence, onset: int, seed: int, settings: SlamSettings
) -> RunRecord:
    """Run one of our systems over all frames; arguments as of :func:`eq1.arms.run_other`."""
    saved = _lead_in(system, sequence, onset, seed, settings)
    branch = BranchRun.resume(saved, sequence)
    stride = max(1, round(SAVE_EVERY_S * sequence.camera.fps))
    while not (branch.at_end or branch.is_broken):
        if branch.frames - saved.frames >= stride:
            saved = branch.save()
        branch.step()
    if not branch.is_broken:
        saved = branch.save()
    kept(_runs, _RUNS_KEPT, _key(system, sequence, len(sequence), seed, settings), lambda: saved)
    branch.run_out()
    return branch.record(system.name, seed)


def forward_of(
    system: DualSystem, sequence: Sequence, onset: int, seed: int, settings: SlamSettings, *, whole: bool
) -> "Resumed | None":
    """The forward system of Dual-SLAM over one of ours, given the frames that it has seen elsewhere.

    Args:
        system, sequence, onset, seed, settings: as of :func:`eq1.arms.run_other`.
        whole: all frames will be given to it as they come; else its run is cut at the onset.

    Returns:
        None for a system that is not ours, or that broke in the lead-in.
    """
    forward = system.parts[0]
    if not isinstance(forward, OwnSystem):
        return None
    saved = _runs.get(_key(forward, sequence, len(sequence), seed, settings)) if whole else None
    resumed = Resumed(saved or _lead_in(forward, sequence, onset, seed, settings))
    return None if resumed.is_broken else resumed


class Resumed:
    """A system that has been given its first frames before: of these it says again what it said then.

    Args:
        saved: its run so far, in which it has not broken.
    """

    def __init__(self, saved: Saved) -> None:
        self._system: Any = saved.snapshot.restore()
        self._saved, self._frames = saved, 0

    @property
    def is_broken(self) -> bool:
        """True if a breakage was declared."""
        return any(isinstance(event, Breakage) for event in self._system.events)

    @property
    def camera(self) -> PinholeCamera:
        """The camera, as the system has refined it."""
        return self._system.camera

    @property
    def events(self) -> list[Event]:
        """Events up to the frame at hand."""
        events = self._system.events
        return events[: self._saved.told[self._frames - 1]] if self._frames <= self._saved.frames else events

    def process(self, image: np.ndarray, stamp_s: float, *exposure_s: float) -> TrackingResult:
        """The outcome of the next frame."""
        self._frames += 1
        if self._frames <= self._saved.frames:
            return self._saved.results[self._frames - 1]
        return self._system.process(image, stamp_s, *exposure_s)

    def finish(self) -> None:
        """End the input."""
        self._system.finish()

    def trajectories(self) -> list[MapTrajectory]:
        """Poses, as of the last frame that the system has been given."""
        return self._system.trajectories()

    def keyframe_trajectories(self) -> list[MapTrajectory]:
        """Keyframes, likewise."""
        return self._system.keyframe_trajectories()

    def map_points(self, map_id: int) -> np.ndarray:
        """(N, 3) points of a map, likewise."""
        return self._system.map_points(map_id)


def _lead_in(system: OwnSystem, sequence: Sequence, onset: int, seed: int, settings: SlamSettings) -> Saved:
    def run() -> Saved:
        made: Any = factory_of(settings)(system.name, slam_camera(sequence.camera), seed)
        branch = BranchRun(made, sequence)
        branch.feed(onset)
        return branch.save()

    return kept(_lead_ins, _LEAD_INS_KEPT, _key(system, sequence, onset, seed, settings), run)


def _key(system: OwnSystem, sequence: Sequence, until: int, seed: int, settings: SlamSettings) -> str:
    return frames_key(sequence, until, [system.name, seed, repr(settings)])


def kept(store: dict[str, Any], most: int, key: str, make: Callable[[], Any]) -> Any:
    """What was made for a key, made now unless it is among the latest."""
    found = store.pop(key, None)
    store[key] = make() if found is None else found
    while len(store) > most:
        del store[next(iter(store))]
    return store[key]


def frames_key(sequence: Sequence, until: int, system: list[object]) -> str:
    """Hash of what a run depends on: frames before one, their times and truth, the system and its seed."""
    images = hashlib.sha256()
    for frame in range(until):
        images.update(sequence.frames[frame])
    truth = None if sequence.T_world_cam is None else sequence.T_world_cam[:until].tobytes().hex()
    stamps_s, camera = sequence.stamps_s[:until].tolist(), repr(sequence.camera)
    return content_hash([images.hexdigest(), stamps_s, truth, camera, *system])
