"""A sequence: frames, times, camera and, where known, the truth.

A frame's stamp is the centre of its exposure, and its true pose is the camera's pose at that moment.
"""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from sim.camera import Intrinsics


@dataclass(frozen=True)
class SegmentTruth:
    """One injected segment and when it truly acts on the frames.

    Attributes:
        kind: as in the scenario.
        severity: the scenario's parameters of the segment.
        start_s, end_s: as asked for, sequence time.
        first_frame, last_frame: first and last frame (inclusive) on which it truly acts, -1 if on none.
        measure: the column of ``Sequence.frame_truth`` that says how much it acts on each frame.
        threshold: the measure from which on it is said to act.
        runs: first and last frame (inclusive) of every unbroken run on which it acts, from ``first_frame``
            to ``last_frame``; empty where only those two are known.
    """

    kind: str
    severity: dict[str, float | str]
    start_s: float
    end_s: float
    first_frame: int
    last_frame: int
    measure: str = ""
    threshold: float = 0.0
    runs: tuple[tuple[int, int], ...] = ()

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> "SegmentTruth":
        """The truth from its fields as JSON holds them. Raises TypeError or ValueError if they are others."""
        runs = tuple((int(first), int(last)) for first, last in record.get("runs", ()))
        return cls(**{**record, "runs": runs})

    def mask(self, frames: int) -> np.ndarray:
        """(frames,) bool: the frames of a sequence of so many on which it truly acts."""
        acts = np.zeros(frames, bool)
        whole = ((self.first_frame, self.last_frame),) if self.first_frame >= 0 else ()
        for first, last in self.runs or whole:
            acts[first : last + 1] = True
        return acts


class FrameSource(Protocol):
    """Random access to gray frames."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) uint8."""
        ...


@dataclass(frozen=True)
class Sequence:
    """What a SLAM run is fed from and judged against.

    Attributes:
        name: scenario or folder name.
        camera: intrinsics.
        stamps_s: (N,) float64, strictly increasing.
        frames: N gray images.
        T_world_cam: (N, 4, 4) float64, NaN where unknown for a frame; None without ground truth.
        depths: N depth images (H, W) float32, metres, or None.
        segments: injected segments, empty for real footage.
        meta: spec, seed, versions, GL renderer.
        frame_truth: what the segments do to each frame, (N,) float64 each: ``blur_px``, ``exposure_s``,
            ``faded_share``, ``swing_degps``; empty for real footage.
    """

    name: str
    camera: Intrinsics
    stamps_s: np.ndarray
    frames: FrameSource
    T_world_cam: np.ndarray | None
    depths: FrameSource | None
    segments: tuple[SegmentTruth, ...]
    meta: dict
    frame_truth: dict[str, np.ndarray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.stamps_s)

    def kinds_at(self, frame: int) -> tuple[str, ...]:
        """Kinds of the segments between whose first and last frame a frame lies, by their onset."""
        inside = [s for s in self.segments if 0 <= s.first_frame <= frame <= s.last_frame]
        return tuple(s.kind for s in sorted(inside, key=lambda s: s.first_frame))
