"""A sequence: frames, times, camera and, where known, the truth.

A frame's stamp is the centre of its exposure, and its true pose is the camera's pose at that moment.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from dslab.sim.sensors.camera import Intrinsics


@dataclass(frozen=True)
class SegmentTruth:
    """One injected segment and when it truly acts on the frames.

    Attributes:
        kind: as in the scenario.
        severity: the scenario's parameters of the segment.
        start_s, end_s: as in the scenario, sequence time.
        first_frame, last_frame: first and last frame (inclusive) on which it truly acts, -1 if on none.
        measure: the column of ``Sequence.frame_truth`` with its strength on each frame.
        threshold: the measure from which on it counts as acting.
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
    def from_record(cls, record: Any, frames: int) -> "SegmentTruth":
        """Build the truth from its record in a file.

        Args:
            record: fields, as of ``dataclasses.asdict``.
            frames: number of frames of the sequence.

        Raises:
            ValueError: a field is missing, unknown, of another type, or names frames out of order or outside
                the sequence.
        """
        if not isinstance(record, dict):
            raise ValueError("is no mapping")
        try:
            truth = cls(**{**record, "runs": tuple(tuple(run) for run in record.get("runs", ()))})
        except TypeError as error:
            raise ValueError(str(error).rpartition("__init__() ")[2]) from None
        truth._check(frames)
        return truth

    def _check(self, frames: int) -> None:
        """Raise ValueError naming the first field that is not as stated above."""
        spans = ((self.first_frame, self.last_frame), *self.runs)
        start_s = self.start_s if _is_number(self.start_s) else math.inf
        flat = [frame for run in self.runs for frame in run]
        checks = {
            "kind": isinstance(self.kind, str) and self.kind,
            "severity": isinstance(self.severity, dict),
            "start_s": start_s < math.inf,
            "end_s": _is_number(self.end_s) and self.end_s >= start_s,
            "first_frame or last_frame": all(_is_whole(frame) for frame in spans[0]),
            "measure": isinstance(self.measure, str),
            "threshold": _is_number(self.threshold),
            "runs": all(len(run) == 2 and all(map(_is_whole, run)) for run in self.runs),
        }
        for name, holds in checks.items():
            if not holds:
                raise ValueError(f"its {name} is not valid")
        first, last = spans[0]
        if not (first == last == -1 or 0 <= first <= last < frames):
            raise ValueError(f"frames {first} to {last} are not in the sequence")
        if flat and (flat != sorted(flat) or (flat[0], flat[-1]) != spans[0]):
            raise ValueError(f"its runs do not go from {first} to {last}")

    def mask(self, frames: int) -> np.ndarray:
        """(frames,) bool: frames of the sequence on which the segment acts."""
        acts = np.zeros(frames, bool)
        whole = ((self.first_frame, self.last_frame),) if self.first_frame >= 0 else ()
        for first, last in self.runs or whole:
            acts[first : last + 1] = True
        return acts

    def among(self, kept: np.ndarray) -> "SegmentTruth":
        """The truth after only the frames ``kept``, (n,) increasing indices, remain."""
        whole = ((self.first_frame, self.last_frame),) if self.first_frame >= 0 else ()
        left: list[tuple[int, int]] = []
        for first, last in (_range_in(kept, *run) for run in self.runs or whole):
            if first > last:
                continue
            # The frames between two runs may be gone.
            joined = bool(left) and left[-1][1] + 1 == first
            left.append((left.pop()[0] if joined else first, last))
        first_frame, last_frame = (left[0][0], left[-1][1]) if left else (-1, -1)
        runs = tuple(left) if self.runs else ()
        return replace(self, first_frame=first_frame, last_frame=last_frame, runs=runs)


class FrameSource(Protocol):
    """Random access to gray frames. One that has them in colour too has ``colour``: see ``colour_frame``."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) uint8."""
        ...


