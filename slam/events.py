"""States and typed events: the only way the outside learns what the system did."""

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import ClassVar


class TrackingState(StrEnum):
    """State of the tracker after a frame."""

    NOT_INITIALIZED = "not_initialized"
    TRACKING = "tracking"
    LOST = "lost"


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something the system declared, at one frame.

    Attributes:
        frame: index of the frame, from 0.
        stamp_s: its time stamp.
        map_id: the map concerned.
    """

    kind: ClassVar[str] = "event"
    frame: int
    stamp_s: float
    map_id: int

    def record(self) -> dict:
        """A flat record for events.jsonl."""
        return {"event": self.kind, **asdict(self)}


@dataclass(frozen=True, kw_only=True)
class Initialized(Event):
    """A two-view map was accepted."""

    kind: ClassVar[str] = "initialized"
    points: int
    model: str


@dataclass(frozen=True, kw_only=True)
class Breakage(Event):
    """Tracking was lost."""

    kind: ClassVar[str] = "breakage"
    reason: str
    inliers: int


@dataclass(frozen=True, kw_only=True)
class MapDropped(Event):
    """A map too young to be worth keeping was discarded."""

    kind: ClassVar[str] = "map_dropped"
    reason: str
    keyframes: int


@dataclass(frozen=True, kw_only=True)
class MapSaved(Event):
    """The map was kept at a breakage, to be fused later."""

    kind: ClassVar[str] = "map_saved"
    keyframes: int
    points: int


@dataclass(frozen=True, kw_only=True)
class ReinitStart(Event):
    """A new map is sought from the incoming frames; ``map_id`` is the new map's."""

    kind: ClassVar[str] = "reinit_start"


@dataclass(frozen=True, kw_only=True)
class ReinitDone(Event):
    """The new map stands."""

    kind: ClassVar[str] = "reinit_done"
    frames_taken: int


@dataclass(frozen=True, kw_only=True)
class RecoveryStart(Event):
    """Recovery thread ``thread`` (from 1) starts backward over the buffer; ``map_id`` is the new map's."""

    kind: ClassVar[str] = "recovery_start"
    thread: int
    method: str
    old_map_id: int
    buffered_frames: int


@dataclass(frozen=True, kw_only=True)
class RecoveryEnd(Event):
    """A recovery thread ended. ``stage`` is where it failed: propagation, overlap, sim3; empty on success."""

    kind: ClassVar[str] = "recovery_end"
    thread: int
    method: str
    old_map_id: int
    success: bool
    stage: str
    reason: str
    frames_covered: int
    frames_passed_over: int
    inliers: int
    cpu_ms: float


@dataclass(frozen=True, kw_only=True)
class Fusion(Event):
    """Two maps were or were not fused; ``scale`` takes the new map's lengths to the old map's."""

    kind: ClassVar[str] = "fusion"
    old_map_id: int
    accepted: bool
    scale: float
    inliers: int
    reason: str
