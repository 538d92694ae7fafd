"""What a tracker meets in footage: samples over frames, observations and map points."""

import cv2
import numpy as np

from dslab.slam.map.map import Map
from dslab.slam.published._search_kernels import search_local_map
from dslab.slam.system import MonocularSlam
from dslab.slam.tracking.local_map import local_map

MEASURES: dict[str, tuple[str, bool]] = {
    "noise": ("noise in even areas, grey levels", False),
    "sharpness": ("contrast of one pixel over that of two", False),
    "clipped_dark": ("pixels of level 5 or less, share", False),
    "clipped_bright": ("pixels of level 250 or more, share", False),
    "corner_strength": ("strength of corners (FAST), grey levels", True),
    "empty_tiles": ("tiles without a corner over 20 levels, share", False),
    "outliers": ("matches per frame that do not fit its pose, share", False),
    "inliers": ("inliers per frame", False),
    "descriptor_distance": ("descriptor of an observation to its point's, bits", False),
    "octave_change": ("octave of an observation less the predicted one", False),
    "residual": ("residual in the finished map, sigma of its octave", False),
    "live_residual": ("residual of all matches, sigma of its octave", False),
    "track_length": ("keyframes that observe a point", True),
    "found": ("times found over times expected, of a point", False),
    "relative_depth": ("depth over its keyframe's median", True),
}
"""Every measure, with its label and whether it is drawn on a logarithmic axis."""
RADIUS_PX = 12.0
"""Window of the search for live residuals on the finest level: three times that of ORB-SLAM's release."""
_EVEN_SHARE = 0.05  # of the tiles, the most even ones, in which noise is measured
_NOISE_TILE_PX = 16
_LEAST_CORNER, _CLEAR_CORNER = 7, 20
_TILES_ACROSS = 8
_DARK, _BRIGHT = 5, 250


def frame_statistics(image: np.ndarray) -> dict[str, np.ndarray]:
    """Samples from a (H, W) uint8 grey frame; empty where it has nothing to measure."""
    corners = cv2.FastFeatureDetector_create(_LEAST_CORNER, True).detect(image)
    strength = np.array([c.response for c in corners], float)
    places = np.array([c.pt for c in corners], float).reshape(-1, 2)
    side = image.shape[1] / _TILES_ACROSS
    tiles = max(1, round(image.shape[0] / side)), _TILES_ACROSS
    ends = [[0, image.shape[0]], [0, image.shape[1]]]
    counts = np.histogram2d(*places[strength > _CLEAR_CORNER, ::-1].T, tiles, ends)[0]
    return {
        "noise": _noise_levels(image),
        "sharpness": _sharpness(image),
        "clipped_dark": np.array([np.mean(image <= _DARK)]),
        "clipped_bright": np.array([np.mean(image >= _BRIGHT)]),
        "corner_strength": strength,
        "empty_tiles": np.array([np.mean(counts == 0)]),
    }


