"""What Dual-SLAM asks of an odometry, and a system of it that is given frames of a sequence."""

from collections.abc import Callable
from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.relation import PlacedFrames, Relation
from dslab.slam.core.results import MapTrajectory, TrackingResult
from dslab.slam.framework.watcher import Watcher


@dataclass(frozen=True)
class Parts:
    """Which parts of the protocol a system has; declared by whoever brings it.

    Attributes:
        losses: it says itself when it is lost; else it is watched.
        returns: lost, it may find its way back in the same map, and goes on being given frames.
        points: its maps have points.
        exposures: ``process`` takes the exposure of an image, where it is known.
    """

    losses: bool = True
    returns: bool = False
    points: bool = False
    exposures: bool = False

    @property
    def words(self) -> str:
        """Those that it has, or what stands in for them."""
        said = ["losses" if self.losses else "is watched"]
        said += [name for name in ("returns", "points", "exposures") if getattr(self, name)]
        return ", ".join(said)


class Odometry(Protocol):
    """A system that is given frames in the order of their stamps, which rise.

    ``process`` returns the outcome of a frame, of which pose, map, state and inliers are read. ``events`` are
    all so far; a ``Breakage`` among them is a loss that it declares. ``trajectories()`` are the poses so far,
    as they are now; ``map_points`` may be empty.
    """

    @property
    def events(self) -> list[ev.Event]: ...
    @property
    def camera(self) -> PinholeCamera: ...
    @property
    def process(self) -> Callable[..., TrackingResult]: ...
    def finish(self) -> None: ...
    def trajectories(self) -> list[MapTrajectory]: ...
    def keyframe_trajectories(self) -> list[MapTrajectory]: ...
    def map_points(self, map_id: int) -> np.ndarray: ...


Begin = Callable[[int, int, Many[int] | None], Odometry]
"""Begins a system of (seed, first, backward): ``first`` is the first frame that it is given; ``backward``
all of them, newest first, or None for those from ``first`` on."""


@dataclass(frozen=True)
class Kind:
    """A kind of odometry, of which any number can be begun.

    Attributes:
        name: of the system.
        parts: that it has.
        begin: begins one.
    """

    name: str
    parts: Parts
    begin: Begin


@dataclass(frozen=True, eq=False)
class GivenFrame:
    """A frame as it came.

    Attributes:
        index: of it in the sequence.
        stamp_s: its time.
        image: (H, W) uint8.
        exposure_s: its exposure, if it is known, as the rest of the arguments of ``process``.
    """

    index: int
    stamp_s: float
    image: np.ndarray
    exposure_s: tuple[float, ...] = ()


_FRAME_FIELDS = ("frame", "keyframe", "loop_keyframe", "first_frame", "last_frame")
_OF_THE_FRAME = (ev.Breakage, ev.MapSaved, ev.MapDropped, ev.ReinitStart, ev.ReinitDone)
"""Events that Dual-SLAM declares itself."""


class Fed:
    """A system of one kind that is given frames of a sequence, forward or backward in time.

    Args:
        kind: of the system.
        seed: of it.
        first, backward: as of ``Begin``.

    Attributes:
        system: the system.
        parts: of its kind.
        frames: indices in the sequence of the frames that it was given.
        result: the outcome of the last one.
    """

    def __init__(self, kind: Kind, seed: int, first: int, backward: Many[int] | None = None) -> None:
        self.system = kind.begin(seed, first, backward)
        self.parts = kind.parts
        self.frames: list[int] = []
        self.result: TrackingResult | None = None
        self._is_backward, self._first_s = backward is not None, 0.0
        self._map_id: int | None = None  # its own, of its last pose
        self._lost_at: set[int] = set()  # rows of frames whose poses do not count
        self._heard = self._told = 0  # events that were looked at, and passed on
        self._watcher = None if kind.parts.losses else Watcher()
        self._is_over = False

    @property
    def is_begun(self) -> bool:
        """True if it has had a pose."""
        return self._map_id is not None

    @property
    def is_lost(self) -> bool:
        """True if it was lost with the last frame."""
        return len(self.frames) - 1 in self._lost_at

    def feed(self, frame: GivenFrame) -> str:
        """Give it a frame; why it is lost with it, or nothing. A lost one that finds back is lost no more."""
        if not self.frames:
            self._first_s = frame.stamp_s
        stamp_s = self._first_s - frame.stamp_s if self._is_backward else frame.stamp_s
        exposure = frame.exposure_s if self.parts.exposures else ()
        was_lost = self.is_lost
        result = self.result = self.system.process(frame.image, stamp_s, *exposure)
        self.frames.append(frame.index)
        T = result.T_map_cam if not was_lost or result.map_id == self._map_id else None
        events = self.system.events
        broken = [e for e in events[self._heard :] if isinstance(e, ev.Breakage)]
        self._heard = len(events)
        reason = broken[-1].reason if broken else ""
        if T is None and self.is_begun and (was_lost or self._watcher is not None):
            reason = reason or result.reason or "no_pose"
        elif T is not None and self._watcher is not None:
            reason = reason or self._watcher.suspicion(T)
        if reason and self.is_begun:
            self._lost_at.add(len(self.frames) - 1)
            return reason
        if T is not None:
            self._map_id = result.map_id
        return ""

    @property
    def cpu_ms(self) -> float:
        """CPU of the last frame, as it says itself, mapping and loops included."""
        assert self.result is not None
        return sum(self.result.cpu_ms.values()) + self.result.mapping_cpu_ms + self.result.loop_cpu_ms

    def finish(self) -> None:
        """End its input; its poses are final then."""
        if not self._is_over:
            self._is_over = True
            self.system.finish()

    def news(self, map_id: int) -> list[ev.Event]:
        """What it has said since it was last asked, in the frames of the sequence; losses are left out."""
        said = self.system.events[self._told :]
        self._told += len(said)
        return [self._told_of(event, map_id) for event in said if not isinstance(event, _OF_THE_FRAME)]

    def poses(self) -> dict[int, np.ndarray]:
        """(4, 4) poses, camera to its map, as they are now, by frame; those of its last map alone."""
        for path in self.system.trajectories():
            if path.map_id == self._map_id:
                rows = zip(path.frames.tolist(), path.T_map_cam, strict=True)
                return {self.frames[row]: T for row, T in rows if row not in self._lost_at}
        return {}

    def keyframes(self) -> list[int]:
        """Frames that are keyframes of its last map."""
        paths = self.system.keyframe_trajectories()
        return [self.frames[k] for p in paths if p.map_id == self._map_id for k in p.frames.tolist()]

    def points(self) -> np.ndarray:
        """(N, 3) points of its last map."""
        empty = self._map_id is None or not self.parts.points or not self.poses()
        return np.empty((0, 3)) if empty else self.system.map_points(self._map_id)

    def _told_of(self, event: ev.Event, map_id: int) -> ev.Event:
        changes: dict[str, Any] = {"map_id": map_id}
        for name in _FRAME_FIELDS:
            if hasattr(event, name):
                changes[name] = self.frames[getattr(event, name)]
        if isinstance(event, ev.RelatingEvent) and event.relation is not None:
            sides = (self._placed(event.relation.old), self._placed(event.relation.new))
            changes["relation"] = Relation(*sides, event.relation.depth)
        return replace(event, **changes)

    def _placed(self, side: PlacedFrames) -> PlacedFrames:
        return PlacedFrames(np.array(self.frames)[side.frames], side.stamps_s, side.T_map_cam)
