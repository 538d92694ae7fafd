"""Lanes of a run: its states over time, from its results and events alone."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from experiments.evaluation.frame_outcomes import FrameOutcome, frame_outcomes
from experiments.evaluation.summary import is_tracked
from experiments.recording import palette
from experiments.recording.palette import Color
from experiments.runs.execution import RunRecord
from slam.core.events import Event, Fusion, RecoveryEnd, RecoveryStart

MARK_SHARE = 0.08
"""Length of a momentary event, as a share of the run, so that its label is readable."""

_STATE_WORDS = {"not_initialized": "initialising"}


@dataclass
class Lane:
    """One row of the timeline.

    Attributes:
        name: one word.
        changes: (frame, value) in order of frames; a value holds until the next, empty for none.
        colors: colour of every value.
    """

    name: str
    changes: list[tuple[int, str]] = field(default_factory=list)
    colors: dict[str, Color] = field(default_factory=dict)

    def add(self, frame: int, value: str, color: Color | None = None) -> None:
        """Set the value from a frame on; a later call for the frame replaces it."""
        if self.changes and self.changes[-1][0] == frame:
            self.changes.pop()
        if not self.changes or self.changes[-1][1] != value:
            self.changes.append((frame, value))
        if color is not None:
            self.colors[value] = color

    def at(self, frame: int) -> str:
        """Value at a frame."""
        return next((value for f, value in reversed(self.changes) if f <= frame), "")


def system_lanes(record: RunRecord) -> list[Lane]:
    """Lanes of state, events, each recovery thread, and final outcome of each frame."""
    return [_states(record), _marks(record), *_recoveries(record), _outcomes(record)]


def segment_lane(record: RunRecord) -> Lane:
    """Lane of injected segments; overlapping segments share a value, in the last one's colour."""
    lane = Lane("segment")
    for frame in range(len(record.results)):
        kinds = record.sequence.kinds_at(frame)
        label = " + ".join(kinds).replace("_", " ")
        lane.add(frame, label, palette.segment_color(kinds[-1]) if kinds else None)
    return lane


def _states(record: RunRecord) -> Lane:
    lane = Lane("state")
    several = len({r.map_id for r in record.results if is_tracked(r)}) > 1
    for result in record.results:
        state = str(result.state)
        word = _STATE_WORDS.get(state, state)
        if several and is_tracked(result):
            word += f", map {result.map_id}"
        lane.add(result.frame, word, palette.STATES.get(state, palette.NOTE))
    return lane


def _marks(record: RunRecord) -> Lane:
    """Lane of breakages, recoveries and other events; a mark ends when the next begins."""
    lane = Lane("events")
    length = _mark_frames(record)
    ends_at: int | None = None
    for frame, value, color in _mark_list(record.events):
        if ends_at is not None and ends_at < frame:
            lane.add(ends_at, "")
        lane.add(frame, value, color)
        ends_at = frame + length
    if ends_at is not None and ends_at < len(record.results):
        lane.add(ends_at, "")
    return lane


def _mark_list(events: Iterable[Event]) -> list[tuple[int, str, Color]]:
    """Marks as (frame, label, colour); events of one frame share a mark."""
    marks: list[tuple[int, str, Color]] = []
    for event in events:
        found = _mark(event)
        if found is None:
            continue
        label, color = found
        if marks and marks[-1][0] == event.frame:
            label = f"{marks.pop()[1]}, {label}"
        marks.append((event.frame, label, color))
    return marks


def _mark(event: Event) -> tuple[str, Color] | None:
    if isinstance(event, Fusion):
        if not event.accepted:
            return "fusion refused", palette.REFUSED
        by_place = event.record().get("by") == "place"
        return "fused by place" if by_place else "fused", palette.FUSED
    return _MARKS.get(event.kind)


_MARKS: dict[str, tuple[str, Color]] = {
    "breakage": ("breakage", palette.LOST),
    "map_cut": ("map cut", palette.LOST),
    "map_dropped": ("map dropped", palette.REFUSED),
    "relocalized": ("relocalized", palette.FUSED),
    "loop_closed": ("loop closed", palette.NOTE),
}


def _recoveries(record: RunRecord) -> list[Lane]:
    """One lane per recovery thread: at work, then its outcome as a mark."""
    threads = sorted({e.thread for e in record.events if isinstance(e, RecoveryStart | RecoveryEnd)})
    return [_recovery(record, thread) for thread in threads]


def _recovery(record: RunRecord, thread: int) -> Lane:
    lane = Lane(f"recovery_{thread}")
    length = _mark_frames(record)
    ends_at: int | None = None
    for event in record.events:
        if not isinstance(event, RecoveryStart | RecoveryEnd) or event.thread != thread:
            continue
        if ends_at is not None and ends_at < event.frame:
            lane.add(ends_at, "")
        ends_at = None
        if isinstance(event, RecoveryStart):
            lane.add(event.frame, f"{event.method} at work", palette.RECOVERY)
        else:
            outcome = ("succeeded", palette.FUSED) if event.success else _failure(event)
            lane.add(event.frame, *outcome)
            ends_at = event.frame + length
    if ends_at is not None and ends_at < len(record.results):
        lane.add(ends_at, "")
    return lane


def _failure(event: RecoveryEnd) -> tuple[str, Color]:
    return (f"failed: {event.stage}" if event.stage else "failed"), palette.REFUSED


def _outcomes(record: RunRecord) -> Lane:
    words = {
        FrameOutcome.TRACKED: ("pose", palette.TRACKED),
        FrameOutcome.RECOVERED: ("pose by recovery", palette.RECOVERED),
        FrameOutcome.NONE: ("no pose", palette.LOST),
    }
    lane = Lane("outcome")
    for frame, outcome in enumerate(frame_outcomes(record)):
        lane.add(frame, *words[outcome])
    return lane


def _mark_frames(record: RunRecord) -> int:
    return max(1, round(MARK_SHARE * len(record.results)))
