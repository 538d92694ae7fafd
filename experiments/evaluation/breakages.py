"""Outcome of every declared breakage, from the events alone."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from dslab.sim.sequence import SegmentTruth
from dslab.slam.core.events import (
    Breakage,
    Event,
    Fusion,
    Initialized,
    MapDropped,
    RecoveryEnd,
    ReinitDone,
    RelocalizationWithdrawn,
    Relocalized,
)

T = TypeVar("T")
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
        refused: relocalizations in it that later frames did not confirm.
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
    refused: tuple[RelocalizationWithdrawn, ...]
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
        """Reason why it was not healed, with the relocalizations that were refused; empty if it was."""
        if self.healed:
            return ""
        if not self.refused:
            return self._reason
        many = f"{len(self.refused)} relocalization{'s' if len(self.refused) > 1 else ''} refused"
        (commonest, _), *others = Counter(e.reason for e in self.refused).most_common()
        return f"{self._reason}; {many}: {'mostly ' if others else ''}{commonest}"

    @property
    def _reason(self) -> str:
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
    exposed = _exposed(frame, stamp_s, segments, stamps_s)
    return max(exposed, key=lambda index: (segments[index].first_frame, -index), default=None)


def _exposed(
    frame: int, stamp_s: float, segments: Sequence[SegmentTruth], stamps_s: Sequence[float]
) -> list[int]:
    return [
        index
        for index, segment in enumerate(segments)
        if 0 <= segment.first_frame <= frame and stamp_s <= stamps_s[segment.last_frame] + EXPOSURE_GRACE_S
    ]


def breakage_outcomes(
    events: Iterable[Event], segments: Sequence[SegmentTruth], stamps_s: Sequence[float]
) -> list[BreakageOutcome]:
    """Every breakage in order, with its repair.

    A fusion, recovery or relocalization belongs to the last earlier breakage of its old map.
    """
    events = list(events)
    breakages = [e for e in events if isinstance(e, Breakage)]
    found = []
    for breakage in breakages:
        frame, map_id = breakage.frame, breakage.map_id
        latest = segment_of_frame(frame, breakage.stamp_s, segments, stamps_s)
        # A segment that ended before that one started does not overlap it.
        overlapping = [
            index
            for index in _exposed(frame, breakage.stamp_s, segments, stamps_s)
            if latest is not None and segments[index].last_frame >= segments[latest].first_frame
        ]
        until = next((b.frame for b in breakages if b.map_id == map_id and b.frame > frame), None)
        after = [e for e in events if e.frame >= frame and (until is None or e.frame < until)]
        of_map = [e for e in after if isinstance(e, Fusion | RecoveryEnd) and e.old_map_id == map_id]
        fusions = [e for e in of_map if isinstance(e, Fusion)]
        found.append(
            BreakageOutcome(
                breakage=breakage,
                segment=latest,
                segments=tuple(overlapping),
                until_frame=until,
                reinit_frame=_first(
                    e.frame for e in after if isinstance(e, ReinitDone | Initialized) and e.frame > frame
                ),
                recoveries=tuple(e for e in of_map if isinstance(e, RecoveryEnd) and e.stage != "cancelled"),
                fusion=_first(e for e in reversed(fusions) if e.by == "recovery"),
                bridged=_first(e for e in after if isinstance(e, Fusion) and _spans(e, breakage, breakages)),
                joined=_first(e for e in reversed(fusions) if e.by == "place" and e.accepted),
                relocalized=_first(e for e in after if isinstance(e, Relocalized) and e.map_id == map_id),
                refused=tuple(
                    e for e in after if isinstance(e, RelocalizationWithdrawn) and e.map_id == map_id
                ),
                dropped=_first(
                    e.reason
                    for e in after
                    if isinstance(e, MapDropped) and (e.frame, e.map_id) == (frame, map_id)
                )
                or "",
            )
        )
    return found


def _spans(fusion: Fusion, breakage: Breakage, breakages: list[Breakage]) -> bool:
    """True for maps that lie before and after the broken one, fused by a recovery."""
    old = [b.frame for b in breakages if b.map_id == fusion.old_map_id and b.frame <= fusion.frame]
    across = fusion.old_map_id < breakage.map_id < fusion.new_map_id
    return fusion.accepted and fusion.by == "recovery" and across and max(old, default=-1) < breakage.frame


def _first(found: Iterable[T]) -> T | None:
    return next(iter(found), None)
