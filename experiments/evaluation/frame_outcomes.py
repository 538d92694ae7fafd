"""Outcome of every frame: tracked live, posed later by a recovery, or without a pose."""

from collections.abc import Sequence
from enum import Enum

import numpy as np

from dslab.experiments.evaluation.summary import is_tracked, posed_frames
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import Breakage, Event, Fusion, MapCut


class FrameOutcome(Enum):
    """Origin of a frame's final pose."""

    TRACKED = "tracked"
    RECOVERED = "recovered"
    NONE = "none"


def frame_outcomes(record: RunRecord) -> list[FrameOutcome]:
    """Outcome of each frame.

    A frame after a breakage, or a cut, that was not tracked live and has a final pose was posed by the
    recovery that went back over it, if maps were fused later. Else it was posed by initialization, which
    poses the frames between its two views, and counts as tracked. A frame of a dropped map has no pose.
    """
    posed = posed_frames(record)
    first = min((e.frame for e in record.events if isinstance(e, Breakage | MapCut)), default=len(posed))
    fused_later = known_from(record.events, len(posed)) < len(posed)
    live = [is_tracked(r) or f < first or not fused_later[f] for f, r in enumerate(record.results)]
    return [
        FrameOutcome.NONE if not has else FrameOutcome.TRACKED if at_once else FrameOutcome.RECOVERED
        for has, at_once in zip(posed, live, strict=True)
    ]


def known_from(events: Sequence[Event], frames: int) -> np.ndarray:
    """(frames,) int: for each frame, the frame at which a recovery of it can have been applied.

    It is the frame of the next accepted fusion; ``frames`` if none follows.
    """
    applied = sorted(e.frame for e in events if isinstance(e, Fusion) and e.accepted)
    known = np.full(frames, frames)
    for frame in reversed(applied):
        known[: frame + 1] = frame
    return known