def _noise_levels(image: np.ndarray) -> np.ndarray:
    """(0,) or (1,) noise of a frame, grey levels, from its most even tiles that are not clipped.

    Source: Immerkaer, "Fast noise variance estimation", CVIU 1996: a mask that planes and edges along the
    axes do not pass.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
    detail = cv2.filter2D(image.astype(np.float32), -1, mask) ** 2
    size = _NOISE_TILE_PX
    rows, columns = image.shape[0] // size, image.shape[1] // size

    def tiles(values: np.ndarray) -> np.ndarray:
        cut = values[: rows * size, : columns * size]
        return cut.reshape(rows, size, columns, size).swapaxes(1, 2).reshape(rows * columns, size * size)

    levels = tiles(image)
    sound = (levels.min(1) > _DARK) & (levels.max(1) < _BRIGHT)
    if not sound.any():
        return np.empty(0)
    variance = np.sort(tiles(detail)[sound].mean(1))
    return np.array([np.sqrt(variance[: max(1, round(_EVEN_SHARE * len(variance)))].mean())])


def _sharpness(image: np.ndarray) -> np.ndarray:
    fine = image.astype(np.float32)
    half = cv2.resize(fine, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    of_fine, of_half = (float(np.sqrt(np.mean(cv2.Laplacian(x, cv2.CV_32F) ** 2))) for x in (fine, half))
    return np.array([of_fine / of_half]) if of_half > 0 else np.empty(0)


def live_residuals(system: MonocularSlam) -> np.ndarray:
    """Match the last tracked frame with its local map once more, at the pose that was found.

    The tracker removes matches that do not fit, so that what it keeps says nothing of how far they lie off.
    Here the same search runs in wider windows, and everything that it finds counts. Neither map nor tracker
    changes.

    Args:
        system: just after a frame that was tracked and made no keyframe.

    Returns:
        (n,) float64 distances of the keypoints from their points, in sigma of their octave.
    """
    m, last = system.current_map, system.tracker.last
    if last is None:
        return np.empty(0)
    f, T = last.features, np.ascontiguousarray(last.T_cam_map)
    near = system.tracker.config.local_map_keyframes
    known = last.point.copy()
    _, points = local_map(m, known, near)
    point = np.full(len(f), -1, np.int32)
    search_local_map(
        m.arrays, m.view, T, points, f.xy, f.octave, f.descriptors, f.cell_start, point, RADIUS_PX, False
    )
    row = np.flatnonzero(point >= 0)
    p_cam = m.arrays.pt_xyz[point[row]] @ T[:3, :3].T + T[:3, 3]
    return _in_sigma(m, p_cam, f.xy[row], f.octave[row])


def map_statistics(map_: Map) -> dict[str, np.ndarray]:
    """Samples from a finished map: of every observation, or of every point, that was not removed."""
    a, view = map_.arrays, map_.view
    used = int(a.kf_start[map_.n_keyframes])
    row = np.flatnonzero(a.kp_point[:used] >= 0)
    row = row[~a.kf_bad[a.kp_keyframe[row]] & ~a.pt_bad[a.kp_point[row]]]
    keyframe, point, octave = a.kp_keyframe[row], a.kp_point[row], a.kp_octave[row]
    T = a.kf_T_cam_map[keyframe]
    p_cam = np.einsum("nij,nj->ni", T[:, :3, :3], a.pt_xyz[point]) + T[:, :3, 3]
    seen = p_cam[:, 2] > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        error = _in_sigma(map_, p_cam, a.kp_xy[row], octave)
        level = np.log(a.pt_max_distance[point] / np.linalg.norm(p_cam, axis=1)) / view.log_scale
    expected = np.clip(np.ceil(level), 0, len(view.scale) - 1)
    bits = a.kp_descriptor[row] ^ a.pt_descriptor[point]
    distance = np.unpackbits(bits.view(np.uint8), axis=1).sum(1)
    points = map_.points()
    visible = a.pt_visible[points]
    return {
        # The keyframe that gives a point its descriptor is no comparison.
        "descriptor_distance": distance[distance > 0].astype(float),
        "octave_change": (octave - expected)[seen],
        "residual": error[seen],
        "relative_depth": _relative(p_cam[seen, 2], keyframe[seen]),
        "track_length": a.pt_observations[points].astype(float),
        "found": a.pt_found[points][visible > 0] / visible[visible > 0],
    }


def _in_sigma(map_: Map, p_cam: np.ndarray, xy: np.ndarray, octave: np.ndarray) -> np.ndarray:
    """(n,) distances of keypoints from (n, 3) points of the camera, in sigma of their octave."""
    view = map_.view
    uv = p_cam[:, :2] / p_cam[:, 2:] * (view.fx, view.fy) + (view.cx, view.cy)
    return np.linalg.norm(uv - xy, axis=1) * np.sqrt(view.inv_sigma2[octave])


def _relative(depth: np.ndarray, keyframe: np.ndarray) -> np.ndarray:
    relative = np.empty_like(depth)
    for k in np.unique(keyframe):
        of_k = keyframe == k
        relative[of_k] = depth[of_k] / np.median(depth[of_k])
    return relative
