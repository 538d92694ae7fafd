"""Search for the place of a lost camera in known maps, on probation until it is confirmed."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

from dslab.slam.config import SlamConfig
from dslab.slam.core import events as ev
from dslab.slam.core.frame import Frame
from dslab.slam.core.seeds import rng_for
from dslab.slam.core.timing import StageTimer
from dslab.slam.map.relation import relocalization_relation
from dslab.slam.map_store import MapStore
from dslab.slam.tracking.probation import Probation, Verdict, Withdrawn
from dslab.slam.tracking.tracker import Tracker, TrackingOutcome


class PlaceSearch:
    """Relocalizes frames; a relocalization counts once the frames that follow have confirmed it.

    Args:
        store: the maps.
        seed, config, timer: the system's.
        lock: held while a map is read.
        emit: emits an event: the frame, the kind, the map, the kind's own fields.

    Attributes:
        probation: under way, if any.
    """

    def __init__(
        self,
        store: MapStore,
        seed: int,
        config: SlamConfig,
        timer: StageTimer,
        lock: AbstractContextManager,
        emit: Callable[..., None],
    ) -> None:
        self.probation: Probation | None = None
        self._store = store
        self._seed = seed
        self._config = config
        self._timer = timer
        self._lock = lock
        self._emit = emit
        self._withdrawn: tuple[Withdrawn, ...] = ()  # since the loss

    @property
    def undecided(self) -> bool:
        """True while a probation is under way and none was withdrawn since the loss."""
        return self.probation is not None and not self._withdrawn

    def start(self) -> None:
        """Begin a new search, at a loss of tracking."""
        self._withdrawn = ()

    def offer(
        self, frame: Frame, map_ids: Sequence[int], begin: bool = True
    ) -> tuple[TrackingOutcome, Probation | None]:
        """Search the maps for a frame, in their order.

        Args:
            frame: to be placed.
            map_ids: of the maps.
            begin: begin a probation if none is under way.

        Returns:
            The outcome of the frame, and the probation that it has confirmed, if any.
        """
        outcome = TrackingOutcome(False, 0, 0, "no_candidates")
        if self.probation is not None:
            outcome, confirmed = self._on_probation(self.probation, frame, map_ids)
            if confirmed is not None:
                return outcome, confirmed
        if begin and self.probation is None:
            for map_id in map_ids:
                outcome = self._begin_probation(frame, map_id)
                if self.probation is not None:
                    break
        if self.probation is not None and self.probation.verdict is Verdict.CONFIRMED:
            confirmed, self.probation = self.probation, None
            return outcome, confirmed
        return outcome, None

    def report(self, probation: Probation, frame: Frame, outcome: TrackingOutcome) -> None:
        """Report that tracking goes on where a probation was confirmed."""
        m, lost = self._store[probation.map_id], self._store.loss(probation.map_id).at
        self._emit(
            frame,
            ev.Relocalized,
            probation.map_id,
            keyframe=m.frame_index(probation.keyframe),
            first_frame=probation.first.features.index,
            inliers=outcome.inliers,
            frames_lost=frame.features.index - lost.index,
            lost_s=frame.features.stamp_s - lost.stamp_s,
            relation=relocalization_relation(m, probation.frames),
            believed=probation.believed,
        )

    def reject(self, probation: Probation, frame: Frame, reason: str) -> None:
        """End a confirmed probation after all, for another reason than its frames."""
        probation.withdraw(reason)
        self._end(probation, frame)

    def _begin_probation(self, frame: Frame, map_id: int) -> TrackingOutcome:
        """Search a map for the frame; if it is found there, it is on probation."""
        store, loss = self._store, self._store.loss(map_id)
        rng = rng_for(self._seed, "relocalization", frame.features.index)
        with self._timer("relocalize"), self._lock:
            reach = store.reach(map_id)
            also = [store.last_keyframe(map_id)] if self._config.relocalization.last_keyframe else []
            found = store.places(map_id).relocalizer.relocalize(frame, rng, reach, also=also)
            if found.success:
                tracker = Tracker(store[map_id], self._config.tracking, self._timer)
                self.probation = Probation(
                    map_id,
                    frame,
                    found.keyframe,
                    tracker,
                    self._config.belief,
                    loss.at.stamp_s,
                    self._withdrawn,
                    loss.doubt,
                    reach,
                )
        if found.success and self._config.belief is None:
            return TrackingOutcome(True, found.inliers, found.matches)
        reason = "on_probation" if found.success else found.reason
        return TrackingOutcome(False, found.inliers, found.matches, reason)

    def _on_probation(
        self, probation: Probation, frame: Frame, map_ids: Sequence[int]
    ) -> tuple[TrackingOutcome, Probation | None]:
        """Track the frame where an earlier one was relocalized."""
        if probation.map_id in map_ids:
            with self._lock:
                outcome = probation.offer(frame)
        else:
            reason = "map_in_use" if probation.map_id in self._store else "maps_are_joined"
            outcome = TrackingOutcome(False, 0, 0, reason)
            probation.withdraw(outcome.reason)
        if probation.verdict is Verdict.WITHDRAWN:
            self._end(probation, frame)
            frame.point[:] = -1
        elif probation.verdict is Verdict.CONFIRMED:
            self.probation = None
            return outcome, probation
        return outcome, None

    def _end(self, probation: Probation, frame: Frame) -> None:
        """End a probation that was not confirmed; its frames count against the next one."""
        self.probation = None
        self._withdrawn += (probation.withdrawn(),)
        self._emit(
            frame,
            ev.RelocalizationWithdrawn,
            probation.map_id,
            keyframe=probation.tracker.map.frame_index(probation.keyframe),
            first_frame=probation.first.features.index,
            frames=len(probation.frames),
            reason=probation.reason,
            believed=probation.believed,
        )
