"""What follows a map into the one that has absorbed it: the tracker, the mapper, the frames of a recovery."""

from collections.abc import Sequence

from slam.core.frame import Frame
from slam.dual.fusion.fuse import Fused
from slam.map._map_kernels import resolve_points
from slam.map.map import Map
from slam.mapping.local_mapping import LocalMapper
from slam.tracking.tracker import Tracker


def rebase_tracking(tracker: Tracker, mapper: LocalMapper, old: Map, fused: Fused, scale: float) -> None:
    """Go on in the map that has absorbed the one tracked in.

    Args:
        tracker, mapper: of the absorbed map.
        old: the map that has absorbed it.
        fused: where its rows are.
        scale: took its lengths to the old map's.
    """
    last = tracker.last
    if last is None:
        raise RuntimeError("the tracker has not been started")
    row = last.reference_keyframe + fused.keyframes
    scale *= fused.factor[row]
    _refer(last, row, scale)
    last.point[last.point >= 0] += fused.points
    resolve_points(old.arrays, last.point)
    if tracker.velocity is not None:
        tracker.velocity = tracker.velocity.copy()
        tracker.velocity[:3, 3] *= scale
    tracker.rebase(old, last)
    mapper.rebase(old)


def rebase_frames(frames: Sequence[Frame], keyframes: int, fused: Fused, scale: float) -> None:
    """Refer the frames that a recovery has tracked to the fused map.

    Args:
        frames: tracked in the recovery's copy of the new map; changed in place, their points are void.
        keyframes: offset of the copy's rows in the new map.
        fused: where the new map's rows are.
        scale: takes the copy's lengths to the old map's.
    """
    for frame in frames:
        row = frame.reference_keyframe + keyframes + fused.keyframes
        _refer(frame, row, scale * fused.factor[row])


def _refer(frame: Frame, keyframe: int, scale: float) -> None:
    frame.reference_keyframe = keyframe
    frame.T_cam_reference = frame.T_cam_reference.copy()
    frame.T_cam_reference[:3, 3] *= scale
