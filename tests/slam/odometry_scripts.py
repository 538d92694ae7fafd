"""Odometry by a script: frames carry their numbers, and a table has their poses."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import Breakage, Event, LoopClosed, TrackingState
from dslab.slam.core.relation import PlacedFrames, Relation
from dslab.slam.core.results import MapTrajectory, TrackingResult
from dslab.slam.framework.dual_of import DualOf, FrameworkConfig
from dslab.slam.framework.odometry import Kind, Parts
from dslab.slam.optimization.sim3 import moved, sim3_matrix

CAMERA = PinholeCamera(width_px=64, height_px=48, fx=50.0, fy=50.0, cx=31.5, cy=23.5, fps=10.0)


def walk(frames: int = 200) -> np.ndarray:
    """(N, 4, 4) a curved walk with a swaying gaze, camera to world."""
    s = np.arange(frames) / 10.0
    T = np.tile(np.eye(4), (frames, 1, 1))
    T[:, :3, 3] = np.column_stack([np.sin(0.3 * s) * 4, 0.1 * np.sin(2 * s), s])
    T[:, :3, :3] = Rotation.from_euler("yx", np.column_stack([0.3 * s, 0.1 * np.sin(s)])).as_matrix()
    return T


def image_of(index: int) -> np.ndarray:
    """(48, 64) uint8 image that carries the number of its frame."""
    image = np.zeros((48, 64), np.uint8)
    image[0, :2] = divmod(index, 256)
    return image


@dataclass
class Script:
    """What systems of one kind do.

    Attributes:
        T_world_cam: (N, 4, 4) true poses.
        blind: frames at which they are lost, forward and backward.
        noise: standard deviation of their positions.
        returns_at: frames at which a lost one finds back.
        crashes: frames at which ``process`` raises.
        drift: factor by which lengths grow, per frame since it began.
        after: frames without a pose at the beginning.
        begun: every system that was begun.
    """

    T_world_cam: np.ndarray
    blind: set[int] = field(default_factory=set)
    noise: float = 0.0
    returns_at: set[int] = field(default_factory=set)
    drift: float = 1.0
    after: int = 0
    begun: list["Scripted"] = field(default_factory=list)

    def kind(self, name: str = "script", **parts: bool) -> Kind:
        """A kind of odometry that plays it."""

        def begin(seed, first, backward):
            self.begun.append(Scripted(self, seed, backward is not None))
            return self.begun[-1]

        return Kind(name, Parts(**({"losses": True} | parts)), begin)


class Scripted:
    """A system that plays a script, in a frame and scale of its own."""

    def __init__(self, script: Script, seed: int, is_backward: bool) -> None:
        self.script, self.is_backward, self.camera, self.is_finished = script, is_backward, CAMERA, 0
        self.rng = np.random.default_rng(seed)
        scale, turn = np.exp(self.rng.normal(0, 0.5)), Rotation.random(rng=self.rng).as_matrix()
        self.S = sim3_matrix(float(scale), turn, self.rng.normal(size=3))
        self.events: list[Event] = []
        self.poses: dict[int, np.ndarray] = {}
        self.stamps_s: list[float] = []
        self.seen: list[int] = []
        self.lost = False

    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult:
        index = int(image[0, 0]) * 256 + int(image[0, 1])
        row = len(self.seen)
        self.seen.append(index)
        self.stamps_s.append(stamp_s)
        if index in self.script.blind and self.poses and not self.lost:
            self.lost = True
            self.events.append(Breakage(frame=row, stamp_s=stamp_s, map_id=0, reason="blind", inliers=3))
        elif self.lost and index in self.script.returns_at:
            self.lost = False
        can = row >= self.script.after and index not in self.script.blind and not self.lost
        T = None
        if can:
            T = moved(self.S, self.script.T_world_cam[index])
            T[:3, 3] += self.rng.normal(0, self.script.noise, 3)
            T[:3, 3] *= self.script.drift**row
            self.poses[row] = T
        lost = TrackingState.LOST if self.poses else TrackingState.NOT_INITIALIZED
        state = lost if T is None else TrackingState.TRACKING
        none = np.empty((0, 2), np.float32), np.empty(0, bool)
        return TrackingResult(row, stamp_s, state, T, 0, 9, 9, "", row % 5 == 0 and can, *none)

    def close_loop(self) -> None:
        """Say that a loop was closed with its last two frames."""
        row = len(self.seen) - 1
        sides = (PlacedFrames(np.array([k]), np.array([0.0]), np.eye(4)[None]) for k in (row - 1, row))
        self.events.append(
            LoopClosed(
                frame=row, stamp_s=self.stamps_s[-1], map_id=0, keyframe=row, loop_keyframe=row - 1,
                scale=1.0, matches=5, cpu_ms=0.0, relation=Relation(*sides, 1.0),
            )
        )  # fmt: skip

    def finish(self) -> None:
        self.is_finished += 1

    def trajectories(self) -> list[MapTrajectory]:
        rows = sorted(self.poses)
        poses = np.array([self.poses[row] for row in rows]).reshape(-1, 4, 4)
        return [MapTrajectory(0, np.array(rows, int), np.array(self.stamps_s)[rows], poses)] if rows else []

    def keyframe_trajectories(self) -> list[MapTrajectory]:
        return [path.where(path.frames % 5 == 0) for path in self.trajectories()]

    def map_points(self, map_id: int) -> np.ndarray:
        return moved(self.S, self.script.T_world_cam[self.seen])[:, :3, 3]


def dual_of(
    forward: Kind,
    *recoveries: Kind,
    frames: int = 200,
    each: Callable[[DualOf], None] | None = None,
    **settings,
) -> DualOf:
    """Dual-SLAM over kinds, fed with frames and finished."""
    system = DualOf(CAMERA, 7, forward, recoveries, FrameworkConfig(**settings))
    for index in range(frames):
        system.process(image_of(index), 0.1 * index)
        if each is not None:
            each(system)
    system.finish()
    return system


def told(system: DualOf) -> list[str]:
    """Kinds of its events."""
    return [event.kind for event in system.events]
