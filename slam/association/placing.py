"""A frame among the points of a map: which of them it shows, its pose, and whether it is there at all."""

from typing import NamedTuple

import numpy as np

from dslab.slam.association._kernels import CELLS, associate, density_of, matches_of
from dslab.slam.association.descriptors import odds_by_distance
from dslab.slam.core.frame import Frame
from dslab.slam.map.map import Map
from dslab.slam.optimization.student import CHI2_99
from dslab.slam.optimization.uncertain_pose import uncertain_pose

LIKELIER_THAN_NOT = 0.5
LEAST_RIGHT = 12
"""Fewer matches tell no pose, whatever their covariance says: chance fits a few."""
_NO_PRIOR = np.zeros((6, 6))


class Sighted(NamedTuple):
    """Points that a frame shows by features which are not the map's.

    Attributes:
        xyz: (k, 3) map frame.
        pixels: (k, 2) undistorted, px.
        inv_sigma2: (k,) information of each feature, 1/px².
    """

    xyz: np.ndarray
    pixels: np.ndarray
    inv_sigma2: np.ndarray


NOTHING = Sighted(np.empty((0, 3)), np.empty((0, 2)), np.empty(0))


def take_matches(
    map_: Map, frame: Frame, points: np.ndarray, covariance: np.ndarray, observing: bool = False
) -> None:
    """Match a frame with points about its pose: those that are likelier than not, and what they say of it.

    Args:
        map_: of the points.
        frame: with a pose; matches, their windows and the evidence of its view are written.
        points: (Q,) int32.
        covariance: (6, 6) of the pose, as a twist from the left.
        observing: count in the map how often its points are in view.
    """
    frame.sought = frame.T_cam_map.copy(), covariance.copy()
    found = _associated(map_, frame, points, covariance, observing)
    frame.point, frame.area, frame.evidence = found


def evidence_of_view(map_: Map, frame: Frame, points: np.ndarray) -> float:
    """Log of the odds that a frame is where its pose says, by points (Q,) int32 that it should show there."""
    return _associated(map_, frame, points, frame.covariance, False)[2]


def _associated(
    map_: Map, frame: Frame, points: np.ndarray, covariance: np.ndarray, observing: bool
) -> tuple[np.ndarray, np.ndarray, float]:
    f, view = frame.features, map_.view
    return associate(
        map_.arrays, view, frame.T_cam_map, covariance, _noise2(map_, frame), points, f.xy, f.octave,
        f.descriptors, f.cell_start, density_of(f.octave, len(view.scale), _image(map_)), odds_by_distance(),
        LIKELIER_THAN_NOT, observing,
    )  # fmt: skip


def refine(
    map_: Map, frame: Frame, prior: np.ndarray = _NO_PRIOR, also: Sighted = NOTHING
) -> tuple[int, np.ndarray]:
    """Refine a frame's pose by its matches; those that are more likely wrong than right are taken from it.

    Args:
        map_: of its matches.
        frame: with a pose; its covariance, noise and what draws it are written too.
        prior: (6, 6) information of the pose it has, zeros for none.
        also: k further points that it shows, whose positions and noise count as known; wrong ones lie
            anywhere in the window in which 99 % of the right ones do.

    Returns:
        Number of matches that are likely right, and (k,) bool which of the further points are.
    """
    f, view = frame.features, map_.view
    rows, xyz, covariance, pixels, information, area, spread = matches_of(
        map_.arrays, view, frame.point, f.xy, f.octave, frame.area, _image(map_), _noise2(map_, frame)
    )
    n = len(rows)
    if len(also.xyz):
        theirs = np.pi * CHI2_99 / also.inv_sigma2
        xyz, pixels = np.concatenate([xyz, also.xyz]), np.concatenate([pixels, also.pixels])
        covariance = np.concatenate([covariance, np.zeros((len(theirs), 6))])
        information, area = np.concatenate([information, also.inv_sigma2]), np.concatenate([area, theirs])
    found = uncertain_pose(
        frame.T_cam_map, xyz, covariance, pixels, information, area, map_.noise2, spread, prior,
        view.intrinsics, (view.x_max - view.x_min) / CELLS, n,
    )  # fmt: skip
    right = found.right > LIKELIER_THAN_NOT
    frame.T_cam_map, frame.covariance, frame.drawn = found.T_cam_map, found.covariance, found.drawn
    frame.noise2, frame.noise = found.noise2, max(float(np.sqrt(found.noise2)), 1.0)
    frame.cells, frame.depth = found.cells, found.depth
    frame.point[rows[~right[:n]]] = -1
    return int(right[:n].sum()), right[n:]


def _image(map_: Map) -> float:
    """Area, px²."""
    view = map_.view
    return (view.x_max - view.x_min) * (view.y_max - view.y_min)


def _noise2(map_: Map, frame: Frame) -> float:
    """Variance of a frame's keypoints, as far as it has told it; else that of the map's."""
    return map_.noise2 if np.isnan(frame.noise2) else frame.noise2
