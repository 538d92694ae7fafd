"""ORB-SLAM's monocular method, and what every system shows to the outside."""

from dataclasses import asdict
from typing import Self

import numpy as np

from dslab.slam.config import SlamConfig
from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.events import TrackingState
from dslab.slam.core.results import MapTrajectory, TrackingResult
from dslab.slam.core.snapshot import Snapshot
from dslab.slam.engine import SlamEngine
from dslab.slam.map.map import Map
from dslab.slam.map.trajectory import keyframe_trajectory
from dslab.slam.mapping.local_mapping import LocalMapper
from dslab.slam.runtime.backend import ExecutionMode
from dslab.slam.tracking.tracker import Tracker


class MonocularSystem:
    """A monocular SLAM system as seen from outside: settings, events, maps, paths.

    Args:
        camera: intrinsics of the images to come.
        seed: root of every random stream.
        config: settings.
        mode: ``lockstep``: results do not depend on the load of the machine, bit for bit; or ``threaded``:
            mapping and loop closing run beside tracking. A threaded system must be ended by :meth:`finish`.

    Attributes:
        engine: the steps that it is made of.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        seed: int = 0,
        config: SlamConfig | None = None,
        mode: ExecutionMode = ExecutionMode.LOCKSTEP,
    ) -> None:
        self.engine = SlamEngine(camera, seed, config or SlamConfig(), mode)

    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult:
        """Process one frame.

        Args:
            image: (H, W) uint8 grey image of the camera's size.
            stamp_s: its time, later than the last one's.

        Returns:
            The outcome of the frame.

        Raises:
            ValueError: on misuse: wrong size or type of image, time not increasing. The content of an
                image never raises.
        """
        raise NotImplementedError

    def finish(self) -> None:
        """End the input: complete pending work and stop the threads of threaded mode."""
        self.engine.backend.close()

    def snapshot(self) -> Snapshot[Self]:
        """Copy the whole state between two frames, to branch from any number of times.

        Raises:
            RuntimeError: the system is threaded, and its threads cannot be copied.
        """
        if self.engine.backend.mode is not ExecutionMode.LOCKSTEP:
            raise RuntimeError("a snapshot needs lockstep mode")
        return Snapshot.of(self)

    @property
    def settings(self) -> dict:
        """All settings, nested by component, to be saved with the results."""
        return {"mode": str(self.engine.backend.mode), **asdict(self.config)}

    @property
    def camera(self) -> PinholeCamera:
        """The camera, as refined so far."""
        return self.engine.camera

    @property
    def config(self) -> SlamConfig:
        """Settings of tracking, mapping, loop closing, relocalization."""
        return self.engine.config

    @property
    def events(self) -> list[ev.Event]:
        """All events so far."""
        return self.engine.events

    @property
    def state(self) -> TrackingState:
        """State of tracking."""
        return self.engine.state

    @property
    def frames(self) -> int:
        """Number of frames processed so far."""
        return self.engine.frames

    @property
    def tracker(self) -> Tracker:
        """The tracker of the current map."""
        return self.engine.tracker

    @property
    def mapper(self) -> LocalMapper:
        """The mapper of the current map."""
        return self.engine.mapper

    @property
    def current_map(self) -> Map:
        """The map in which tracking works."""
        return self.engine.store.current

    @property
    def current_map_id(self) -> int:
        """Id of the current map, or of the one being initialized."""
        return self.engine.store.current_id

    def maps(self) -> list[int]:
        """Ids of the existing maps, the one with most tracked frames first."""
        return list(self.engine.store)

    def map(self, map_id: int) -> Map:
        """Map by its id."""
        return self.engine.store[map_id]

    def map_points(self, map_id: int) -> np.ndarray:
        """(n, 3) float64 points of a map, in its own frame."""
        m = self.map(map_id)
        return m.arrays.pt_xyz[m.points()].copy()

    def trajectories(self) -> list[MapTrajectory]:
        """Poses of the tracked frames in the current maps, the map with most frames first."""
        return [self.engine.store.poses.trajectory(k, self.map(k)) for k in self.maps()]

    def keyframe_trajectories(self) -> list[MapTrajectory]:
        """Poses of the keyframes, in the order of :meth:`trajectories`."""
        return [keyframe_trajectory(self.map(k)) for k in self.maps()]


class MonocularSlam(MonocularSystem):
    """ORB-SLAM's monocular method: a lost camera is looked for in the one map there is."""

    def process(self, image: np.ndarray, stamp_s: float) -> TrackingResult:
        """Process one frame; see :meth:`MonocularSystem.process`."""
        engine, is_keyframe = self.engine, False
        frame = engine.receive(image, stamp_s)
        if engine.state is TrackingState.NOT_INITIALIZED:
            outcome, initial = engine.initialize(frame)
            is_keyframe = initial is not None
        elif engine.state is TrackingState.TRACKING:
            outcome, is_keyframe = engine.track(frame)
            if engine.is_begun_wrong:
                outcome, is_keyframe = engine.drop_wrong_map(frame, outcome), False
            elif not outcome.success:
                engine.declare_breakage(frame, outcome)
                if engine.is_young:
                    engine.drop_map(frame, "too_few_keyframes")
                else:
                    engine.lose(frame)
                    engine.state = TrackingState.LOST
        else:
            engine.state = TrackingState.RELOCALIZING
            outcome = engine.relocalize(frame, [engine.store.current_id])
        engine.record(frame, outcome)
        return engine.result(frame, outcome, is_keyframe)
