"""States and typed events: the only way the outside learns what the system did."""

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import ClassVar

from slam.core.snapshot import Unchanging


class TrackingState(StrEnum):
    """State of the tracker after a frame."""

    NOT_INITIALIZED = "not_initialized"
    TRACKING = "tracking"
    LOST = "lost"
    RELOCALIZING = "relocalizing"


@dataclass(frozen=True, kw_only=True)
class Event(Unchanging):
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
class Relocalized(Event):
    """Tracking goes on in a map that was lost; ``keyframe`` is the frame of the keyframe that was recognised.

    Attributes:
        frames_lost, lost_s: frames and time since the breakage.
    """

    kind: ClassVar[str] = "relocalized"
    keyframe: int
    inliers: int
    frames_lost: int
    lost_s: float


@dataclass(frozen=True, kw_only=True)
class LoopClosed(Event):
    """A place was seen again and the drift since taken out.

    Attributes:
        keyframe, loop_keyframe: frames of the two keyframes.
        scale: factor by which lengths about the keyframe were corrected.
        matches: points that both ends then shared.
        cpu_ms: of detection and correction.
    """

    kind: ClassVar[str] = "loop_closed"
    keyframe: int
    loop_keyframe: int
    scale: float
    matches: int
    cpu_ms: float


@dataclass(frozen=True, kw_only=True)
class MapAdjusted(Event):
    """Global bundle adjustment after a loop has been applied."""

    kind: ClassVar[str] = "map_adjusted"
    keyframes: int
    points: int
    cpu_ms: float


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


@dataclass(frozen=True)
class PlacedKeyframe(Unchanging):
    """Where a recovery has found a keyframe of the new map to be in the old one.

    Attributes:
        frame, stamp_s: its frame.
        T_old_cam: rows of the (4, 4) pose, camera to old map.
    """

    frame: int
    stamp_s: float
    T_old_cam: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, kw_only=True)
class RecoveryEnd(Event):
    """A recovery thread ended. ``stage`` is where it failed: propagation, overlap, sim3; empty on success.

    Attributes:
        placed: on success, the keyframes that the new map had when the recovery started, as going back has
            refined them, moved by the similarity that was found.
    """

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
    placed: tuple[PlacedKeyframe, ...] = ()

    def record(self) -> dict:
        """A record for events.jsonl, in lists all through."""
        placed = [{**vars(k), "T_old_cam": [list(row) for row in k.T_old_cam]} for k in self.placed]
        return {**super().record(), "placed": placed}


@dataclass(frozen=True, kw_only=True)
class MapCut(Event):
    """Laboratory: a healthy map was saved as if tracking had been lost."""

    kind: ClassVar[str] = "map_cut"


@dataclass(frozen=True, kw_only=True)
class Fusion(Event):
    """Two maps were or were not fused; ``map_id`` is the map that is left.

    Attributes:
        old_map_id, new_map_id: the map that took the other in, and the other.
        by: ``recovery``, or ``place`` where a saved map was met again without one.
        scale: takes the new map's lengths to the old map's.
        inliers: points that were found to be the same.
        reason: why it was refused.
    """

    kind: ClassVar[str] = "fusion"
    old_map_id: int
    new_map_id: int
    by: str
    accepted: bool
    scale: float
    inliers: int
    reason: str
