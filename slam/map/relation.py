"""What a loop closure, a fusion or a relocalization asserts, put down for whoever judges it later."""

from collections.abc import Collection, Sequence

import numpy as np

from dslab.slam.core.frame import Frame, FrameFeatures
from dslab.slam.core.relation import PlacedFrames, Relation
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import moved, sim3_inverse

_COVISIBLE = 20  # most covisible keyframes of a side
_IN_TIME = 20  # most further keyframes of a side, the next ones in time: covisible ones may stand too close


def loop_relation(map_: Map, keyframe: int, loop_keyframe: int, S_cam_map: np.ndarray) -> Relation:
    """Relation asserted by a loop, before the map is corrected.

    Args:
        map_: the map, not corrected yet.
        keyframe, loop_keyframe: rows of the recognising and the recognised keyframe.
        S_cam_map: (4, 4) similarity from points around the loop keyframe to the keyframe's camera.
    """
    middle = (map_.frame_index(keyframe) + map_.frame_index(loop_keyframe)) / 2
    later = {int(k) for k in map_.keyframes() if map_.frame_index(int(k)) > middle}
    earlier = set(map(int, map_.keyframes())) - later
    covisible = set(_covisible(map_, keyframe))
    new = _side(map_, keyframe, not_in_time=earlier)
    old = _side(map_, loop_keyframe, without=covisible, not_in_time=later)
    S_old_new = sim3_inverse(S_cam_map) @ map_.T_cam_map(keyframe)
    return Relation(_placed(map_, old), _placed(map_, new, S_old_new), _depth(map_, loop_keyframe))


def fusion_relation(
    fused: Map, first_new: int, old_keyframe: int, new_keyframe: int, last_frame: int | None = None
) -> Relation:
    """Relation asserted by a fusion, as soon as the two maps are one.

    Args:
        fused: the map.
        first_new: first of the rows that come from the new map.
        old_keyframe, new_keyframe: rows of the aligned keyframes.
        last_frame: last frame of the trusted part of the old map; None for all of it.
    """
    end = np.inf if last_frame is None else last_frame
    rows = [int(k) for k in fused.keyframes()]
    new, old = {k for k in rows if k >= first_new}, {k for k in rows if k < first_new}
    distrusted = {k for k in old if fused.frame_index(k) > end}
    old_side, new_side = _side(fused, old_keyframe, new | distrusted), _side(fused, new_keyframe, old)
    return Relation(_placed(fused, old_side), _placed(fused, new_side), _depth(fused, old_keyframe))


def relocalization_relation(map_: Map, frames: Sequence[Frame]) -> Relation:
    """Relation asserted by relocalized frames: their poses in the surroundings of the first's reference."""
    keyframe = frames[0].reference_keyframe
    own = PlacedFrames(
        np.array([f.features.index for f in frames], int),
        np.array([f.features.stamp_s for f in frames], float),
        np.array([np.linalg.inv(f.T_cam_map) for f in frames]),
    )
    return Relation(_placed(map_, _side(map_, keyframe)), own, _depth(map_, keyframe))


def supposed_relation(map_: Map, keyframe: int, features: FrameFeatures, T_cam_map: np.ndarray) -> Relation:
    """Relation that a view asserts which is supposed to be near a keyframe, at a pose (4, 4)."""
    own = PlacedFrames(
        np.array([features.index], int), np.array([features.stamp_s]), np.linalg.inv(T_cam_map)[None]
    )
    return Relation(_placed(map_, _side(map_, keyframe)), own, _depth(map_, keyframe))


def _side(
    map_: Map, keyframe: int, without: Collection[int] = (), not_in_time: Collection[int] = ()
) -> list[int]:
    """A keyframe, those that share most of its points, then the next ones in time."""
    side = [k for k in _covisible(map_, keyframe) if k not in without][:_COVISIBLE]
    at, taken = map_.frame_index(keyframe), {*side, *without, *not_in_time}
    others = [int(k) for k in map_.keyframes() if int(k) not in taken]
    return side + sorted(others, key=lambda k: abs(map_.frame_index(k) - at))[:_IN_TIME]


def _covisible(map_: Map, keyframe: int) -> list[int]:
    live = map_.live(keyframe)
    return [live, *map(int, map_.neighbours(live, map_.n_keyframes))]


def _depth(map_: Map, keyframe: int) -> float:
    return float(kernels.median_depth(map_.arrays, map_.live(keyframe)))


def _placed(map_: Map, rows: Sequence[int], S_old_map: np.ndarray | None = None) -> PlacedFrames:
    """Poses of keyframes, moved by a similarity if one is given."""
    T = np.array([np.linalg.inv(map_.T_cam_map(k)) for k in rows]).reshape(-1, 4, 4)
    if S_old_map is not None:
        T = moved(S_old_map, T)
    features = [map_.features(k) for k in rows]
    return PlacedFrames(
        np.array([f.index for f in features], int), np.array([f.stamp_s for f in features], float), T
    )
