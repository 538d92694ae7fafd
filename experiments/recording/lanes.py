"""The lanes of a run: what state it was in when, read off its results and events and nothing else."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from experiments.evaluation.frame_outcomes import FrameOutcome, frame_outcomes
from experiments.evaluation.summary import is_tracked
from experiments.recording import palette
from experiments.recording.palette import Color
from experiments.runs.execution import RunRecord
from slam.core.events import Event, Fusion, RecoveryEnd, RecoveryStart

MARK_SHARE = 0.08
"""What takes no time is shown this share of the run long, for its word to be read."""

_STATE_WORDS = {"not_initialized": "initialising"}


@dataclass
class Lane:
    """One row of the timeline.

    Attributes:
        name: what it tells of, one word.
        changes: (frame, value) in order of frames; a value holds until the next, empty for none.
        colors: of every value that occurs.
    """

    name: str
    changes: list[tuple[int, str]] = field(default_factory=list)
    colors: dict[str, Color] = field(default_factory=dict)

    def add(self, frame: int, value: str, color: Color | None = None) -> None:
        """From this frame on the value holds; of two for one frame the later stands."""
        if self.changes and self.changes[-1][0] == frame:
            self.changes.pop()
        if not self.changes or self.changes[-1][1] != value:
            self.changes.append((frame, value))
        if color is not None:
            self.colors[value] = color

    def at(self, frame: int) -> str:
        """The value that holds at a frame."""
        return next((value for f, value in reversed(self.changes) if f <= frame), "")


def system_lanes(record: RunRecord) -> list[Lane]:
    """State, marks of events, one lane per recovery thread, and what each frame was worth in the end."""
    return [_states(record), _marks(record), *_recoveries(record), _ends(record)]


def segment_lane(record: RunRecord) -> Lane:
    """What was done to the frames. Segments over one another are one value, in the last one's colour."""
    lane = Lane("segment")
    for frame in range(len(record.results)):
        kinds = record.sequence.kinds_at(frame)
        words = " + ".join(kinds).replace("_", " ")
        lane.add(frame, words, palette.segment_color(kinds[-1]) if kinds else None)
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
    """Breakages and what ended them. A mark gives way to the next."""
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
    """(frame, words, colour), one per frame: events of one frame share a mark, in the last one's colour."""
    marks: list[tuple[int, str, Color]] = []
    for event in events:
        found = _mark(event)
        if found is None:
            continue
        words, color = found
        if marks and marks[-1][0] == event.frame:
            words = f"{marks.pop()[1]}, {words}"
        marks.append((event.frame, words, color))
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
    """A lane per recovery thread: at work from its start to its end, then how it ended, as a mark."""
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


def _ends(record: RunRecord) -> Lane:
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
