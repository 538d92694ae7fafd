"""Tracking states and typed events, the system's only report of its actions."""

from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import ClassVar

from dslab.slam.core.relation import Relation
from dslab.slam.core.snapshot import Immutable

CANCELLED = "cancelled"
"""Stage of a recovery that was ended because nothing depended on it any more."""


class TrackingState(StrEnum):
    """State of the tracker after a frame."""

    NOT_INITIALIZED = "not_initialized"
    TRACKING = "tracking"
    LOST = "lost"
    RELOCALIZING = "relocalizing"


@dataclass(frozen=True, kw_only=True)
class Event(Immutable):
    """An event declared by the system at one frame.

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
        """Flat record for events.jsonl."""
        return {"event": self.kind, **asdict(self)}


@dataclass(frozen=True, kw_only=True)
class RelatingEvent(Event):
    """An event that asserts how two sides of a map lie to each other.

    Attributes:
        relation: what was asserted, for whoever judges it; kept in memory only, not among the record's
            fields. None from a system that does not say it.
    """

    relation: Relation | None = field(default=None, repr=False, compare=False)

    def record(self) -> dict:
        """Flat record for events.jsonl, without the relation."""
        record = super().record()
        del record["relation"]
        return record


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
class RescueStart(Event):
    """Features do not track a frame, but intensities place it: tracking goes on without a breakage.

    Attributes:
        reason: why features do not track it.
        inliers: map matches that there were.
    """

    kind: ClassVar[str] = "rescue_start"
    reason: str
    inliers: int


@dataclass(frozen=True, kw_only=True)
class RescueEnd(Event):
    """Features track again after frames that intensities placed, or a breakage follows.

    Attributes:
        success: features track again.
        frames: number of frames that intensities placed.
    """

    kind: ClassVar[str] = "rescue_end"
    success: bool
    frames: int


@dataclass(frozen=True, kw_only=True)
class PosesWithdrawn(Event):
    """Poses that were given are taken back, with the keyframes made meanwhile.

    Follows a breakage in which the map, or only its last frames, are doubted; a recovery may give these
    frames other poses. Or comes with a fusion: the recovery has passed over frames between the seam and the
    breakage (``passed_over_by_recovery``).

    Attributes:
        first_frame, last_frame: the first and last frame whose pose no longer counts.
        frames: number of these frames.
        keyframes: number of keyframes removed from the map.
        reason: what was doubted; that of the breakage, unless it followed unsteady frames.
    """

    kind: ClassVar[str] = "poses_withdrawn"
    first_frame: int
    last_frame: int
    frames: int
    keyframes: int
    reason: str


@dataclass(frozen=True, kw_only=True)
class Relocalized(RelatingEvent):
    """Tracking resumed in a lost map: a relocalized frame was confirmed by those that followed.

    Attributes:
        keyframe: frame index of the recognised keyframe.
        first_frame: the relocalized frame; the poses count from it on.
        inliers: map matches of the confirming frame.
        frames_lost, lost_s: frames and time since the breakage.
        believed: chance that the place is right, as believed then; None if no belief was asked.
    """

    kind: ClassVar[str] = "relocalized"
    keyframe: int
    first_frame: int
    inliers: int
    frames_lost: int
    lost_s: float
    believed: float | None = None


@dataclass(frozen=True, kw_only=True)
class RelocalizationWithdrawn(Event):
    """A frame seemed to be relocalized, but those that followed did not confirm it.

    Attributes:
        keyframe: frame index of the keyframe that seemed to be recognised.
        first_frame: the frame that seemed to be relocalized.
        frames: number of frames tracked from there, itself included; none of their poses counts.
        reason: ``disbelieved`` if another place was the likelier one for too long; ``map_in_use`` or
            ``maps_are_joined`` if the map became the current one meanwhile, or part of another; else why a
            frame could not be tracked there.
        believed: chance that the place is right, as believed then; None if no belief was asked.
    """

    kind: ClassVar[str] = "relocalization_withdrawn"
    keyframe: int
    first_frame: int
    frames: int
    reason: str
    believed: float | None = None


@dataclass(frozen=True, kw_only=True)
class LoopClosed(RelatingEvent):
    """A loop was closed: a place was recognised and the drift corrected.

    Attributes:
        keyframe, loop_keyframe: frame indices of the two keyframes.
        scale: factor by which lengths around the keyframe were corrected.
        matches: points that both keyframes share after the correction.
        cpu_ms: CPU milliseconds of detection and correction.
        believed: chance that the place is right, as believed then; None if no belief was asked.
    """

    kind: ClassVar[str] = "loop_closed"
    keyframe: int
    loop_keyframe: int
    scale: float
    matches: int
    cpu_ms: float
    believed: float | None = None


@dataclass(frozen=True, kw_only=True)
class LoopRefused(Event):
    """A place seemed to be recognised, but the evidence spoke against it; the map is unchanged.

    Attributes:
        keyframe, loop_keyframe: frame indices of the two keyframes.
        matches: points matched between them.
        reason: what spoke against it: ``disbelieved`` by the views around; with them by its own
            observations, ``map_is_torn``; or ``map_has_changed`` meanwhile.
        believed: chance that the place is right, as believed then; None if no belief was asked.
    """

    kind: ClassVar[str] = "loop_refused"
    keyframe: int
    loop_keyframe: int
    matches: int
    reason: str
    believed: float | None = None


@dataclass(frozen=True, kw_only=True)
class MapAdjusted(Event):
    """Global bundle adjustment after a loop closure was applied."""

    kind: ClassVar[str] = "map_adjusted"
    keyframes: int
    points: int
    cpu_ms: float


@dataclass(frozen=True, kw_only=True)
class CameraRefined(Event):
    """Lens or shutter were found to be other than the calibration says, and the map was adjusted to it.

    Attributes:
        k1, k2, p1, p2: residual distortion from now on, see ``PinholeCamera``.
        readout_s: time in which the rows of an image are read, 0 for a global shutter.
        shift_px: root mean square shift of the map's keypoints by this change.
        significance: of the change, chi-square with 5 degrees of freedom, with 4 for a global shutter.
        keyframes: keyframes of the map.
        cpu_ms: CPU milliseconds of the estimate.
    """

    kind: ClassVar[str] = "camera_refined"
    k1: float
    k2: float
    p1: float
    p2: float
    readout_s: float
    shift_px: float
    significance: float
    keyframes: int
    cpu_ms: float


@dataclass(frozen=True, kw_only=True)
class MapDropped(Event):
    """A map was dropped: too small to be kept, or not fit to be gone on with."""

    kind: ClassVar[str] = "map_dropped"
    reason: str
    keyframes: int


@dataclass(frozen=True, kw_only=True)
class MapSaved(Event):
    """The map was saved at a breakage, to be fused later."""

    kind: ClassVar[str] = "map_saved"
    keyframes: int
    points: int


@dataclass(frozen=True, kw_only=True)
class ReinitStart(Event):
    """Initialization of a new map starts; ``map_id`` is the new map's."""

    kind: ClassVar[str] = "reinit_start"


