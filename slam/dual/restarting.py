"""At a breakage: save the map, start another. Source: paper, Sec. II."""

from collections.abc import Sequence
from copy import deepcopy

import numpy as np

from slam.config import SlamConfig
from slam.core import events as ev
from slam.core.camera import PinholeCamera
from slam.core.events import TrackingState
from slam.core.frame import Frame
from slam.initialization.initializer import InitialMap
from slam.runtime.backend import ExecutionMode
from slam.system import MonocularSlam
from slam.tracking.tracker import TrackingOutcome


class RestartingSlam(MonocularSlam):
    """The base system, which at a breakage saves its map and seeks another instead of its place in that one.

    Args:
        camera, seed, config, mode: see the base.
        return_to: how many saved maps frames are looked for in while a new one is sought, the last saved
            first.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        seed: int,
        config: SlamConfig | None,
        mode: ExecutionMode,
        return_to: int,
    ) -> None:
        super().__init__(camera, seed, config, mode)
        self._return_to = return_to
        self._saved: list[int] = []  # newest first
        self._held = False
        self._sought_since = -1
        self._last_frame: Frame | None = None

    # -- breakage ----------------------------------------------------------------------------------------

    def _break(self, frame: Frame, outcome: TrackingOutcome) -> None:
        self._emit(frame, ev.Breakage, reason=outcome.reason, inliers=outcome.inliers)
        self._part_with_map(frame)
        self._seek_after(frame)

    def _part_with_map(self, frame: Frame) -> None:
        """Save the map, unless it is too young to be worth it."""
        if not self._drop_if_young(frame):
            self._save(frame)

    def _save(self, frame: Frame) -> None:
        """Keep the current map as it is, to be fused later."""
        m = self.current_map
        self._emit(frame, ev.MapSaved, keyframes=len(m.keyframes()), points=len(m.points()))
        self._saved.insert(0, self._map_id)
        self._broken_at[self._map_id] = frame.features
        self._seek_new_map()

    def _seek_after(self, frame: Frame) -> None:
        """A new map is to start from the frames that come."""
        self._sought_since = frame.features.index
        if not self._held:
            self._emit(frame, ev.ReinitStart)

    # -- a new map, or an old one again ------------------------------------------------------------------

    def _initialize(self, frame: Frame) -> tuple[TrackingOutcome, bool]:
        if self._held:
            return TrackingOutcome(False, 0, 0, "held"), False
        for map_id in self._may_return_to():
            outcome = self._relocalize_in(map_id, frame)
            if outcome.success:
                self._back_in(map_id)
                return outcome, False
        return super()._initialize(frame)

    def _may_return_to(self) -> Sequence[int]:
        """Saved maps in which the frame is looked for."""
        return self._saved[: self._return_to]

    def _back_in(self, map_id: int) -> None:
        """A saved map is the current one again, and no other is sought."""
        self._saved.remove(map_id)
        self._initializer.reset()

    def _start_map(self, initial: InitialMap) -> None:
        super()._start_map(initial)
        if self._sought_since >= 0:
            taken = initial.second.features.index - self._sought_since
            self._emit(initial.second, ev.ReinitDone, frames_taken=taken)

    def _after_frame(self, frame: Frame, outcome: TrackingOutcome, image: np.ndarray) -> None:
        self._last_frame = frame

    # -- laboratory --------------------------------------------------------------------------------------

    def as_base(self) -> MonocularSlam:
        """The base system as it would stand after the same frames: up to the first breakage the two are one.

        Raises:
            RuntimeError: they have parted, or the system is threaded.
        """
        if self._backend.mode is not ExecutionMode.LOCKSTEP:
            raise RuntimeError("a copy needs lockstep mode")
        if any(isinstance(event, ev.Breakage | ev.MapCut) for event in self.events):
            raise RuntimeError("base and Dual-SLAM part at the first breakage")
        base = MonocularSlam(self.camera, self.seed, self.config, self._backend.mode)
        # The backend calls back the system that it serves; in lockstep it holds nothing between frames.
        shared = [name for name in vars(base) if name != "_backend"]
        vars(base).update(deepcopy({name: vars(self)[name] for name in shared}))
        return base

    def cut(self) -> None:
        """Save the healthy map as a breakage would, and only buffer frames until :meth:`restart`.

        As at a breakage, a map that is too young is dropped instead. Together they are the crossing arm of
        a test of Eq. 1: recovery then has to cross all of the frames between, whether or not tracking would
        have failed in them.

        Raises:
            RuntimeError: there is no map that is tracked in.
        """
        if self.state is not TrackingState.TRACKING or self._last_frame is None:
            raise RuntimeError("there is no healthy map to cut")
        self._backend.drain()
        self._emit(self._last_frame, ev.MapCut)
        self._held = True
        self._part_with_map(self._last_frame)
        self._seek_after(self._last_frame)

    def restart(self) -> None:
        """After :meth:`cut`: a new map is sought from the next frame on.

        Raises:
            RuntimeError: nothing is held.
        """
        if not self._held or self._last_frame is None:
            raise RuntimeError("nothing is held")
        self._held = False
        self._sought_since = self._last_frame.features.index
        self._emit(self._last_frame, ev.ReinitStart)
