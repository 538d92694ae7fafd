"""What became of every frame: tracked as it came, placed afterwards by a recovery, or never."""

from collections.abc import Sequence
from enum import Enum

import numpy as np

from experiments.evaluation.summary import is_tracked
from experiments.runs.execution import RunRecord
from slam.core.events import Breakage, Event, Fusion


class FrameOutcome(Enum):
    """Whether a frame has a pose in the end, and since when."""

    TRACKED = "tracked"
    RECOVERED = "recovered"
    NONE = "none"


def frame_outcomes(record: RunRecord) -> list[FrameOutcome]:
    """One per frame.

    A frame from a breakage on that was not tracked when it came and has a pose in the end owes it to the
    recovery that went back over it. Before a first breakage it owes it to initialisation, which places the
    frames between its two views, and counts as tracked. A frame of a map that was dropped has none.
    """
    posed = posed_frames(record)
    first = min((e.frame for e in record.events if isinstance(e, Breakage)), default=len(posed))
    return [_frame_outcome(bool(posed[r.frame]), is_tracked(r) or r.frame < first) for r in record.results]


def posed_frames(record: RunRecord) -> np.ndarray:
    """(frames,) bool: the frame has a pose in the end, in whichever map."""
    posed = np.zeros(len(record.results), bool)
    for trajectory in record.trajectories:
        posed[trajectory.frames] = True
    return posed


def _frame_outcome(posed: bool, at_once: bool) -> FrameOutcome:
    if not posed:
        return FrameOutcome.NONE
    return FrameOutcome.TRACKED if at_once else FrameOutcome.RECOVERED


def known_from(events: Sequence[Event], frames: int) -> np.ndarray:
    """(frames,) int: for each frame the one at which a recovery that may have covered it was applied.

    It is the frame of the next accepted fusion; ``frames`` where none follows.
    """
    applied = sorted(e.frame for e in events if isinstance(e, Fusion) and e.accepted)
    known = np.full(frames, frames)
    for frame in reversed(applied):
        known[: frame + 1] = frame
    return known
