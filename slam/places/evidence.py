"""Evidence for and against a supposed place: what a view should show there, and what it shows."""

from dataclasses import dataclass

import numpy as np

from dslab.slam.core.frame import FrameFeatures
from dslab.slam.core.geometry import ViewGeometry
from dslab.slam.core.settings import setting, settings
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import sim3_decompose
from dslab.slam.places._evidence_kernels import look_for

_COLUMNS = 8  # of the grid on which found and missing points are counted
_CHANCE = 0.06  # to find by chance a point of another place
_LEAST_RATE = 0.35  # at which what is expected at a right place is found, from wherever it is seen
_MOST_CERTAIN = 0.95  # chance to find a point of this place, of which no more is believed
VIEW_IS_UNKNOWN = "view_is_unknown"
"""The fault of a view that shows far more than it should: it is not known what it should show."""

_TELLING = 2.0  # log-likelihood ratio from which a cell speaks for or against


@dataclass(frozen=True)
class Support:
    """What one view says of its supposed place.

    Attributes:
        expected: number of points that the view should show, each counted by the share of the frames in
            which it was found so far.
        found: number of those that it shows.
        extent: share of the image covered by the cells in which the found points speak for the place.
        supported: share of ``expected`` in these cells.
        contradicted: share of ``expected`` in cells in which far fewer points are found than elsewhere.
    """

    expected: float
    found: int
    extent: float
    supported: float
    contradicted: float

    @property
    def share(self) -> float:
        """Found over expected points; 0 if none is expected."""
        return self.found / self.expected if self.expected > 0 else 0.0


@settings
class EvidenceBar:
    """What one view must show to speak for its supposed place."""

    min_share: float = setting(0.35, "least share of the expected points that are found")
    max_contradicted: float = setting(0.2, "largest share of expected points where they are missing", le=1)
    min_extent: float = setting(0.16, "least share of the image in which found points speak for it", le=1)
    max_share: float = setting(
        1e6, "largest share found: with more, no keyframe has seen the place from near"
    )

    def fault(self, seen: Support) -> str:
        """What speaks against the place.

        Args:
            seen: what the view shows.

        Returns:
            ``expected_points_missing``, ``contradicted``, ``too_narrow`` or ``view_is_unknown``; empty if
            nothing does.
        """
        if seen.share < self.min_share:
            return "expected_points_missing"
        if seen.contradicted > self.max_contradicted:
            return "contradicted"
        if seen.extent < self.min_extent:
            return "too_narrow"
        return VIEW_IS_UNKNOWN if seen.share > self.max_share else ""


def support(
    map_: Map,
    points: np.ndarray,
    S_cam_map: np.ndarray,
    features: FrameFeatures,
    radius_px: float,
    near: bool = False,
) -> Support:
    """Count what a view shows of the points of a map, given its supposed place.

    A cell of the image speaks for the place if its found and missing points are more likely each with its own
    chance to be found, times the mean rate of the whole view, than by chance, and against it if less likely,
    both by a likelihood ratio.

    Args:
        map_: the map.
        points: (Q,) int32 rows of its points around the place.
        S_cam_map: (4, 4) supposed similarity from the map to the view's camera.
        features: of the view.
        radius_px: half side of the search window on level 0, px.
        near: whether a point is expected only as far as a keyframe has seen it from near this view. What is
            expected is then found at its place, wherever the camera stands; far from all keyframes it is
            nothing.
    """
    scale, _, _ = sim3_decompose(S_cam_map)
    _, pixels, _, likely, keypoint = look_for(
        map_.arrays, map_.view, np.ascontiguousarray(S_cam_map), scale, np.asarray(points, np.int32),
        features.xy, features.octave, features.descriptors, features.cell_start, 0, radius_px, near,
    )  # fmt: skip
    cell = cells_of(map_.view, pixels)
    is_found = keypoint >= 0
    expected = np.bincount(cell, weights=likely)
    total, found = float(expected.sum()), int(is_found.sum())
    if total <= 0:
        return Support(0.0, 0, 0.0, 0.0, 0.0)
    rate = float(np.clip(found / total, _LEAST_RATE, 1.0))
    here = np.clip(rate * likely, _CHANCE, _MOST_CERTAIN)
    ratio = np.where(is_found, np.log(here / _CHANCE), np.log((1 - here) / (1 - _CHANCE)))
    for_place = np.bincount(cell, weights=ratio)
    speaks = for_place > _TELLING
    supported = float(expected[speaks].sum()) / total
    contradicted = float(expected[for_place < -_TELLING].sum()) / total
    return Support(total, found, _extent(map_.view, np.flatnonzero(speaks)), supported, contradicted)


def cells_of(view: ViewGeometry, pixels: np.ndarray) -> np.ndarray:
    """(n,) cell of each pixel (n, 2) of the view; cells are square, 8 to a row."""
    side = _side_px(view)
    column = np.clip((pixels[:, 0] - view.x_min) / side, 0, _COLUMNS - 1).astype(int)
    row = np.maximum((pixels[:, 1] - view.y_min) / side, 0).astype(int)
    return row * _COLUMNS + column


def _side_px(view: ViewGeometry) -> float:
    return (view.x_max - view.x_min) / _COLUMNS


def _extent(view: ViewGeometry, cells: np.ndarray) -> float:
    """Share of the view that these cells cover; the last row of cells may reach beyond it."""
    side, height = _side_px(view), view.y_max - view.y_min
    rows_px = np.minimum(side, height - cells // _COLUMNS * side)
    return float(rows_px.sum()) / (_COLUMNS * height)
