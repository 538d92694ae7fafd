"""Paths of a run as known at a frame, as line strips in the world."""

import numpy as np

from dslab.experiments.evaluation.frame_outcomes import FrameOutcome, frame_outcomes, known_from
from dslab.experiments.evaluation.scene import Scene
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.events import Breakage

MAX_PATH = 600
"""Largest number of points of a drawn path."""

_PIN, _LABEL_HEIGHT, _LABEL_WIDTH = 0.22, 0.14, 0.7
"""Least height of a pin, height and width of its label, as shares of what is drawn."""


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

    def _first_breakage(self) -> int | None:
        return min((e.frame for e in self._record.events if isinstance(e, Breakage)), default=None)

    def position(self, frame: int) -> np.ndarray | None:
        """True position at a frame, else the last estimated one before it, else None."""
        truth = self._scene.T_world_cam
        if truth is not None and np.isfinite(truth[frame]).all():
            return truth[frame, :3, 3]
        known = np.flatnonzero(np.isfinite(self._placed[: frame + 1]).all(axis=1))
        return self._placed[known[-1]] if len(known) else None


def pins(positions: list[np.ndarray], up: np.ndarray, extent: float) -> list[np.ndarray]:
    """Upright pins, (2, 3) from foot to head, as high as keeps the labels of close ones apart.

    Args:
        positions: (3,) float64 feet.
        up: (3,) unit vector.
        extent: of all that is drawn.
    """
    levels: list[int] = []
    for place, foot in enumerate(positions):
        near = [np.linalg.norm(foot - other) < _LABEL_WIDTH * extent for other in positions[:place]]
        taken = {level for level, close in zip(levels, near, strict=True) if close}
        levels.append(next(level for level in range(place + 1) if level not in taken))
    heights = [(_PIN + _LABEL_HEIGHT * level) * extent for level in levels]
    return [np.array([foot, foot + height * up]) for foot, height in zip(positions, heights, strict=True)]


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
