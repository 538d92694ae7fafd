"""A view at a supposed place, as the model takes it."""

import numpy as np

from dslab.slam.association._kernels import density_of
from dslab.slam.association.descriptors import odds_by_distance
from dslab.slam.belief import _sight_kernels as kernels
from dslab.slam.belief.model import Sight
from dslab.slam.core.frame import FrameFeatures
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import sim3_decompose

_LOOSE_PX = 4.0
"""Standard deviation of where points are expected, by the error of a pose that is only supposed."""


def sight_of(map_: Map, points: np.ndarray, S_cam_map: np.ndarray, features: FrameFeatures) -> Sight:
    """What a view should show of points of a map, and what it shows.

    Args:
        map_: the map.
        points: (Q,) int32 rows of its points around the place.
        S_cam_map: (4, 4) supposed similarity from the map to the view's camera.
        features: of the view.
    """
    a, view = map_.arrays, map_.view
    image_px2 = (view.x_max - view.x_min) * (view.y_max - view.y_min)
    point, cell, shown, angle, zoom = kernels.look(
        a, view, rigid_of(S_cam_map), map_.noise2, _LOOSE_PX**2, np.asarray(points, np.int32), features.xy,
        features.octave, features.descriptors, features.cell_start, 0,
        density_of(features.octave, len(view.scale), image_px2), odds_by_distance(),
    )  # fmt: skip
    found, visible = (counts[point].astype(np.float64) for counts in (a.pt_found, a.pt_visible))
    return Sight(point, cell, shown, found, visible, angle, zoom)


def rigid_of(S_cam_map: np.ndarray) -> np.ndarray:
    """(4, 4) the pose of a similarity, in lengths of the map: what it shows is the same."""
    scale, _, _ = sim3_decompose(S_cam_map)
    T = np.ascontiguousarray(S_cam_map, np.float64).copy()
    T[:3] /= scale
    return T
