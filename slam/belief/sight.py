"""A view at a supposed place, as the model takes it."""

import numpy as np

from dslab.slam.association._kernels import density_of
from dslab.slam.association.descriptors import odds_by_distance
from dslab.slam.association.placing import LEAST_RIGHT, refine, take_matches
from dslab.slam.belief import _sight_kernels as kernels
from dslab.slam.belief.model import Sight
from dslab.slam.core.frame import Frame, FrameFeatures
from dslab.slam.core.geometry import camera_centre
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import sim3_decompose

_LOOSE_PX = 4.0
"""Standard deviation of where points are expected, by the error of a pose that is only supposed."""
_DRIFT = 0.05
"""Of a path, by which it is wrong at its end: .04 by what loops have shown, and a little more."""


def sight_of(
    map_: Map, points: np.ndarray, S_cam_map: np.ndarray, features: FrameFeatures, depth: float
) -> Sight:
    """What a view should show of points of a map, and what it shows.

    Args:
        map_: the map.
        points: (Q,) int32 rows of its points around the place.
        S_cam_map: (4, 4) supposed similarity from the map to the view's camera.
        features: of the view.
        depth: median one of the place.
    """
    a, view = map_.arrays, map_.view
    image_px2 = (view.x_max - view.x_min) * (view.y_max - view.y_min)
    point, cell, shown, angle, zoom = kernels.look(
        a, view, rigid_of(S_cam_map), map_.noise2, _LOOSE_PX**2, np.asarray(points, np.int32), features.xy,
        features.octave, features.descriptors, features.cell_start, 0,
        density_of(features.octave, len(view.scale), image_px2), odds_by_distance(),
    )  # fmt: skip
    found, visible = (counts[point].astype(np.float64) for counts in (a.pt_found, a.pt_visible))
    centre = camera_centre(rigid_of(S_cam_map)) / (depth or 1.0)
    return Sight(point, cell, shown, found, visible, angle, zoom, centre)


def settled(
    map_: Map, points: np.ndarray, T_cam_map: np.ndarray, features: FrameFeatures, depth: float, moved: float
) -> np.ndarray:
    """(4, 4) the likeliest pose of a view near where its own map has carried a supposed place.

    Args:
        map_: of the place.
        points: (Q,) int32 rows of its points around.
        T_cam_map: (4, 4) the pose, lengths of the map.
        features: of the view.
        depth: median one of the place.
        moved: since the place was supposed, lengths of the map; of that the view's own map has drifted a
            part.
    """
    if depth <= 0:
        return T_cam_map
    frame = Frame(features, T_cam_map=T_cam_map.copy())
    variance = (_LOOSE_PX / map_.view.fx) ** 2 + (_DRIFT * moved / depth) ** 2
    covariance = np.diag(np.repeat([variance * depth**2, variance], 3))
    take_matches(map_, frame, np.asarray(points, np.int32), covariance)
    if (frame.point >= 0).sum() < LEAST_RIGHT:
        return T_cam_map
    right, _ = refine(map_, frame, np.linalg.inv(covariance))
    return frame.T_cam_map if right >= LEAST_RIGHT else T_cam_map


def rigid_of(S_cam_map: np.ndarray) -> np.ndarray:
    """(4, 4) the pose of a similarity, in lengths of the map: what it shows is the same."""
    scale, _, _ = sim3_decompose(S_cam_map)
    T = np.ascontiguousarray(S_cam_map, np.float64).copy()
    T[:3] /= scale
    return T
