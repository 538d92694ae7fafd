"""Lanes of a run: its states over time, from its results and events alone."""

from dataclasses import dataclass, field

from dslab.experiments.evaluation.audit_report import audit_record
from dslab.experiments.evaluation.audit_text import silent_losses
from dslab.experiments.evaluation.frame_outcomes import FrameOutcome, frame_outcomes
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.recording import palette
from dslab.experiments.recording.palette import Color
from dslab.experiments.recording.stories import Story, stories
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import CANCELLED, Event, Fusion, RecoveryEnd, RecoveryStart

LETTERS = 72
"""Letters that fit into a lane on a screen of usual width."""
MARK_SHARE = 0.16
"""Length of a momentary event with a label, as a share of the run, so that the label fits."""
_TICK_SHARE = 0.01

_STATE_WORDS = {"not_initialized": "initialising"}


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

    def at(self, frame: int) -> str:
        """Value at a frame."""
        return next((value for f, value in reversed(self.changes) if f <= frame), "")

    def labelled(self, frames: int) -> list[tuple[int, str, bool]]:
        """Changes as (frame, value, True if the value's words fit into its time), of a run of some frames."""
        ends = [frame for frame, _ in self.changes[1:]] + [frames]
        return [
            (frame, value, len(value) <= LETTERS * (end - frame) / frames)
            for (frame, value), end in zip(self.changes, ends, strict=True)
        ]


def system_lanes(record: RunRecord) -> list[Lane]:
    """Lanes of each breakage, silent losses, other events, final poses, each recovery thread, and state."""
    broken = [_breakage(record, story) for story in stories(record)]
    return [
        *broken,
        *_silent(record),
        *_others(record),
        _outcomes(record),
        *_recoveries(record),
        _states(record),
    ]


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
        word = _STATE_WORDS.get(state, state)
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


def _others(record: RunRecord) -> list[Lane]:
    """One lane per kind of other event, with a tick at each."""
    lanes: dict[str, Lane] = {}
    for event in record.events:
        name, color = _other(event)
        if color is not None:
            lane = lanes.setdefault(name, Lane(name))
            _mark(lane, record, event.frame, name.replace("_", " "), color, _TICK_SHARE)
    return list(lanes.values())


def _other(event: Event) -> tuple[str, Color | None]:
    if isinstance(event, Fusion) and not event.accepted:
        return "fusion_refused", palette.REFUSED
    return event.kind, _OTHERS.get(event.kind)


_OTHERS: dict[str, Color] = {
    "map_cut": palette.LOST,
    "rescue_start": palette.RECOVERY,
    "poses_withdrawn": palette.REFUSED,
    "map_dropped": palette.REFUSED,
    "loop_closed": palette.NOTE,
    "loop_refused": palette.REFUSED,
    "relocalization_withdrawn": palette.REFUSED,
    "camera_refined": palette.NOTE,
}


def _recoveries(record: RunRecord) -> list[Lane]:
    """One lane per recovery thread: at work, then its outcome as a mark."""
    threads = sorted({e.thread for e in record.events if isinstance(e, RecoveryStart | RecoveryEnd)})
    return [_recovery(record, thread) for thread in threads]


def _recovery(record: RunRecord, thread: int) -> Lane:
    lane = Lane(f"recovery_thread_{thread}")
    own = [e for e in record.events if isinstance(e, RecoveryStart | RecoveryEnd) and e.thread == thread]
    for event in own:
        if isinstance(event, RecoveryStart):
            lane.add(event.frame, f"{event.method} at work", palette.RECOVERY)
        else:
            failed = ("cancelled", palette.NOTE) if event.stage == CANCELLED else ("failed", palette.REFUSED)
            _mark(lane, record, event.frame, *(("succeeded", palette.FUSED) if event.success else failed))
    return lane


def _outcomes(record: RunRecord) -> Lane:
    words = {
        FrameOutcome.TRACKED: ("pose", palette.TRACKED),
        FrameOutcome.RECOVERED: ("pose by recovery", palette.RECOVERED),
        FrameOutcome.NONE: ("no pose", palette.LOST),
    }
    lane = Lane("final_poses")
    for frame, outcome in enumerate(frame_outcomes(record)):
        lane.add(frame, *words[outcome])
    return lane


def _mark(
    lane: Lane, record: RunRecord, frame: int, value: str, color: Color, share: float = MARK_SHARE
) -> None:
    """Add a momentary event, drawn over a share of the run."""
    frames = len(record.results)
    end = frame + max(1, round(share * frames))
    lane.add(frame, value, color)
    if end < frames:
        lane.add(end, "")
