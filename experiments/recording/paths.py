"""Paths of a run as known at a frame, as line strips."""

from dataclasses import dataclass

import numpy as np

from dslab.experiments.evaluation.frame_outcomes import FrameOutcome, frame_outcomes, known_from
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.recording.placement import Placements
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import Breakage, Event, Fusion, MapCut, RecoveryEnd, RecoveryStart

MAX_PATH = 600
"""Largest number of points of a drawn path."""
DASHES = 40
"""Dashes and gaps of the path of a map in its own frame are this part of the run long."""

LABEL_WIDTH = 0.4
"""Room for a label, as a share of the extent of what is drawn."""
_MARGIN, _LABEL_HEIGHT = 0.08, 0.15
"""Distance of the nearest labels from the path, and height of a label, as shares of the extent."""


@dataclass(frozen=True)
class Recovery:
    """A recovery that went back over frames.

    Attributes:
        map_id: the new map, from which it went back.
        frames: the frames that it placed.
        start, end: frames at which it began and ended.
        fused: frame of the fusion.
    """

    map_id: int
    frames: np.ndarray
    start: int
    end: int
    fused: int

    def placed(self, frame: int) -> np.ndarray:
        """The frames placed up to a frame, newest first and at an even pace from start to end."""
        share = 1.0 if frame >= self.end else (frame - self.start) / max(1, self.end - self.start)
        return self.frames[len(self.frames) - round(max(0.0, share) * len(self.frames)) :]


def recoveries(record: RunRecord) -> list[Recovery]:
    """The recoveries of a run, one per accepted fusion."""
    known = known_from(record.events, len(record.results))
    recovered = np.array([f is FrameOutcome.RECOVERED for f in frame_outcomes(record)], bool)
    found: dict[int, Recovery] = {}
    for fusion in record.events:
        if isinstance(fusion, Fusion) and fusion.accepted and fusion.frame not in found:
            start, end = _span(record.events, fusion)
            frames = np.flatnonzero(recovered & (known == fusion.frame))
            found[fusion.frame] = Recovery(fusion.new_map_id, frames, start, end, fusion.frame)
    return list(found.values())


def _span(events: tuple[Event, ...], fusion: Fusion) -> tuple[int, int]:
    """Frames at which the recovery behind a fusion began and ended; those of the fusion if none did."""
    of_map = [
        e for e in events if isinstance(e, RecoveryStart | RecoveryEnd) and e.map_id == fusion.new_map_id
    ]
    for end in of_map:
        if isinstance(end, RecoveryEnd) and end.success and end.frame <= fusion.frame:
            starts = [e.frame for e in of_map if isinstance(e, RecoveryStart) and e.thread == end.thread]
            return min(starts, default=end.frame), end.frame
    return fusion.frame, fusion.frame


class RunPaths:
    """Paths of one run, cut by the outcomes of its frames.

    Args:
        record: the run.
        placements: where its maps are drawn.
    """

    def __init__(self, record: RunRecord, placements: Placements) -> None:
        self._record = record
        self._placements = placements
        self._tracked = np.array([is_tracked(r) for r in record.results], bool)
        self.recoveries = recoveries(record)
        self._known_from = np.full(len(record.results), len(record.results))
        for recovery in self.recoveries:
            self._known_from[recovery.frames] = recovery.fused

    def live_strips(self, map_id: int, frame: int) -> list[np.ndarray]:
        """Live path up to a frame in its map, cut where frames are missing, dashed while the map is alone."""
        live, place = self._record.live[map_id], self._placements.at(map_id, frame)
        shown = live.frames <= frame
        if place is not None and place.is_own:
            dash = max(1, len(self._record.results) // DASHES)
            shown &= (live.frames - live.frames[0]) // dash % 2 == 0
        return strips(live.frames[shown], live.T_map_cam[shown, :3, 3])

    def recovered_strips(self, frame: int) -> list[np.ndarray]:
        """Path in the world of what recoveries have placed up to a frame, as their maps lie at it."""
        made = []
        for recovery in self.recoveries:
            frames = recovery.placed(frame)
            positions = self._placements.final(recovery.map_id, frames, frame)
            known = np.isfinite(positions).all(axis=1)
            made += strips(frames[known], positions[known])
        return made

    def lost_strips(self, frame: int) -> list[np.ndarray]:
        """True path of frames without a pose, from the first breakage up to a frame."""
        truth, first = self._record.sequence.T_world_cam, self._first_breakage()
        if truth is None or first is None:
            return []
        without = ~self._tracked & ~(self._known_from <= frame)
        without[:first] = False
        without[frame + 1 :] = False
        frames = np.flatnonzero(without & np.isfinite(truth).all(axis=(1, 2)))
        return strips(frames, truth[frames, :3, 3])

    def _first_breakage(self) -> int | None:
        return min((e.frame for e in self._record.events if isinstance(e, Breakage | MapCut)), default=None)

    def position(self, frame: int) -> np.ndarray | None:
        """True position at a frame, else the last estimated one before it, else None."""
        truth = self._record.sequence.T_world_cam
        if truth is not None and np.isfinite(truth[frame]).all():
            return truth[frame, :3, 3]
        for result in reversed(self._record.results[: frame + 1]):
            place = self._placements.at(result.map_id, frame)
            if is_tracked(result) and place is not None and result.T_map_cam is not None:
                return place.S_world_map.points(result.T_map_cam[None, :3, 3])[0]
        return None


def pins(positions: list[np.ndarray], across: np.ndarray, edge: float, extent: float) -> list[np.ndarray]:
    """Pins, (2, 3) from foot to head, that carry their heads beyond the path, those of close ones apart.

    Args:
        positions: (3,) float64 feet.
        across: (3,) unit vector from the path towards the labels.
        edge: where the path ends in this direction.
        extent: of all that is drawn.
    """
    levels: list[int] = []
    for place, foot in enumerate(positions):
        apart = [foot - other - ((foot - other) @ across) * across for other in positions[:place]]
        near = [np.linalg.norm(along) < LABEL_WIDTH * extent for along in apart]
        taken = {level for level, close in zip(levels, near, strict=True) if close}
        levels.append(next(level for level in range(place + 1) if level not in taken))
    heads = [edge + (_MARGIN + _LABEL_HEIGHT * level) * extent for level in levels]
    return [
        np.array([foot, foot + (head - foot @ across) * across])
        for foot, head in zip(positions, heads, strict=True)
    ]


def strips(frames: np.ndarray, positions: np.ndarray) -> list[np.ndarray]:
    """Cut a path where frames are missing, and thin it for display.

    Args:
        frames: (n,) int increasing.
        positions: (n, 3) float64.
    """
    if not len(frames):
        return []
    pieces = np.split(positions, np.flatnonzero(np.diff(frames) > 1) + 1)
    budget = max(2, MAX_PATH // len(pieces))
    return [np.concatenate([thin(piece, budget), piece[-1:]]) for piece in pieces]


def thin(rows: np.ndarray, most: int) -> np.ndarray:
    """Select at most ``most`` rows, evenly spaced."""
    return rows[:: max(1, -(-len(rows) // most))]
