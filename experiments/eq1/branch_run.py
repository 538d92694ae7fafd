"""A run that can be saved between two frames, and go on from there any number of times."""

from dataclasses import dataclass

from dslab.experiments.runs.execution import Observer, RunRecord, exposure_of, record_of, without_features
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import Breakage, RecoveryStart
from dslab.slam.core.results import TrackingResult
from dslab.slam.core.snapshot import Snapshot
from dslab.slam.dual.dual_slam import DualSlam
from dslab.slam.system import MonocularSystem


@dataclass(frozen=True)
class Saved:
    """State of a run between two frames, from which any number of runs can resume.

    Attributes:
        snapshot: of the system.
        results: of the frames fed before.
        told: number of events after each of them.
    """

    snapshot: Snapshot
    results: tuple[TrackingResult, ...]
    told: tuple[int, ...]

    @property
    def frames(self) -> int:
        """Number of frames fed before."""
        return len(self.results)


class BranchRun:
    """A system at one point of its run over a sequence, with its results so far.

    Args:
        system: the SLAM system.
        sequence: its input.
        results, told: of the frames fed so far, as of ``Saved``.
        observer: called after every frame.

    Attributes:
        first_new_frame: first frame of the new map from which the first recovery started; None before it.
    """

    def __init__(
        self,
        system: MonocularSystem,
        sequence: Sequence,
        results: tuple[TrackingResult, ...] = (),
        observer: Observer | None = None,
        told: tuple[int, ...] = (),
    ) -> None:
        self.system = system
        self.sequence = sequence
        self.results, self._told = list(results), list(told)
        self._observer = observer
        self.first_new_frame: int | None = None

    @classmethod
    def resume(cls, saved: Saved, sequence: Sequence, as_base: bool = False) -> "BranchRun":
        """Go on from a saved state, over a sequence that is the same so far; ``as_base``: as the base."""
        system = saved.snapshot.restore()
        if as_base and isinstance(system, DualSlam):
            system = system.as_base()
        return cls(system, sequence, saved.results, told=saved.told)

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
        exposure = exposure_of(self.system, self.sequence, index)
        result = self.system.process(image, float(self.sequence.stamps_s[index]), *exposure)
        if self._observer is not None:
            self._observer.frame(image, result, self.system)
        self.results.append(without_features(result))
        self._told.append(len(self.system.events))
        for event in self.system.events[happened:]:
            if isinstance(event, RecoveryStart) and self.first_new_frame is None:
                paths = self.system.keyframe_trajectories()
                firsts = [int(path.frames[0]) for path in paths if path.map_id == event.map_id]
                self.first_new_frame = next(iter(firsts), None)

    def feed(self, until: int) -> None:
        """Feed the frames before ``until``."""
        while self.frames < until:
            self.step()

    def run_out(self) -> None:
        """Feed all frames that are left, and signal the end of the input."""
        self.feed(len(self.sequence))
        self.system.finish()

    def save(self) -> Saved:
        """Save the state."""
        return Saved(Snapshot.of(self.system), tuple(self.results), tuple(self._told))

    def record(self, kind: str, seed: int) -> RunRecord:
        """The record of the finished run, without its times."""
        return record_of(self.system, self.sequence, kind, seed, self.results, 0.0)
