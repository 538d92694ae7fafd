"""What mapping, loop closing and self-calibration hand over, taken over between two frames."""

from collections.abc import Iterable
from typing import Protocol

from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Frame
from dslab.slam.map.adjustment import apply_adjustment
from dslab.slam.map.relation import loop_relation
from dslab.slam.map_store import MapStore
from dslab.slam.runtime.backend import Adjusted, Calibrated, Corrected, Mapped, Refused, Searched
from dslab.slam.tracking.tracker import Tracker


class EmitAt(Protocol):
    """Adds an event of a map at a frame."""

    def __call__(self, frame: Frame, kind: type[ev.Event], map_id: int, **fields: object) -> None:
        """Add it."""


class Handover:
    """Takes over what mapping and loop closing hand over; sums up their time.

    Args:
        store: the maps.
        emit: adds an event.

    Attributes:
        corrections: number of times that mapped keyframes were moved by loop closing.
        mapping_cpu_ms, loop_cpu_ms: CPU milliseconds of both in this frame.
    """

    def __init__(self, store: MapStore, emit: EmitAt) -> None:
        self.corrections = 0
        self.mapping_cpu_ms = self.loop_cpu_ms = 0.0
        self._store = store
        self._emit = emit

    def take(self, change: Mapped | Searched | Corrected | Refused | Adjusted, tracker: Tracker) -> None:
        """Take over a change; ``tracker``: of the current map."""
        match change:
            case Mapped():
                self.mapping_cpu_ms += change.cpu_ms
                if tracker.last is change.frame:
                    tracker.keyframe_made(change.frame, change.keyframe)
            case Refused():
                self._report(change)
            case Searched():
                self.loop_cpu_ms += change.cpu_ms
            case Corrected():
                self.loop_cpu_ms += change.cpu_ms
                self.corrections += 1
                self._correct(change, tracker)
            case Adjusted():
                self.loop_cpu_ms += change.cpu_ms
                self.corrections += 1
                self._adjust(change)

    def _correct(self, change: Corrected, tracker: Tracker) -> None:
        """Take over a closed loop: into the map, the poses of its frames and the tracker."""
        m, loop = change.task.mapper.map, change.loop
        relation = loop_relation(m, loop.keyframe, loop.loop_keyframe, loop.S_cam_map)
        m.adopt(change.corrected_map)
        self._store.poses.rescale(m.map_id, change.factor)
        tracker.corrected(change.factor)
        self._emit(
            change.task.frame,
            ev.LoopClosed,
            m.map_id,
            keyframe=m.frame_index(loop.keyframe),
            loop_keyframe=m.frame_index(loop.loop_keyframe),
            scale=float(change.factor[loop.keyframe]),
            matches=len(loop.points),
            cpu_ms=change.cpu_ms,
            relation=relation,
            believed=loop.believed,
        )

    def _adjust(self, change: Adjusted) -> None:
        """Take over the global bundle adjustment behind a loop."""
        m = change.task.mapper.map
        apply_adjustment(m, change.adjustment)
        adjusted = {"keyframes": len(change.adjustment.keyframes), "points": len(change.adjustment.points)}
        self._emit(change.task.frame, ev.MapAdjusted, m.map_id, **adjusted, cpu_ms=change.cpu_ms)

    def _report(self, change: Refused) -> None:
        """Report a loop that was refused."""
        m, refusal = change.task.mapper.map, change.refusal
        self._emit(
            change.task.frame,
            ev.LoopRefused,
            m.map_id,
            keyframe=m.frame_index(refusal.keyframe),
            loop_keyframe=m.frame_index(refusal.loop_keyframe),
            matches=refusal.matches,
            reason=refusal.reason,
            believed=refusal.believed,
        )


def take_refinement(change: Calibrated, frames: Iterable[Frame], emit: EmitAt) -> PinholeCamera | None:
    """Take over a refined camera, into its map and frames whose features are still to be used.

    Returns:
        The camera from now on; None if it stays as it is.
    """
    found, m = change.refinement, change.task.mapper.map
    if found is None:
        return None
    found.apply(m)
    for frame in frames:
        frame.features = frame.features.seen_by(found.camera)
        if frame.reference_keyframe >= 0:
            frame.T_cam_map = frame.T_cam_reference @ m.T_cam_map(frame.reference_keyframe)
    emit(
        change.task.frame,
        ev.CameraRefined,
        m.map_id,
        **dict(zip(("k1", "k2", "p1", "p2"), found.camera.residual, strict=True)),
        readout_s=found.camera.readout_s,
        shift_px=found.shift_px,
        significance=found.significance,
        keyframes=len(found.adjustment.keyframes),
        cpu_ms=change.cpu_ms,
    )
    return found.camera