@dataclass(frozen=True, kw_only=True)
class ReinitDone(Event):
    """The new map is initialized."""

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
class PlacedKeyframe(Immutable):
    """Pose of a keyframe of the new map in the old map, by a recovery.

    Attributes:
        frame, stamp_s: index and time of its frame.
        T_old_cam: rows of the (4, 4) pose, camera to old map.
    """

    frame: int
    stamp_s: float
    T_old_cam: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, kw_only=True)
class RecoveryEnd(Event):
    """A recovery thread ended; ``stage`` is the failed stage: propagation, overlap or sim3, or empty.

    It is ``cancelled`` if the thread was ended because nothing depended on it any more: for the reason
    ``not_needed`` another thread had succeeded, for ``maps_are_joined`` a place was recognised meanwhile, for
    ``map_dropped`` the new map turned out to be begun from the wrong motion.

    Attributes:
        placed: on success, the keyframes that the new map had when the recovery started, as refined by it
            and moved by the estimated similarity; kept in memory only, not among the record's fields.
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
        """Flat record for events.jsonl, without the poses."""
        record = super().record()
        del record["placed"]
        return record


@dataclass(frozen=True, kw_only=True)
class MapCut(Event):
    """A healthy map was saved on request, as if tracking had been lost."""

    kind: ClassVar[str] = "map_cut"


@dataclass(frozen=True, kw_only=True)
class Fusion(RelatingEvent):
    """Two maps were fused, or a fusion was rejected; ``map_id`` is the map that remains.

    Attributes:
        old_map_id, new_map_id: the map that absorbs the other, and the other.
        by: ``recovery``, or ``place`` if a saved map was recognised by its place.
        scale: factor from the new map's lengths to the old map's.
        inliers: points matched between the two maps.
        reason: reason of a rejection.
        believed: chance that the place is right, as believed then; None if no belief was asked.
    """

    kind: ClassVar[str] = "fusion"
    old_map_id: int
    new_map_id: int
    by: str
    accepted: bool
    scale: float
    inliers: int
    reason: str
    believed: float | None = None
