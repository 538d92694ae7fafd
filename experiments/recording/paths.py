"""Paths of a run as known at a frame, as line strips in the world."""

from dataclasses import dataclass

import numpy as np

from experiments.evaluation.frame_outcomes import FrameOutcome, frame_outcomes, known_from
from experiments.evaluation.scene import Scene
from experiments.evaluation.summary import is_tracked
from experiments.runs.execution import RunRecord
from slam.core.events import Breakage, Event, Fusion, Relocalized

MAX_PATH = 600
"""Largest number of points of a drawn path."""


@dataclass(frozen=True)
class Mark:
    """Position of an event on the path.

    Attributes:
        frame: frame of the event.
        position: (3,) float64 in the world.
        broke: True for a breakage, False for the end of one.
        label: text shown at the mark.
    """

    frame: int
    position: np.ndarray
    broke: bool
    label: str


class RunPaths:
    """Paths of one run, cut by the outcomes of its frames.

    Args:
        record: the run.
        scene: alignment of its maps with the world.
    """

    def __init__(self, record: RunRecord, scene: Scene) -> None:
        self._record = record
        self._scene = scene
        n = len(record.results)
        self._tracked = np.array([is_tracked(r) for r in record.results], bool)
        self._recovered = np.array([f is FrameOutcome.RECOVERED for f in frame_outcomes(record)], bool)
        self._known_from = known_from(record.events, n)
        self._placed = np.full((n, 3), np.nan)
        for trajectory in reversed(list(scene.final.values())):
            self._placed[trajectory.frames] = trajectory.T_map_cam[:, :3, 3]

    def live(self, map_id: int, frame: int) -> np.ndarray:
        """Live camera poses, (n, 4, 4) in the world, in a map up to a frame."""
        live = self._record.live[map_id]
        poses = live.T_map_cam[live.frames <= frame]
        return self._scene.alignments[map_id].poses(poses)

    def live_strips(self, map_id: int, frame: int) -> list[np.ndarray]:
        """Live path in a map up to a frame, cut where frames are missing."""
        frames = self._record.live[map_id].frames
        return strips(frames[frames <= frame], self.live(map_id, frame)[:, :3, 3])

    def recovered_strips(self, frame: int) -> list[np.ndarray]:
        """Final path of the frames that recoveries placed up to a frame."""
        chosen = self._recovered & (self._known_from <= frame) & np.isfinite(self._placed).all(axis=1)
        frames = np.flatnonzero(chosen)
        return strips(frames, self._placed[frames])

    def lost_strips(self, frame: int) -> list[np.ndarray]:
        """True path of frames without a pose, from the first breakage up to a frame."""
        truth, first = self._scene.T_world_cam, self._first_breakage()
        if truth is None or first is None:
            return []
        without = ~self._tracked & ~(self._recovered & (self._known_from <= frame))
        without[:first] = False
        without[frame + 1 :] = False
        frames = np.flatnonzero(without & np.isfinite(truth).all(axis=(1, 2)))
        return strips(frames, truth[frames, :3, 3])

    def marks(self) -> list[Mark]:
        """Breakages, fusions and relocalizations at the position of the camera, in order."""
        found = []
        for event in self._record.events:
            label = _label(event)
            position = None if label is None else self._position(event.frame)
            if label is not None and position is not None:
                found.append(Mark(event.frame, position, isinstance(event, Breakage), label))
        return found

    def _first_breakage(self) -> int | None:
        return min((e.frame for e in self._record.events if isinstance(e, Breakage)), default=None)

    def _position(self, frame: int) -> np.ndarray | None:
        """True position at a frame, else the last estimated one before it, else None."""
        truth = self._scene.T_world_cam
        if truth is not None and np.isfinite(truth[frame]).all():
            return truth[frame, :3, 3]
        known = np.flatnonzero(np.isfinite(self._placed[: frame + 1]).all(axis=1))
        return self._placed[known[-1]] if len(known) else None


def _label(event: Event) -> str | None:
    if isinstance(event, Breakage):
        return "breakage"
    if isinstance(event, Fusion) and event.accepted:
        return "fused"
    return "relocalized" if isinstance(event, Relocalized) else None


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
