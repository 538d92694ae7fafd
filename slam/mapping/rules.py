"""What local mapping decides by: how keypoints of keyframes are matched, how their errors weigh, what leaves.

``own`` are rules that follow from covariances, ``published`` those of ORB-SLAM's text.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from dslab.slam.association._kernels import density_of
from dslab.slam.association._mapping_kernels import (
    depths_around,
    fuse_points,
    points_along_rays,
    unobserved_in,
)
from dslab.slam.association.descriptors import odds_by_distance
from dslab.slam.association.placing import LEAST_RIGHT
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map._local_map_kernels import local_keyframes
from dslab.slam.map.map import MIN_SHARED, Map
from dslab.slam.optimization.bundle_adjustment import BundleResult, likeliest_bundle, local_bundle_adjust
from dslab.slam.published import _mapping_kernels as published
from dslab.slam.published._search_kernels import search_keyframe

if TYPE_CHECKING:
    from dslab.slam.mapping.local_mapping import LocalMappingConfig

MapRule = Literal["own", "published"]
"""By which local mapping decides."""
Points = tuple[np.ndarray, np.ndarray, np.ndarray]

_SURE = 0.9
"""Posterior of a match that the map is built on: a wrong one stays."""
_AROUND = 3
"""Keyframes that are looked at for the points of a new one, over those that are searched."""
_SECOND = 5
"""Neighbours of a neighbour that are searched too."""
_FUSE_PX, _JOIN_PX = 3.0, 4.0
"""Windows around points sought in a keyframe, px on the finest level, and across a loop; release."""
_PARALLAX_COSINE = float(np.cos(np.deg2rad(1.15)))
"""Most cosine between the rays of a new point, which VI-C checks; release: .9998."""


class MapRules(ABC):
    """Rules of local mapping."""

    coarser: bool
    """Whether what others see more coarsely makes a keyframe redundant; see ``redundant_share``."""
    least_observations: int
    """Local bundle adjustment holds a keyframe that has fewer."""
    adjust: Callable[..., tuple[BundleResult, np.ndarray]]
    """Local bundle adjustment."""

    def __init__(self, map_: Map, config: "LocalMappingConfig") -> None:
        self.map = map_
        self.config = config

    def expected_depths(self, keyframe: int, otherwise: float = 0.0) -> np.ndarray:
        """What points around say of each keypoint's depth; ``otherwise``, if not 0, where there are none."""
        return np.empty(0)

    @abstractmethod
    def new_points(self, keyframe: int, other: int, nearest: float, expected: np.ndarray) -> Points:
        """Match free keypoints of two keyframes and triangulate them.

        Args:
            keyframe, other: rows.
            nearest: least depth in the first, map units.
            expected: as of :meth:`expected_depths`.

        Returns:
            Keypoints of both (n,) int32 each, points (n, 3).
        """

    @abstractmethod
    def seek(self, keyframe: int, points: np.ndarray, joining: bool = False) -> None:
        """Find points (Q,) int32 in a keyframe that does not observe them; those that are one become one.

        With ``joining`` they are from the other side of a loop or a seam.
        """

    def targets(self, keyframe: int) -> list[int]:
        """Keyframes in which the points of a new one are sought, and whose points are sought in it."""
        m = self.map
        first = m.neighbours(keyframe, self.config.neighbours)
        second = [k for n in first for k in m.neighbours(int(n), _SECOND)]
        return [int(k) for k in dict.fromkeys([*first, *second]) if k != keyframe]

    def redundant(self, keyframe: int) -> float:
        """Share of a keyframe's points of which three others know as much."""
        return kernels.redundant_share(self.map.arrays, keyframe, self.coarser, self.map.view)


class PublishedMapRules(MapRules):
    """Sections VI-C and VI-E of ORB-SLAM."""

    coarser = False
    least_observations = 0
    adjust = staticmethod(partial(local_bundle_adjust, robust_iterations=5))  # release; VI-D

    def new_points(self, keyframe: int, other: int, nearest: float, expected: np.ndarray) -> Points:
        """The nearest descriptor that fulfils the epipolar constraint."""
        m, cosine = self.map, _PARALLAX_COSINE
        return published.new_points(m.arrays, m.view, keyframe, other, nearest, cosine)

    def seek(self, keyframe: int, points: np.ndarray, joining: bool = False) -> None:
        """As points of the local map are sought in a frame."""
        search_keyframe(self.map.arrays, self.map.view, keyframe, points, _JOIN_PX if joining else _FUSE_PX)

    def targets(self, keyframe: int) -> list[int]:
        """The connected keyframes."""
        return [int(k) for k in self.map.neighbours(keyframe, self.config.neighbours)]


class OwnMapRules(MapRules):
    """Matches by their posterior, along rays and in windows of covariances; errors of Student's t."""

    coarser = True
    least_observations = LEAST_RIGHT
    adjust = staticmethod(likeliest_bundle)

    def expected_depths(self, keyframe: int, otherwise: float = 0.0) -> np.ndarray:
        """(n, 3) as of ``depths_around``; other depths are those of another surface."""
        found = depths_around(self.map.arrays, self.map.view, keyframe)
        if otherwise > 0:
            found[found[:, 0] == 0] = otherwise, 1.0, 1.0
        return found

    def new_points(self, keyframe: int, other: int, nearest: float, expected: np.ndarray) -> Points:
        """The likeliest along a ray, where the depth would be known well enough."""
        m = self.map
        return points_along_rays(
            m.arrays, m.view, keyframe, other, m.noise2, nearest, expected, self.config.max_depth_error,
            self._density(other), odds_by_distance(), _SURE,
        )  # fmt: skip

    def seek(self, keyframe: int, points: np.ndarray, joining: bool = False) -> None:
        """In windows of 99 %, by the posterior."""
        m = self.map
        density = self._density(keyframe)
        fuse_points(m.arrays, m.view, keyframe, points, m.noise2, density, odds_by_distance(), _SURE)

    def targets(self, keyframe: int) -> list[int]:
        """Keyframes around that should show most of the new one's points without observing them.

        One that should show fewer of them than neighbours share cannot become one.
        """
        m = self.map
        points = m.observed_points(keyframe).copy()
        most = self.config.neighbours * _AROUND
        around = local_keyframes(m.arrays, m.n_keyframes, points, MIN_SHARED, most)
        around = around[around != keyframe]
        missing = unobserved_in(m.arrays, m.view, around, points)
        order = np.argsort(-missing, kind="stable")[: self.config.neighbours]
        return [int(k) for k in around[order[missing[order] >= MIN_SHARED]]]

    def _density(self, keyframe: int) -> np.ndarray:
        """(levels,) keypoints per px² of every octave of a keyframe."""
        m, view = self.map, self.map.view
        image = (view.x_max - view.x_min) * (view.y_max - view.y_min)
        return density_of(m.arrays.kp_octave[m.keypoints(keyframe)], len(view.scale), image)


def map_rules(map_: Map, config: "LocalMappingConfig") -> MapRules:
    """The rules that settings name, for a map."""
    by_name = {"own": OwnMapRules, "published": PublishedMapRules}
    return by_name[config.rules](map_, config)
