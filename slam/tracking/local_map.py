"""Points of a map that a frame may show."""

from collections.abc import Sequence

import numpy as np

from dslab.slam.core.frame import Frame, twist_between
from dslab.slam.map._local_map_kernels import local_keyframes, points_seen
from dslab.slam.map.map import MIN_SHARED, Map
from dslab.slam.matching.brute_force import match_oriented
from dslab.slam.matching.window import FREE_BITS


def local_map(map_: Map, points: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Keyframes that share points (N,) int32, -1 for none, the one that shares most first; all their points.

    Args:
        map_: the map.
        points: seen in a frame or keyframe.
        most: most keyframes, their neighbours included.
    """
    keyframes = local_keyframes(map_.arrays, map_.n_keyframes, points, MIN_SHARED, most)
    return keyframes, points_seen(map_.arrays, map_.n_points, keyframes)


def points_of(map_: Map, keyframes: Sequence[int]) -> np.ndarray:
    """(q,) int32 points that any of some keyframes observe, each once."""
    points = np.unique(np.concatenate([map_.observed_points(k) for k in keyframes]))
    return points[points >= 0].astype(np.int32)


def match_keyframe(frame: Frame, map_: Map, keyframe: int, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Match a frame with a keyframe's points without a prediction.

    Returns:
        Rows of the frame, and the points of the map that match them.
    """
    observed, known, f = map_.observed_points(keyframe), map_.features(keyframe), frame.features
    rows = np.flatnonzero(observed >= 0)
    if not len(rows) or not len(f):
        return np.empty(0, int), np.empty(0, np.int32)
    pairs = match_oriented(
        known.descriptors[rows], known.angle_deg[rows], f.descriptors, f.angle_deg, FREE_BITS, ratio
    )
    return pairs[:, 1], observed[rows[pairs[:, 0]]]


def note_twist(map_: Map, frame: Frame, twist: np.ndarray) -> None:
    """Note how the camera moved in a frame, if it is a keyframe of the map, once the next one is known."""
    k = frame.reference_keyframe
    if map_.frame_index(k) == frame.features.index and not map_.arrays.kf_bad[k]:
        map_.take_features(k, map_.features(k).moving(twist))


def note_twists(map_: Map, frames: list[Frame]) -> None:
    """Note how the camera moved in both keyframes of a new map, from its first frames, newest first."""
    for keyframe, pair in zip((frames[-1], frames[0]), (frames[:-3:-1], frames[1::-1]), strict=True):
        note_twist(map_, keyframe, twist_between(*pair, depth=1.0))
