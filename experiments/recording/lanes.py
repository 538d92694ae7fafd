"""Lanes of a run: its states over time, from its results and events alone."""

from dataclasses import dataclass, field

from dslab.experiments.evaluation.audit_report import audit_record
from dslab.experiments.evaluation.audit_text import silent_losses
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.recording import palette
from dslab.experiments.recording.palette import Color
from dslab.experiments.recording.stories import CUT, Story, stories
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import CANCELLED, RecoveryEnd, RecoveryStart

INJECTED, SYSTEMS = "injected", "slam"
"""Paths of the lanes of segments and of systems, in this order in the viewer."""
BREAKAGES, BROKEN = "breakages", "broken"
"""Lane of the moments of breakages and cuts, and its value at a breakage."""


@dataclass
class Lane:
    """One row of the timeline.

    Attributes:
        name: what it is about, never what will come; ``_`` stands for a space.
        changes: (frame, value) in order of frames; a value holds until the next, empty for none.
        colors: colour of every value.
    """

    name: str
    changes: list[tuple[int, str]] = field(default_factory=list)
    colors: dict[str, Color] = field(default_factory=dict)

    def add(self, frame: int, value: str, color: Color | None = None) -> None:
        """Set the value from a frame on, in place of what was set for it and for later ones."""
        while self.changes and self.changes[-1][0] >= frame:
            self.changes.pop()
        if not self.changes or self.changes[-1][1] != value:
            self.changes.append((frame, value))
        if color is not None:
            self.colors[value] = color

    def mark(self, frame: int, value: str, color: Color) -> None:
        """Add what happens in one frame."""
        self.add(frame, value, color)
        self.add(frame + 1, "")


def system_lanes(record: RunRecord) -> list[Lane]:
    """Lanes of breakages and of repairs, of silent losses, of each recovery thread, and of the state."""
    lanes = [*_breakages(record), *_silent(record), *_recoveries(record), _states(record)]
    for lane in lanes:
        while lane.changes and lane.changes[-1][0] >= len(record.results):
            lane.changes.pop()
    return lanes


def segment_lanes(record: RunRecord) -> list[Lane]:
    """One lane per injected segment that acts on a frame, by its kind; those of one kind are numbered."""
    acting = [segment for segment in record.sequence.segments if segment.first_frame >= 0]
    kinds = [segment.kind for segment in acting]
    lanes = []
    for place, segment in enumerate(acting):
        number = f"_{kinds[: place + 1].count(segment.kind)}" if kinds.count(segment.kind) > 1 else ""
        lane = Lane(segment.kind + number)
        lane.add(0, "")
        for first, last in segment.runs or ((segment.first_frame, segment.last_frame),):
            lane.add(first, segment.kind.replace("_", " "), palette.INJECTED)
            if last + 1 < len(record.results):
                lane.add(last + 1, "")
        lanes.append(lane)
    return lanes


def _states(record: RunRecord) -> Lane:
    lane = Lane("tracking")
    several = len({r.map_id for r in record.results if is_tracked(r)}) > 1
    for result in record.results:
        state = str(result.state)
        word = "initialising" if state == "not_initialized" else state
        if several and is_tracked(result):
            word += f", map {result.map_id}"
        lane.add(result.frame, word, palette.STATES.get(state, palette.NOTE))
    return lane


def _breakages(record: RunRecord) -> list[Lane]:
    """Lanes of the moments of breakages and cuts, and of those at which something became of them."""
    broken, mended = Lane(BREAKAGES), Lane("repairs")
    ends: dict[int, Story] = {}
    for story in sorted(stories(record), key=lambda story: story.frame):
        broken.mark(story.frame, CUT if story.name == CUT else BROKEN, palette.LOST)
        if story.end is not None:
            ends.setdefault(story.end, story)
    for frame, story in sorted(ends.items()):
        mended.mark(frame, story.how, palette.FUSED if story.is_repaired else palette.REFUSED)
    return [lane for lane in (broken, mended) if lane.changes]


def _silent(record: RunRecord) -> list[Lane]:
    """Lane of wrong poses that were given as right ones, by the truth; none without any."""
    lane = Lane("silent_losses")
    losses = silent_losses({"audit": audit_record(record)})
    for loss in sorted(losses, key=lambda loss: loss["true_loss_frame"]):
        lane.add(loss["true_loss_frame"], "wrong by the truth, never declared", palette.LOST)
        if loss["end_frame"] + 1 < len(record.results):
            lane.add(loss["end_frame"] + 1, "")
    return [lane] if losses else []


def _recoveries(record: RunRecord) -> list[Lane]:
    """One lane per recovery thread: at work as long as it is, then its outcome as a mark."""
    lanes: dict[int, Lane] = {}
    for event in record.events:
        if isinstance(event, RecoveryStart | RecoveryEnd):
            lane = lanes.setdefault(event.thread, Lane(f"recovery_thread_{event.thread}"))
            if isinstance(event, RecoveryStart):
                lane.add(event.frame, f"{event.method} at work", palette.RECOVERY)
            elif event.success:
                lane.mark(event.frame, "succeeded", palette.FUSED)
            elif event.stage == CANCELLED:
                lane.mark(event.frame, "cancelled", palette.NOTE)
            else:
                lane.mark(event.frame, "failed", palette.REFUSED)
    return [lanes[thread] for thread in sorted(lanes)]
