"""Outcome of every declared breakage, from the events alone."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from dslab.sim.sequence import SegmentTruth
from dslab.slam.core.events import (
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
"""A breakage within this time after a segment's last frame is attributed to it: declaring takes time."""


@dataclass(frozen=True)
class BreakageOutcome:
    """A declared breakage and what followed, up to the next breakage of the same map.

    Attributes:
        breakage: the declaration.
        segment: index of the one injected segment that it counts for, None outside every segment: of those
            that act, or ended at most EXPOSURE_GRACE_S before, the one that started last, because what had
            acted for longer had been survived.
        segments: indices of that segment and all that overlap it, in order; for the audit of each.
        until_frame: first frame of the next breakage of the same map; None if there is none.
        reinit_frame: frame at which a new map was initialized; None if none was.
        recoveries: the ends of the recovery threads, in order.
        fusion: the last fusion attempted by a recovery; None without one.
        bridged: the fusion of a later map with an older one, by a recovery that went past the broken map;
            None without one.
        joined: the fusion of the broken map by place recognition; None without one.
        relocalized: the relocalization in the broken map; None without one.
        dropped: reason why the broken map was dropped at once; empty if it was kept.
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
        """True if the system declared that a recovery thread fused the maps."""
        return self.fusion is not None and self.fusion.accepted

    @property
    def repair(self) -> Fusion | Relocalized | None:
        """The first event by which the broken map came into use again; None without one."""
        found = (self.fusion if self.recovered else None, self.relocalized, self.joined)
        return min((e for e in found if e is not None), key=lambda e: e.frame, default=None)

    @property
    def recovered_by(self) -> RecoveryEnd | None:
        """The end of the recovery thread that led to the fusion; None if it was not recovered."""
        if not self.recovered or self.fusion is None:
            return None
        ended = [r for r in self.recoveries if r.success and r.frame <= self.fusion.frame]
        return ended[-1] if ended else None

    @property
    def healed(self) -> bool:
        """True if the broken map is in use again, by recovery, relocalization or place-based merging."""
        return self.repair is not None

    @property
    def failure_reason(self) -> str:
        """Reason why it was not healed; empty if it was."""
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
    """Index of the last segment that acts on a frame or ended at most EXPOSURE_GRACE_S before it.

    Of several that start at one frame it is the first listed.
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
    """Indices of the segment of a frame and of those that overlap it.

    A segment that ended before that one started is not included.
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
    """Every breakage in order, with its repair.

    A fusion, recovery or relocalization belongs to the last earlier breakage of its old map.
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
        recoveries=tuple(
            e
            for e in after
            if isinstance(e, RecoveryEnd) and e.old_map_id == breakage.map_id and e.stage != "cancelled"
        ),
        fusion=_last(e for e in fusions if e.by == "recovery"),
        bridged=across[0] if across else None,
        joined=_last(e for e in fusions if e.by == "place" and e.accepted),
        relocalized=found[0] if found else None,
        dropped=dropped[0] if dropped else "",
    )


def _spans(fusion: Fusion, breakage: Breakage, breakages: list[Breakage]) -> bool:
    """True if the fused maps lie before and after the broken map."""
    old = [b.frame for b in breakages if b.map_id == fusion.old_map_id and b.frame <= fusion.frame]
    return fusion.old_map_id < breakage.map_id < fusion.new_map_id and max(old, default=-1) < breakage.frame


def _last(fusions: Iterable[Fusion]) -> Fusion | None:
    return next(iter(reversed(tuple(fusions))), None)
