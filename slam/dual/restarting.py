"""Save the map at a breakage and start a new one. Source: paper, Sec. II."""

from collections.abc import Sequence
from copy import deepcopy

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
    """Base system that saves its map at a breakage and starts a new one.

    Args:
        camera, seed, config, mode: as of the base.
        relocalization_maps: number of saved maps, last saved first, in which relocalization is tried until
            a new map is initialized.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        seed: int,
        config: SlamConfig | None,
        mode: ExecutionMode,
        relocalization_maps: int,
    ) -> None:
        super().__init__(camera, seed, config, mode)
        self._n_relocalization_maps = relocalization_maps
        self._saved: list[int] = []  # newest first
        self._initialization_paused = False
        self._reinit_start = -1

    # -- breakage ----------------------------------------------------------------------------------------

    def _break(self, frame: Frame, outcome: TrackingOutcome) -> None:
        self._emit(frame, ev.Breakage, reason=outcome.reason, inliers=outcome.inliers)
        self._withdraw_doubted(frame)
        self._save_or_drop_map(frame)
        self._start_reinitialization(frame)

    def _save_or_drop_map(self, frame: Frame) -> None:
        """Save the map, or drop it if it has too few keyframes."""
        if not self._drop_if_young(frame):
            self._save(frame)

    def _save(self, frame: Frame) -> None:
        """Keep the current map, to be fused later."""
        m = self.current_map
        self._emit(frame, ev.MapSaved, keyframes=len(m.keyframes()), points=len(m.points()))
        self._saved.insert(0, self._map_id)
        self._note_break(self._map_id, frame.features)
        self._reset_to_new_map()

    def _start_reinitialization(self, frame: Frame) -> None:
        """Start a new map from the next frames on."""
        self._reinit_start = frame.features.index
        if not self._initialization_paused:
            self._emit(frame, ev.ReinitStart)

    # -- initialization and relocalization ---------------------------------------------------------------

    def _initialize(self, frame: Frame) -> tuple[TrackingOutcome, bool]:
        if self._initialization_paused:
            return TrackingOutcome(False, 0, 0, "held"), False
        outcome = self._relocalize_in(self._relocalization_maps(), frame)
        if outcome.success:
            self._resume_saved_map(self._map_id)
        if outcome.success or (self._probation is not None and not self._doubted):
            return outcome, False
        return super()._initialize(frame)  # beside a probation, if an earlier one was withdrawn

    def _relocalization_maps(self) -> Sequence[int]:
        """Saved maps in which relocalization is tried."""
        return self._saved[: self._n_relocalization_maps]

    def _resume_saved_map(self, map_id: int) -> None:
        """Make a saved map the current one again and stop initialization."""
        self._saved.remove(map_id)
        self._initializer.reset()

    def _start_map(self, initial: InitialMap) -> None:
        super()._start_map(initial)
        if self._probation is not None:
            self._probation.withdraw("new_map")
            self._withdraw(self._probation, initial.second)
        if self._reinit_start >= 0:
            taken = initial.second.features.index - self._reinit_start
            self._emit(initial.second, ev.ReinitDone, frames_taken=taken)

    # -- laboratory --------------------------------------------------------------------------------------

    def as_base(self) -> MonocularSlam:
        """Copy this system as the base system, which is identical until the first breakage.

        Raises:
            RuntimeError: there was a breakage or a cut, or the system is threaded.
        """
        if self._backend.mode is not ExecutionMode.LOCKSTEP:
            raise RuntimeError("a copy needs lockstep mode")
        if any(isinstance(event, ev.Breakage | ev.MapCut) for event in self.events):
            raise RuntimeError("base and Dual-SLAM differ from the first breakage on")
        base = MonocularSlam(self.camera, self.seed, self.config, self._backend.mode)
        # The backend refers to its own system; in lockstep it holds nothing between frames.
        shared = [name for name in vars(base) if name != "_backend"]
        vars(base).update(deepcopy({name: vars(self)[name] for name in shared}))
        return base

    def cut(self) -> None:
        """Save the healthy map as at a breakage, then only buffer frames until :meth:`restart`.

        As at a breakage, a map with too few keyframes is dropped instead. The two methods make the crossing
        arm of a test of Eq. 1: recovery has to cross all frames in between, even those that tracking would
        have survived.

        Raises:
            RuntimeError: no map is being tracked.
        """
        if self.state is not TrackingState.TRACKING or self._newest is None:
            raise RuntimeError("there is no healthy map to cut")
        self._backend.drain()
        self._emit(self._newest, ev.MapCut)
        self._initialization_paused = True
        self._save_or_drop_map(self._newest)
        self._start_reinitialization(self._newest)

    def restart(self) -> None:
        """Start a new map from the next frame on, after :meth:`cut`.

        Raises:
            RuntimeError: there was no cut before.
        """
        if not self._initialization_paused or self._newest is None:
            raise RuntimeError("restart without a cut")
        self._initialization_paused = False
        self._reinit_start = self._newest.features.index
        self._emit(self._newest, ev.ReinitStart)
