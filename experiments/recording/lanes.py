"""Lanes of a run: its states over time, from its results and events alone."""

from dataclasses import dataclass, field

from dslab.experiments.evaluation.audit_report import audit_record
from dslab.experiments.evaluation.audit_text import silent_losses
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.recording import palette
from dslab.experiments.recording.palette import Color
from dslab.experiments.recording.stories import Story, stories
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import CANCELLED, RecoveryEnd, RecoveryStart

LETTERS = 72
"""Letters that fit into a lane on a screen of usual width."""
MARK_SHARE = 0.16
"""Length of a momentary event with a label, as a share of the run, so that the label fits."""


@dataclass
class Lane:
    """One row of the timeline.

    Attributes:
        name: words and figures; ``_`` stands for a space.
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

    def labelled(self, frames: int) -> list[tuple[int, str, bool]]:
        """Changes as (frame, value, True if the value's words fit into its time), of a run of some frames."""
        ends = [frame for frame, _ in self.changes[1:]] + [frames]
        return [
            (frame, value, len(value) <= LETTERS * (end - frame) / frames)
            for (frame, value), end in zip(self.changes, ends, strict=True)
        ]


def system_lanes(record: RunRecord) -> list[Lane]:
    """Lanes of each breakage, of silent losses, of each recovery thread, and of the state."""
    broken = [_breakage(record, story) for story in stories(record)]
    return [*broken, *_silent(record), *_recoveries(record), _states(record)]


def segment_lanes(record: RunRecord) -> list[Lane]:
    """One lane per injected segment that acts on a frame, by the time of its start."""
    lanes = []
    for segment in record.sequence.segments:
        if segment.first_frame < 0:
            continue
        lane = Lane(f"{segment.start_s:.2f}_to_{segment.end_s:.2f}_s_{segment.kind}")
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


def _breakage(record: RunRecord, story: Story) -> Lane:
    """Lane of a breakage: broken, then how it was repaired."""
    lane = Lane(story.text.replace(",", "").replace(" ", "_"))
    lane.add(story.frame, "broken", palette.LOST)
    if story.end is not None:
        _mark(lane, record, story.end, story.how, palette.FUSED if story.is_repaired else palette.REFUSED)
    return lane


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
    """One lane per recovery thread: at work, then its outcome as a mark."""
    lanes: dict[int, Lane] = {}
    for event in record.events:
        if isinstance(event, RecoveryStart | RecoveryEnd):
            lane = lanes.setdefault(event.thread, Lane(f"recovery_thread_{event.thread}"))
            if isinstance(event, RecoveryStart):
                lane.add(event.frame, f"{event.method} at work", palette.RECOVERY)
            elif event.success:
                _mark(lane, record, event.frame, "succeeded", palette.FUSED)
            elif event.stage == CANCELLED:
                _mark(lane, record, event.frame, "cancelled", palette.NOTE)
            else:
                _mark(lane, record, event.frame, "failed", palette.REFUSED)
    return [lanes[thread] for thread in sorted(lanes)]


def _mark(lane: Lane, record: RunRecord, frame: int, value: str, color: Color) -> None:
    """Add a momentary event, drawn over a share of the run."""
    end = frame + max(1, round(MARK_SHARE * len(record.results)))
    lane.add(frame, value, color)
    if end < len(record.results):
        lane.add(end, "")
