"""Statistics of a finished map: what its observations and points say about the footage."""

import numpy as np

from dslab.slam.map.map import Map


def map_statistics(map_: Map) -> dict[str, np.ndarray]:
    """Values of the measures that a map holds.

    Args:
        map_: finished map; culled keyframes and dropped points are left out.

    Returns:
        (n,) float64 each, by the measure's name: of every observation, or of every point.
    """
    a, view = map_.arrays, map_.view
    used = int(a.kf_start[map_.n_keyframes])
    row = np.flatnonzero(a.kp_point[:used] >= 0)
    row = row[~a.kf_bad[a.kp_keyframe[row]] & ~a.pt_bad[a.kp_point[row]]]
    keyframe, point, octave = a.kp_keyframe[row], a.kp_point[row], a.kp_octave[row]
    T = a.kf_T_cam_map[keyframe]
    p_cam = np.einsum("nij,nj->ni", T[:, :3, :3], a.pt_xyz[point]) + T[:, :3, 3]
    depth = p_cam[:, 2]
    seen = depth > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = p_cam[:, :2] / depth[:, None] * (view.fx, view.fy) + (view.cx, view.cy)
        error = np.linalg.norm(uv - a.kp_xy[row], axis=1) * np.sqrt(view.inv_sigma2[octave])
        level = np.log(a.pt_max_distance[point] / np.linalg.norm(p_cam, axis=1)) / view.log_scale
    expected = np.clip(np.ceil(level), 0, len(view.scale) - 1)
    bits = a.kp_descriptor[row] ^ a.pt_descriptor[point]
    distance = np.unpackbits(bits.view(np.uint8), axis=1).sum(1)
    # The keyframe that gives a point its descriptor is no comparison.
    compared = distance > 0
    points = map_.points()
    visible = a.pt_visible[points]
    return {
        "descriptor_distance": distance[compared].astype(float),
        "octave_change": (octave - expected)[seen],
        "residual": error[seen],
        "relative_depth": _relative(depth[seen], keyframe[seen]),
        "track_length": a.pt_observations[points].astype(float),
        "found": a.pt_found[points][visible > 0] / visible[visible > 0],
    }


def _relative(depth: np.ndarray, keyframe: np.ndarray) -> np.ndarray:
    """Depths over the median depth of their keyframe."""
    relative = np.empty_like(depth)
    for k in np.unique(keyframe):
        of_k = keyframe == k
        relative[of_k] = depth[of_k] / np.median(depth[of_k])
    return relative
