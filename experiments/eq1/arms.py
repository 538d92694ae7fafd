"""The arms of a unit, branched from one lead-in.

Free: base and Dual-SLAM see the same images. Crossing: the map is saved at the onset and a new one is started
after the exposed segment, even if tracking would not have failed in it.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from dslab.experiments.eq1.unit_settings import unit_settings
from dslab.experiments.eq1.units import UnitSpec
from dslab.experiments.evaluation.breakages import EXPOSURE_GRACE_S
from dslab.experiments.runs.execution import RunRecord, record_of, slam_camera, without_features
from dslab.experiments.runs.slam_settings import SlamSettings, factory_of
from dslab.sim.sequence import SegmentTruth, Sequence
from dslab.slam.core.events import Breakage, RecoveryStart
from dslab.slam.core.results import TrackingResult
from dslab.slam.core.snapshot import Snapshot
from dslab.slam.dual.dual_slam import DualSlam
from dslab.slam.system import MonocularSystem

_SAVE_EVERY_S = 1.0
_ROUNDING_S = 1e-6


@dataclass(frozen=True)
class Exposure:
    """The exposed segment.

    Attributes:
        onset_s, exposed_s: start and length.
        onset_frame, end_frame: its first and last frame.
        last_frame: last frame at which a breakage is still attributed to it.
    """

    onset_s: float
    exposed_s: float
    onset_frame: int
    end_frame: int
    last_frame: int

    @staticmethod
    def of(unit: UnitSpec, sequence: Sequence) -> "Exposure":
        """Find the exposed segment of a unit in the frames of its sequence.

        Raises:
            ValueError: there is no frame before it, in it or after it.
        """
        onset_s, exposed_s = unit.onset_s, unit.exposed_s
        if onset_s is None or exposed_s is None:
            first = unit.scenario.segments[0]
            onset_s, exposed_s = onset_s or first.start_s, exposed_s or first.duration_s
        stamps_s = sequence.stamps_s
        onset = int(np.searchsorted(stamps_s, onset_s - _ROUNDING_S))
        end = int(np.searchsorted(stamps_s, onset_s + exposed_s - _ROUNDING_S)) - 1
        if not 0 < onset <= end < len(sequence) - 1:
            raise ValueError(f"the exposed segment is frames {onset} to {end} of {len(sequence)}")
        last = int(np.searchsorted(stamps_s, stamps_s[end] + EXPOSURE_GRACE_S, "right")) - 1
        return Exposure(onset_s, exposed_s, onset, end, last)

    def as_segment(self, kind: str) -> SegmentTruth:
        """The exposed segment as a degradation that acts on all of its frames."""
        end_s = self.onset_s + self.exposed_s
        return SegmentTruth(kind, {}, self.onset_s, end_s, self.onset_frame, self.end_frame)


@dataclass
class CpuClock:
    """CPU time of this process, summed over blocks of work.

    Attributes:
        seconds: sum so far.
    """

    seconds: float = 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        """Add the CPU time of the block."""
        started = time.process_time()
        try:
            yield
        finally:
            self.seconds += time.process_time() - started


class BranchRun:
    """A system at one point of its run over a sequence, with its results so far.

    Args:
        system: the SLAM system.
        sequence: its input.
        clock: sums the CPU time within the system.
        results: of the frames fed so far.

    Attributes:
        first_frame_of: first frame of every new map from which a recovery has started, by map id.
    """

    def __init__(
        self,
        system: MonocularSystem,
        sequence: Sequence,
        clock: CpuClock,
        results: tuple[TrackingResult, ...] = (),
    ) -> None:
        self.system = system
        self.sequence = sequence
        self.results = list(results)
        self.first_frame_of: dict[int, int] = {}
        self._clock = clock

    @property
    def frames(self) -> int:
        """Number of frames fed so far."""
        return len(self.results)

    @property
    def at_end(self) -> bool:
        """True if no frame is left."""
        return self.frames == len(self.sequence)

    @property
    def is_broken(self) -> bool:
        """True if a breakage was declared."""
        return any(isinstance(event, Breakage) for event in self.system.events)

    def step(self) -> None:
        """Feed one frame."""
        index, happened = self.frames, len(self.system.events)
        image = self.sequence.frames[index]
        with self._clock.running():
            result = self.system.process(image, float(self.sequence.stamps_s[index]))
        self.results.append(without_features(result))
        for event in self.system.events[happened:]:
            if isinstance(event, RecoveryStart) and event.map_id not in self.first_frame_of:
                self._note_new_map(event.map_id)

    def feed(self, until: int) -> None:
        """Feed the frames before ``until``."""
        while self.frames < until:
            self.step()

    def finish(self) -> None:
        """Signal the end of the input to the system."""
        with self._clock.running():
            self.system.finish()

    def save(self) -> "SavedBranch":
        """Save the state, from which any number of runs can resume."""
        with self._clock.running():
            snapshot = self.system.snapshot()
        return SavedBranch(snapshot, self.sequence, self._clock, tuple(self.results))

    def record(self, kind: str, seed: int) -> RunRecord:
        """The record of the finished run; its time is that of all runs by this clock."""
        return record_of(self.system, self.sequence, kind, seed, self.results, self._clock.seconds)

    def _note_new_map(self, map_id: int) -> None:
        paths = self.system.keyframe_trajectories()
        self.first_frame_of.update((map_id, int(path.frames[0])) for path in paths if path.map_id == map_id)


@dataclass(frozen=True)
class SavedBranch:
    """State of a run between two frames."""

    snapshot: Snapshot
    sequence: Sequence
    clock: CpuClock
    results: tuple[TrackingResult, ...]

    @property
    def frames(self) -> int:
        """Number of frames fed before."""
        return len(self.results)

    def resume(self) -> BranchRun:
        """Start a run that continues from this state."""
        with self.clock.running():
            system = self.snapshot.restore()
        return BranchRun(system, self.sequence, self.clock, self.results)

    def resume_as_base(self) -> BranchRun:
        """Start a run of the base system that continues from this state."""
        branch = self.resume()
        if isinstance(branch.system, DualSlam):
            branch.system = branch.system.as_base()
        return branch


@dataclass(frozen=True)
class FreeArm:
    """Result of the free arm.

    Attributes:
        base, dual: the two runs, from the first frame to the last.
        first_frame_of: see BranchRun, of the dual.
    """

    base: RunRecord
    dual: RunRecord
    first_frame_of: dict[int, int]


def settings_of(unit: UnitSpec) -> SlamSettings:
    """Settings of the systems of a unit."""
    return unit_settings(unit.settings, unit.threads, lambda at: ".".join(map(str, at)))


def run_lead_in(
    unit: UnitSpec, sequence: Sequence, exposure: Exposure, clock: CpuClock, kind: str | None = None
) -> BranchRun:
    """Run the lead-in, which all arms share: the frames before the onset; ``kind``: None for the unit's.

    Its arms, and those of the cells that share it, see most images again: their features are kept.
    """
    camera = slam_camera(sequence.camera)
    system = factory_of(settings_of(unit))(kind or unit.system, camera, unit.repeat_seed)
    system.engine.remember_features(2 * len(sequence))
    branch = BranchRun(system, sequence, clock)
    branch.feed(exposure.onset_frame)
    return branch


PLAIN: dict[str, str] = {"dual+": "dual", "paper+": "paper"}
"""Systems beside which the base is that of another one, without its initialisation."""


def run_free(lead_in: SavedBranch, unit: UnitSpec, plain: SavedBranch | None = None) -> FreeArm:
    """Run base and Dual-SLAM to the end.

    Up to the first breakage the two are identical bit for bit and run as one; the base then resumes from a
    snapshot just before it. With a ``plain`` lead-in, of the system in ``PLAIN``, it resumes from that.
    """
    seed, saved = unit.repeat_seed, lead_in
    stride = max(1, round(_SAVE_EVERY_S * lead_in.sequence.camera.fps))
    dual = lead_in.resume()
    while not (dual.at_end or dual.is_broken):
        if dual.frames - saved.frames >= stride:
            saved = dual.save()
        dual.step()
    base = saved.resume_as_base() if dual.is_broken else None
    if plain is not None:
        base = plain.resume_as_base()
    for branch in filter(None, (base, dual)):
        branch.feed(len(branch.sequence))
        branch.finish()
    record = dual.record(unit.system, seed)
    base_record = replace(record, system_kind="base") if base is None else base.record("base", seed)
    return FreeArm(base_record, record, dual.first_frame_of)


def run_crossing(lead_in: SavedBranch, exposure: Exposure) -> BranchRun:
    """Run every recovery thread over the whole exposed segment, even if tracking does not fail in it.

    The run ends as soon as a recovery has started and its threads have run.
    """
    branch = lead_in.resume()
    system = branch.system
    assert isinstance(system, DualSlam)
    system.cut()
    branch.feed(exposure.end_frame + 1)
    system.restart()
    while not (branch.at_end or branch.first_frame_of):
        branch.step()
    branch.finish()
    return branch
