"""What the views of one supposed place have said: every point speaks once, however many views show it."""

from collections.abc import Iterable

import numpy as np

from dslab.slam.belief.model import SHARES, Evidence, Parameters, Sight, by_share, evidence_of, over_views


class Ledger:
    """Evidence of the views that were asked for one place.

    What a view says for each share γ, v integrated, is divided among its points: that of a surface equally
    among those of the surface. A point counts with the mean over the views that should show it. So one view
    says what the model says of it, twice the same view no more, and a first view that was covered does not
    count for ever; a surface that is there in every other view is not there.

    Args:
        parameters: of the model.
        sights: views to begin with.

    Attributes:
        views: number of those that have spoken.
    """

    def __init__(self, parameters: Parameters, sights: Iterable[Sight] = ()) -> None:
        self._parameters = parameters
        self._sums, self._counts = np.zeros((SHARES, 0)), np.zeros(0)
        self._row: dict[int, int] = {}
        self.views = 0
        for sight in sights:
            self.add(sight)

    def add(self, sight: Sight) -> None:
        """Take in a further view; one that should show nothing says nothing."""
        if not len(sight.point):
            return
        self.views += 1
        of_surface, group = by_share(sight, self._parameters)
        _, weights, cost = over_views(of_surface.sum(axis=2))
        of_surface = np.einsum("sv,svg->sg", weights, of_surface) / np.bincount(group)
        rows = np.array([self._row.setdefault(int(p), len(self._row)) for p in sight.point])
        more = len(self._row) - len(self._counts)
        self._sums = np.pad(self._sums, ((0, 0), (0, more)))
        self._counts = np.pad(self._counts, (0, more))
        self._sums[:, rows] += of_surface[:, group] - cost[:, None] / len(rows)
        self._counts[rows] += 1

    def by_share(self) -> np.ndarray:
        """(G,) logarithms of L(γ) by all views together, as of the model."""
        return np.asarray((self._sums / self._counts).sum(axis=1))

    def evidence(self) -> Evidence:
        """Of all views together."""
        return evidence_of(self.by_share(), self._parameters)