@dataclass(frozen=True)
class Sequence:
    """Frames, camera and ground truth of one sequence.

    Attributes:
        name: scenario or folder name.
        camera: intrinsics.
        stamps_s: (N,) float64, strictly increasing.
        frames: N gray images.
        T_world_cam: (N, 4, 4) float64, NaN where unknown for a frame; None without ground truth.
        depths: N depth images (H, W) float32, metres, or None.
        segments: injected segments, empty for a real recording.
        meta: spec, seed, versions, GL renderer.
        frame_truth: effect of the segments on each frame, (N,) float64 each: ``blur_px``, ``exposure_s``,
            ``faded_share``, ``swing_degps``; empty for a real recording.
        image_names: N file names relative to the folder of the frames; empty without files.
        exposure_s: (N,) float64 positive shutter times that the brightness of frames is proportional to; None
            where they are not known or it does not follow them, as in rendered frames.
        stamps_ns: (N,) int64 the stamps in nanoseconds, as read, where float64 seconds do not hold them; None
            where they do.
        source: what it was opened as: a folder, a file or the name of a scenario; empty if it was made.
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
    image_names: tuple[str, ...] = ()
    exposure_s: np.ndarray | None = None
    stamps_ns: np.ndarray | None = None
    source: str = ""

    def __len__(self) -> int:
        return len(self.stamps_s)

    def only(self, kept: np.ndarray) -> "Sequence":
        """The sequence reduced to the frames ``kept``, (n,) increasing int indices."""
        kept = np.asarray(kept, int)
        return replace(
            self,
            stamps_s=self.stamps_s[kept],
            frames=ChosenFrames(self.frames, kept),
            T_world_cam=None if self.T_world_cam is None else self.T_world_cam[kept],
            depths=None if self.depths is None else ChosenFrames(self.depths, kept),
            segments=tuple(segment.among(kept) for segment in self.segments),
            frame_truth={name: column[kept] for name, column in self.frame_truth.items()},
            exposure_s=None if self.exposure_s is None else self.exposure_s[kept],
            image_names=tuple(self.image_names[i] for i in kept) if self.image_names else (),
            stamps_ns=None if self.stamps_ns is None else self.stamps_ns[kept],
        )

    def first(self, time_s: float) -> "Sequence":
        """The sequence reduced to the frames less than ``time_s`` after the first one."""
        return self.only(np.flatnonzero(self.stamps_s - self.stamps_s[0] < time_s))

    def kinds_at(self, frame: int) -> tuple[str, ...]:
        """Kinds of the segments whose frame range contains a frame, by onset."""
        inside = [s for s in self.segments if 0 <= s.first_frame <= frame <= s.last_frame]
        return tuple(s.kind for s in sorted(inside, key=lambda s: s.first_frame))


class ChosenFrames:
    """Selected frames of another source, by increasing int indices (n,)."""

    def __init__(self, source: FrameSource, kept: np.ndarray) -> None:
        self._source, self._kept = source, kept

    def __len__(self) -> int:
        return len(self._kept)

    def __getitem__(self, index: int) -> np.ndarray:
        return self._source[int(self._kept[index])]

    def colour(self, index: int) -> np.ndarray:
        """See ``colour_frame``."""
        return colour_frame(self._source, int(self._kept[index]))


class InColour:
    """A source whose frames are those in colour, to be written: what is judged and tracked is gray.

    Args:
        source: of gray frames; without colour it gives these.
    """

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self.is_coloured = is_coloured(source)

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W, 3) uint8 blue, green, red, or (H, W) of a source without colour."""
        image = colour_frame(self._source, index) if self.is_coloured else self._source[index]
        return np.dstack([image] * 3) if self.is_coloured and image.ndim == 2 else image


def colour_frame(source: FrameSource, index: int) -> np.ndarray:
    """(H, W, 3) uint8 frame in blue, green and red, or the (H, W) gray one where the source has no colour."""
    colour = getattr(source, "colour", None)
    return source[index] if colour is None else colour(index)


def is_coloured(source: FrameSource) -> bool:
    """Whether the first, the middle or the last frame shows colour: equal channels are gray."""
    if not len(source) or not hasattr(source, "colour"):
        return False
    some = (colour_frame(source, index) for index in sorted({0, len(source) // 2, len(source) - 1}))
    return any(image.ndim == 3 and bool((image != image[..., :1]).any()) for image in some)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _range_in(kept: np.ndarray, first: int, last: int) -> tuple[int, int]:
    """First and last index into ``kept`` in [first, last], reversed if none."""
    return int(np.searchsorted(kept, first, "left")), int(np.searchsorted(kept, last, "right")) - 1
