"""Rebase of tracker, mapper and a recovery's frames onto the map that has absorbed theirs."""

from collections.abc import Sequence

from dslab.slam.core.frame import Frame
from dslab.slam.dual.fusion.fuse import Fused
from dslab.slam.map._map_kernels import resolve_points
from dslab.slam.map.map import Map
from dslab.slam.mapping.local_mapping import LocalMapper
from dslab.slam.tracking.tracker import Tracker


def rebase_tracking(
    tracker: Tracker,
    mapper: LocalMapper,
    old: Map,
    fused: Fused,
    scale: float,
    waiting: Sequence[Frame] = (),
) -> None:
    """Move tracking and mapping to the map that has absorbed the tracked one.

    Args:
        tracker, mapper: of the absorbed map.
        old: the map that has absorbed it.
        fused: position of its rows.
        scale: factor from its lengths to the old map's.
        waiting: tracked frames that are still to become keyframes.
    """
    last = tracker.last
    if last is None:
        raise RuntimeError("the tracker has not been started")
    if tracker.velocity is not None:
        tracker.velocity = tracker.velocity.copy()
        tracker.velocity[:3, 3] *= scale * fused.factor[last.reference_keyframe + fused.keyframes]
    for frame in (last, *(frame for frame in waiting if frame is not last)):
        row = frame.reference_keyframe + fused.keyframes
        _set_reference(frame, row, scale * fused.factor[row])
        frame.T_cam_map = frame.T_cam_reference @ old.T_cam_map(row)
        frame.point[frame.point >= 0] += fused.points
        resolve_points(old.arrays, frame.point)
    tracker.rebase(old, last)
    mapper.rebase(old)


def rebase_frames(frames: Sequence[Frame], keyframes: int, fused: Fused, scale: float) -> None:
    """Refer the frames that a recovery has tracked to the fused map.

    Args:
        frames: tracked in the recovery's copy of the new map; changed in place, their points not updated.
        keyframes: offset of the copy's rows in the new map.
        fused: position of the new map's rows.
        scale: factor from the copy's lengths to the old map's.
    """
    for frame in frames:
        row = frame.reference_keyframe + keyframes + fused.keyframes
        _set_reference(frame, row, scale * fused.factor[row])


def _set_reference(frame: Frame, keyframe: int, scale: float) -> None:
    frame.reference_keyframe = keyframe
    frame.T_cam_reference = frame.T_cam_reference.copy()
    frame.T_cam_reference[:3, 3] *= scale
