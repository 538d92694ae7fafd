"""What mapping, loop closing and self-calibration hand over, taken over between two frames."""

from collections.abc import Iterable
from typing import Protocol

from dslab.slam.core import events as ev
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Frame
from dslab.slam.map.adjustment import apply_adjustment
from dslab.slam.map.relation import loop_relation
from dslab.slam.map_store import MapStore
from dslab.slam.runtime.backend import Adjusted, Calibrated, Corrected, Refused
from dslab.slam.tracking.tracker import Tracker


class EmitAt(Protocol):
    """Adds an event of a map at a frame."""

    def __call__(self, frame: Frame, kind: type[ev.Event], map_id: int, **fields: object) -> None:
        """Add it."""


def take_correction(change: Corrected, store: MapStore, tracker: Tracker, emit: EmitAt) -> None:
    """Take over a closed loop: into the map, the poses of its frames and the tracker."""
    m, loop = change.task.mapper.map, change.loop
    relation = loop_relation(m, loop.keyframe, loop.loop_keyframe, loop.S_cam_map)
    m.adopt(change.corrected_map)
    store.poses.rescale(m.map_id, change.factor)
    tracker.corrected(change.factor)
    emit(
        change.task.frame,
        ev.LoopClosed,
        m.map_id,
        keyframe=m.frame_index(loop.keyframe),
        loop_keyframe=m.frame_index(loop.loop_keyframe),
        scale=float(change.factor[loop.keyframe]),
        matches=len(loop.points),
        cpu_ms=change.cpu_ms,
        relation=relation,
    )


def take_adjustment(change: Adjusted, emit: EmitAt) -> None:
    """Take over the global bundle adjustment behind a loop."""
    m = change.task.mapper.map
    apply_adjustment(m, change.adjustment)
    emit(
        change.task.frame,
        ev.MapAdjusted,
        m.map_id,
        keyframes=len(change.adjustment.keyframes),
        points=len(change.adjustment.points),
        cpu_ms=change.cpu_ms,
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


def report_refusal(change: Refused, emit: EmitAt) -> None:
    """Report a loop that was refused."""
    m, refusal = change.task.mapper.map, change.refusal
    emit(
        change.task.frame,
        ev.LoopRefused,
        m.map_id,
        keyframe=m.frame_index(refusal.keyframe),
        loop_keyframe=m.frame_index(refusal.loop_keyframe),
        matches=refusal.matches,
        reason=refusal.reason,
    )
