"""A synthetic sequence, and a system that replays its truth with noise, breakages and recoveries."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.experiments.result_folder import run_systems
from dslab.sim.io.folders import new_directory
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import SegmentTruth, Sequence
from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import TrackingState
from dslab.slam.core.relation import PlacedFrames, Relation
from dslab.slam.core.results import MapTrajectory, TrackingResult

CAMERA = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5, 30.0)


def simulated_camera(camera: PinholeCamera) -> Intrinsics:
    """The simulator's camera of an estimator's; it has neither residual distortion nor a rolling shutter."""
    fields = asdict(camera)
    del fields["residual"], fields["readout_s"]
    return Intrinsics(**fields)


def circle(frames: int, radius_m: float = 3.0, turn: float = 0.8) -> np.ndarray:
    """(frames, 4, 4) poses on part of a circle with varying height, looking along the path."""
    angle = np.linspace(0, 2 * np.pi * turn, frames)
    T = np.tile(np.eye(4), (frames, 1, 1))
    T[:, :3, 3] = np.stack(
        [radius_m * np.cos(angle), radius_m * np.sin(angle), 1.5 + 0.2 * np.sin(3 * angle)], axis=1
    )
    forward = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    down = np.tile([0.0, 0.0, -1.0], (frames, 1))
    T[:, :3, :3] = np.stack([np.cross(down, forward), down, forward], axis=2)
    return T


def make_sequence(frames: int = 300, truth: bool = True, segment: tuple[int, int] | None = (150, 180)):
    """A circle of ``frames`` at 30 fps with one injected segment."""
    rng = np.random.default_rng(0)
    stamps_s = np.arange(frames) / CAMERA.fps
    segments = ()
    if segment is not None:
        first, last = segment
        segments = (
            SegmentTruth("low_texture", {"contrast": 0.0}, stamps_s[first], stamps_s[last], first, last),
        )
    images = rng.integers(0, 256, (frames, CAMERA.height_px, CAMERA.width_px), dtype=np.uint8)
    return Sequence(
        name="made-up",
        camera=CAMERA,
        stamps_s=stamps_s,
        frames=images,
        T_world_cam=circle(frames) if truth else None,
        depths=None,
        segments=segments,
        meta={},
    )


@dataclass
class FakeSystem:
    """Replays a truth as an estimate in another frame and scale.

    Attributes:
        T_world_cam: (N, 4, 4) the truth to replay.
        breaks_at: frame of the breakage, None for none.
        recovers: the maps are fused in the end.
        relocalizes_after: frames from the breakage to the relocalization of the base, None for never.
        drift_from: frame from which the pose drifts off without being declared, None for never.
        new_map_scale: length error of the part after the breakage, as fused.
    """

    T_world_cam: np.ndarray
    kind: str = "base"
    starts_at: int = 5
    breaks_at: int | None = None
    reinit_after: int = 20
    recovers: bool = True
    relocalizes_after: int | None = None
    drift_from: int | None = None
    noise_m: float = 0.0
    scale: float = 0.4
    new_map_scale: float = 1.0
    fails_at: int | None = None
    settings: dict = field(default_factory=lambda: {"name": "fake"})
    events: list[ev.Event] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._frame = -1
        self._stamps_s: list[float] = []
        self._rng = np.random.default_rng(1)
        self._poses: dict[int, dict[int, tuple[float, np.ndarray]]] = {}

    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult:
        self._frame += 1
        f = self._frame
        self._stamps_s.append(stamp_s)
        if f == self.fails_at:
            raise RuntimeError("the fake was told to fail")
        state, map_id, reason = self._script(f, stamp_s)
        T = self._pose(f) if state is TrackingState.TRACKING else None
        if T is not None:
            self._poses.setdefault(map_id, {})[f] = (stamp_s, T)
        keypoints = self._rng.uniform(0, 40, (50, 2)).astype(np.float32)
        return TrackingResult(
            frame=f,
            stamp_s=stamp_s,
            state=state,
            T_map_cam=T,
            map_id=map_id,
            inliers=40 if T is not None else 0,
            matches=60,
            reason=reason,
            is_keyframe=T is not None and f % 10 == 0,
            keypoints_px=keypoints,
            inlier_mask=np.arange(50) % 2 == 0,
            cpu_ms={"extract": 6.0, "track": 2.0 + 0.01 * f},
            ms={"extract": 7.0, "track": 3.0},
            mapping_cpu_ms=20.0 if T is not None and f % 10 == 0 else 0.0,
        )

    def finish(self) -> None:
        self.finished = True

    def trajectories(self) -> list[MapTrajectory]:
        made = []
        for map_id, poses in self._poses.items():
            frames = sorted(poses)
            made.append(
                MapTrajectory(
                    map_id,
                    np.array(frames),
                    np.array([poses[f][0] for f in frames]),
                    np.array([poses[f][1] for f in frames]),
                )
            )
        return sorted(made, key=lambda t: -len(t.frames))

    def keyframe_trajectories(self) -> list[MapTrajectory]:
        return [
            MapTrajectory(t.map_id, t.frames[::10], t.stamps_s[::10], t.T_map_cam[::10])
            for t in self.trajectories()
        ]

    def maps(self) -> list[int]:
        return [t.map_id for t in self.trajectories()]

    def map_points(self, map_id: int) -> np.ndarray:
        poses = np.array([T for _, T in self._poses[map_id].values()])
        return np.repeat(poses[:, :3, 3], 3, axis=0) + self._rng.normal(0, 0.3, (3 * len(poses), 3))

    def _script(self, f: int, stamp_s: float) -> tuple[TrackingState, int, str]:
        common = {"frame": f, "stamp_s": stamp_s}
        if f == self.starts_at:
            self.events.append(ev.Initialized(**common, map_id=0, points=100, model="E"))
        if f < self.starts_at:
            return TrackingState.NOT_INITIALIZED, 0, "parallax"
        if self.breaks_at is None or f < self.breaks_at:
            return TrackingState.TRACKING, 0, ""
        if f == self.breaks_at:
            self.events.append(ev.Breakage(**common, map_id=0, reason="few_inliers", inliers=7))
        if self.kind == "base":
            return self._relocalization(f, common)
        return self._recovery(f, common)

    def _relocalization(self, f: int, common: dict) -> tuple[TrackingState, int, str]:
        lost = f - self.breaks_at
        if self.relocalizes_after is None or lost < self.relocalizes_after:
            state = TrackingState.RELOCALIZING if lost else TrackingState.LOST
            return state, 0, "no_candidates"
        if lost == self.relocalizes_after:
            self.events.append(
                ev.Relocalized(
                    **common,
                    map_id=0,
                    keyframe=30,
                    first_frame=f,
                    inliers=60,
                    frames_lost=lost,
                    lost_s=lost / CAMERA.fps,
                    relation=self._relation([f]),
                )
            )
        return TrackingState.TRACKING, 0, ""

    def _recovery(self, f: int, common: dict) -> tuple[TrackingState, int, str]:
        if f < self.breaks_at + self.reinit_after:
            return TrackingState.NOT_INITIALIZED, 1, "parallax"
        if f == self.breaks_at + self.reinit_after:
            self.events.append(ev.ReinitDone(**common, map_id=1, frames_taken=self.reinit_after))
            success, stage = self.recovers, "" if self.recovers else "overlap"
            self.events.append(
                ev.RecoveryEnd(
                    **common,
                    map_id=1,
                    thread=1,
                    method="orb",
                    old_map_id=0,
                    success=success,
                    stage=stage,
                    reason="" if success else "no_common_points",
                    frames_covered=30,
                    frames_passed_over=2,
                    inliers=50,
                    cpu_ms=100.0,
                )
            )
            if success:
                self.events.append(
                    ev.Fusion(
                        **common,
                        map_id=0,
                        old_map_id=0,
                        new_map_id=1,
                        by="recovery",
                        accepted=True,
                        scale=1.0,
                        inliers=50,
                        reason="",
                        relation=self._relation(range(self.breaks_at + 1, f + 1)),
                    )
                )
        return TrackingState.TRACKING, 0 if self.recovers else 1, ""

    def _relation(self, new: Iterable[int]) -> Relation:
        """The newest frames of the old map beside new ones, as they are posed."""
        old = range(self.breaks_at - 1, self.starts_at, -3)
        sides = [
            PlacedFrames(
                np.array(side),
                np.array([self._stamps_s[f] for f in side]),
                np.array([self._pose(f) for f in side]),
            )
            for side in (list(old), list(new))
        ]
        return Relation(*sides, depth=0.4 * self.scale)

    def _pose(self, f: int) -> np.ndarray:
        S_map_world = Rotation.from_euler("xyz", [0.3, -0.5, 1.0]).as_matrix()
        T = self.T_world_cam[f].copy()
        p = T[:3, 3].copy()
        if self.breaks_at is not None and f > self.breaks_at:
            seam = self.T_world_cam[self.breaks_at, :3, 3]
            p = seam + self.new_map_scale * (p - seam)
        if self.drift_from is not None and f >= self.drift_from:
            p = p + 0.1 * (f - self.drift_from) * np.array([0.3, 0.1, 1.0])
        p = p + self._rng.normal(0, self.noise_m, 3)
        T[:3, :3] = S_map_world @ T[:3, :3]
        T[:3, 3] = self.scale * S_map_world @ p + [4.0, 5.0, 6.0]
        return T


def fake_factory(sequence: Sequence, **script):
    """A ``build`` function for runs over ``sequence``."""
    return lambda kind, camera, seed: FakeSystem(sequence.T_world_cam, kind=kind, **script)


def run_sequence(sequence, system, seed, out_dir, recording=False, **options):
    """Run one system and write its result folder; the summary. Options as of ``run_systems``."""
    with new_directory(out_dir) as folder:
        return run_systems(sequence, [system], seed, folder, recording, **options)[system]
