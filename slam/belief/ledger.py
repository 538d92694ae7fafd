"""What the views of one supposed place have said: every point speaks once for every part of the path."""

from collections.abc import Iterable
from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np

from dslab.slam.belief.model import SHARES, Evidence, Parameters, Sight, by_share, evidence_of, over_views

_PART = 0.15
"""Median depths from where a part began: beyond, other sides of the same surfaces are seen. Of 189 right and
169 false places 72 and 1 pass odds of 19 : 1; at .4 it is 49 and 0, without parts 79 and 6."""


@dataclass
class _Part:
    """Views from about one position: by point, the sum of what they say, and their number."""

    centre: np.ndarray
    row: dict[int, int] = field(default_factory=dict)
    sums: np.ndarray = field(default_factory=lambda: np.zeros((SHARES, 0)))
    counts: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def add(self, points: np.ndarray, says: np.ndarray) -> None:
        """Take in what a view says (G, n) by points (n,)."""
        rows = np.array([self.row.setdefault(int(p), len(self.row)) for p in points])
        more = len(self.row) - len(self.counts)
        self.sums = np.pad(self.sums, ((0, 0), (0, more)))
        self.counts = np.pad(self.counts, (0, more))
        self.sums[:, rows] += says
        self.counts[rows] += 1


class Ledger:
    """Evidence of the views that were asked for one place.

    What a view says for each share γ, v integrated, is divided among its points: that of a surface equally
    among those of the surface. A point counts with the mean over the views from about one position. So one
    view says what the model says of it, twice the same view no more, and a first view that was covered does
    not count for ever; a surface that is there in every other view is not there.

    Args:
        parameters: of the model.
        sights: views to begin with.

    Attributes:
        views: number of those that have spoken.
    """

    def __init__(self, parameters: Parameters, sights: Iterable[Sight] = ()) -> None:
        self._parameters = parameters
        self._parts: list[_Part] = []
        self.views = 0
        for sight in sights:
            self.add(sight)

    def add(self, sight: Sight) -> Evidence:
        """Take in a further view; what it says alone: nothing, if it should show nothing."""
        if not len(sight.point):
            return Evidence(0.0, 0.0)
        self.views += 1
        of_surface, group = by_share(sight, self._parameters)
        alone, weights, cost = over_views(of_surface.sum(axis=2))
        of_surface = np.einsum("sv,svg->sg", weights, of_surface) / np.bincount(group)
        self._part(sight.centre).add(sight.point, of_surface[:, group] - cost[:, None] / len(group))
        return evidence_of(alone[None], self._parameters)

    def copy(self) -> "Ledger":
        """An independent copy."""
        return deepcopy(self)

    def by_part(self) -> np.ndarray:
        """(K, G) logarithms of L(γ) by the views of each part, as of the model."""
        if not self._parts:
            return np.zeros((1, SHARES))
        return np.array([(part.sums / part.counts).sum(axis=1) for part in self._parts])

    def evidence(self) -> Evidence:
        """Of all views together."""
        return evidence_of(self.by_part(), self._parameters)

    def _part(self, centre: np.ndarray) -> _Part:
        """That of a position, the nearest if several are near."""
        away = [float(np.linalg.norm(part.centre - centre)) for part in self._parts]
        if not away or min(away) > _PART:
            self._parts.append(_Part(np.asarray(centre, np.float64)))
            return self._parts[-1]
        return self._parts[int(np.argmin(away))]
