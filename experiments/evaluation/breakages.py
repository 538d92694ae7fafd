"""What became of every declared breakage, read off the events and nothing else."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from sim.sequence import SegmentTruth
from slam.core.events import (
    Breakage,
    Event,
    Fusion,
    Initialized,
    MapDropped,
    RecoveryEnd,
    ReinitDone,
    Relocalized,
)

EXPOSURE_GRACE_S = 0.5
"""A breakage this long after a segment's last frame still counts as the segment's: declaring takes time."""


@dataclass(frozen=True)
class BreakageOutcome:
    """A declared breakage and what followed, up to the next breakage of the same map.

    Attributes:
        breakage: the declaration.
        segment: index of the injected segment in which it fell, None outside; of several that lie over one
            another, the one that began last.
        segments: indices of all of those, in order.
        until_frame: first frame of the next breakage of the same map, None where none came.
        reinit_frame: frame at which a new map stood, None if none did.
        recoveries: the ends of the recovery threads, in order.
        fusion: the last fusion that a recovery has led to, None if it never came to one.
        bridged: the fusion of a later map with an older one, by a recovery that went past the broken map;
            None where there was none.
        joined: the broken map was met again by place recognition and joined, None if it never was.
        relocalized: tracking going on in the broken map, None if it never did.
        dropped: why the broken map was thrown away at once, empty where it was kept.
    """

    breakage: Breakage
    segment: int | None
    segments: tuple[int, ...]
    until_frame: int | None
    reinit_frame: int | None
    recoveries: tuple[RecoveryEnd, ...]
    fusion: Fusion | None
    bridged: Fusion | None
    joined: Fusion | None
    relocalized: Relocalized | None
    dropped: str

    @property
    def recovered(self) -> bool:
        """A recovery thread brought the maps together, by the system's own word."""
        return self.fusion is not None and self.fusion.accepted

    @property
    def healed(self) -> bool:
        """The broken map is in use again, by recovery, by relocalization or by meeting it later."""
        return self.recovered or self.relocalized is not None or self.joined is not None

    @property
    def failure_reason(self) -> str:
        """Why it was not healed, empty if it was."""
        if self.healed:
            return ""
        if self.dropped:
            return f"map dropped: {self.dropped}"
        if self.bridged is not None:
            return "a recovery went past it, to an older map"
        if self.reinit_frame is None:
            return "no_reinit"
        if self.fusion is not None:
            return f"fusion: {self.fusion.reason}"
        last = self.recoveries[-1] if self.recoveries else None
        return f"{last.stage}: {last.reason}".strip(": ") if last else "no recovery was run"


def segment_of_frame(
    frame: int, stamp_s: float, segments: Sequence[SegmentTruth], stamps_s: Sequence[float]
) -> int | None:
    """The last segment that acts on a frame or ended at most EXPOSURE_GRACE_S before it, by its index.

    Of several that began on one frame it is the first listed.
    """
    exposed = [
        index
        for index, segment in enumerate(segments)
        if 0 <= segment.first_frame <= frame and stamp_s <= stamps_s[segment.last_frame] + EXPOSURE_GRACE_S
    ]
    return max(exposed, key=lambda index: (segments[index].first_frame, -index), default=None)


def segments_of_frame(
    frame: int, stamp_s: float, segments: Sequence[SegmentTruth], stamps_s: Sequence[float]
) -> tuple[int, ...]:
    """The segment of a frame and those that lay over it, by their indices.

    A segment that had ended when that one began has no part in it.
    """
    latest = segment_of_frame(frame, stamp_s, segments, stamps_s)
    if latest is None:
        return ()
    onset = segments[latest].first_frame
    return tuple(
        index
        for index, segment in enumerate(segments)
        if 0 <= segment.first_frame <= frame
        and segment.last_frame >= onset
        and stamp_s <= stamps_s[segment.last_frame] + EXPOSURE_GRACE_S
    )


def breakage_outcomes(
    events: Iterable[Event], segments: Sequence[SegmentTruth], stamps_s: Sequence[float]
) -> list[BreakageOutcome]:
    """Every breakage in order, with what mended it.

    A fusion, recovery or relocalization belongs to the last breakage of its old map before it.
    """
    events = list(events)
    breakages = [e for e in events if isinstance(e, Breakage)]
    return [_outcome(b, breakages, events, segments, stamps_s) for b in breakages]


def _outcome(
    breakage: Breakage,
    breakages: list[Breakage],
    events: list[Event],
    segments: Sequence[SegmentTruth],
    stamps_s: Sequence[float],
) -> BreakageOutcome:
    later = [b.frame for b in breakages if b.map_id == breakage.map_id and b.frame > breakage.frame]
    until = later[0] if later else None
    after = [e for e in events if e.frame >= breakage.frame and (until is None or e.frame < until)]
    reinit = [e.frame for e in after if isinstance(e, ReinitDone | Initialized) and e.frame > breakage.frame]
    dropped = [
        e.reason
        for e in after
        if isinstance(e, MapDropped) and (e.frame, e.map_id) == (breakage.frame, breakage.map_id)
    ]
    fusions = [e for e in after if isinstance(e, Fusion) and e.old_map_id == breakage.map_id]
    across = [
        e
        for e in after
        if isinstance(e, Fusion) and e.accepted and e.by == "recovery" and _spans(e, breakage, breakages)
    ]
    found = [e for e in after if isinstance(e, Relocalized) and e.map_id == breakage.map_id]
    return BreakageOutcome(
        breakage=breakage,
        segment=segment_of_frame(breakage.frame, breakage.stamp_s, segments, stamps_s),
        segments=segments_of_frame(breakage.frame, breakage.stamp_s, segments, stamps_s),
        until_frame=until,
        reinit_frame=reinit[0] if reinit else None,
        recoveries=tuple(e for e in after if isinstance(e, RecoveryEnd) and e.old_map_id == breakage.map_id),
        fusion=_last(e for e in fusions if e.by == "recovery"),
        bridged=across[0] if across else None,
        joined=_last(e for e in fusions if e.by == "place"),
        relocalized=found[0] if found else None,
        dropped=dropped[0] if dropped else "",
    )


def _spans(fusion: Fusion, breakage: Breakage, breakages: list[Breakage]) -> bool:
    """Whether what a fusion has joined lay before and after the broken map."""
    old = [b.frame for b in breakages if b.map_id == fusion.old_map_id and b.frame <= fusion.frame]
    return fusion.old_map_id < breakage.map_id < fusion.new_map_id and max(old, default=-1) < breakage.frame


def _last(fusions: Iterable[Fusion]) -> Fusion | None:
    return next(iter(reversed(tuple(fusions))), None)
