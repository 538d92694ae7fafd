"""Match a frame with points of a map and refine its pose by them."""

from collections.abc import Sequence

import numpy as np

from dslab.slam.core.frame import Frame, twist_between
from dslab.slam.map._local_map_kernels import local_keyframes, points_seen
from dslab.slam.map.map import MIN_SHARED, Map
from dslab.slam.matching import guided
from dslab.slam.matching.brute_force import match_oriented
from dslab.slam.optimization.pose import optimize_pose
from dslab.slam.places.evidence import cells_of

_KEYPOINTS_TO_SEE = 3  # in a cell, of which chance puts one or two anywhere


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


def median_depth(frame: Frame, map_: Map) -> float:
    """Median depth of the points that are found in a frame, map units."""
    points = map_.arrays.pt_xyz[frame.point[frame.point >= 0]]
    return float(np.median(points @ frame.T_cam_map[2, :3] + frame.T_cam_map[2, 3]))


def match_local(
    frame: Frame, map_: Map, points: np.ndarray, widen: float, ratio: float, observing: bool = False
) -> int:
    """Match points of the map with a frame around its pose; number of new matches.

    Args:
        frame: its matches are added to.
        map_: of the points.
        points: (q,) int32 points to be searched.
        widen: factor of the search window, which is 4 px on level 0 if the view is as it was.
        ratio: best over second best descriptor distance.
        observing: count in the map how often its points are in view.
    """
    f = frame.features
    _, count = guided.match_local_points(
        map_.arrays, map_.view, frame.T_cam_map, points,
        f.xy, f.octave, f.descriptors, f.cell_start, frame.point, widen, ratio, observing,
    )  # fmt: skip
    return count


def search_local_map(
    frame: Frame,
    map_: Map,
    most: int,
    widen: float,
    ratio: float,
    max_noise: float = 1.0,
    observing: bool = False,
) -> tuple[int, int, int]:
    """Match a frame with its local map around its pose, and refine that; see :func:`local_map`.

    Returns:
        Number of inliers, number of matches, and the keyframe that shares most points; without one 0, 0, -1.
    """
    keyframes, points = local_map(map_, frame.point, most)
    if not len(keyframes):
        return 0, 0, -1
    match_local(frame, map_, points, widen, ratio, observing)
    matches = int((frame.point >= 0).sum())
    return optimize_frame(frame, map_, max_noise), matches, int(keyframes[0])


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
        known.descriptors[rows], known.angle_deg[rows], f.descriptors, f.angle_deg, guided.NEAR, ratio
    )
    return pairs[:, 1], observed[rows[pairs[:, 0]]]


def optimize_frame(frame: Frame, map_: Map, max_noise: float = 1.0) -> int:
    """Refine a frame's pose by its map matches and remove outliers; number of inliers.

    Args:
        frame: with a pose to start from and matches, of which the outliers are taken.
        map_: of its points.
        max_noise: how many times the noise of the map's keypoints its own may be; see :func:`optimize_pose`.
    """
    rows = np.flatnonzero(frame.point >= 0)
    f, view = frame.features, map_.view
    pose, inlier, frame.noise = optimize_pose(
        frame.T_cam_map,
        map_.arrays.pt_xyz[frame.point[rows]],
        f.xy[rows],
        view.inv_sigma2[f.octave[rows]],
        view.fx, view.fy, view.cx, view.cy, max_noise,
    )  # fmt: skip
    frame.T_cam_map = pose
    frame.point[rows[~inlier]] = -1
    return int(inlier.sum())


def covered_share(frame: Frame, map_: Map) -> float:
    """Share of the cells of the image with keypoints in which points of the map are found too."""
    cell = cells_of(map_.view, frame.features.xy)
    seen = np.bincount(cell) >= _KEYPOINTS_TO_SEE
    found = np.bincount(cell[frame.point >= 0], minlength=len(seen)) > 0
    return float((seen & found).sum() / max(1, seen.sum()))


def note_twist(map_: Map, frame: Frame, twist: np.ndarray) -> None:
    """Note how the camera moved in a frame, if it is a keyframe of the map, once the next one is known."""
    k = frame.reference_keyframe
    if map_.frame_index(k) == frame.features.index and not map_.arrays.kf_bad[k]:
        map_.take_features(k, map_.features(k).moving(twist))


def note_twists(map_: Map, frames: list[Frame]) -> None:
    """Note how the camera moved in both keyframes of a new map, from its first frames, newest first."""
    for keyframe, pair in zip((frames[-1], frames[0]), (frames[:-3:-1], frames[1::-1]), strict=True):
        note_twist(map_, keyframe, twist_between(*pair, depth=1.0))
