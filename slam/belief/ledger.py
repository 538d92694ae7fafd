"""What the views of one supposed place have said: every point speaks once, however many views show it."""

import numpy as np

from dslab.slam.belief.model import (
    Evidence,
    Parameters,
    Sight,
    by_share,
    by_surface,
    evidence_of,
    over_views,
    told,
)


class Ledger:
    """Evidence of the views that were asked for one place.

    A point counts with the mean of its log-ratios over the views that should show it, in the surface in which
    it was first expected: twice the same view says no more than once, and a first view that was covered does
    not count for ever. How much a view shows at all, v of the model, is each view's own. It is held at its
    posterior, for every share γ on its own, which costs its divergence from the prior: once for as many
    points as a view has.

    Args:
        parameters: of the model.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._sums = np.zeros((0, 0, 0))
        self._counts, self._group = np.zeros(0), np.zeros(0, np.int64)
        self._row: dict[int, int] = {}
        self._costs: list[np.ndarray] = []
        self._groups = 0

    @property
    def views(self) -> int:
        """Number of views that have spoken."""
        return len(self._costs)

    def add(self, sight: Sight) -> None:
        """Take in a further view; one that should show nothing says nothing."""
        if not len(sight.point):
            return
        ratios = told(sight, self._parameters)
        _, weights, cost = over_views(by_share(by_surface(ratios, sight.cell), self._parameters))
        self._costs.append(cost)
        told_by_share = np.tensordot(weights, ratios, axes=1)
        if self.views == 1:
            self._sums = np.zeros((*told_by_share.shape[:2], 0))
        rows = self._rows_of(sight.point, sight.cell.astype(np.int64) + self._groups)
        self._groups += int(sight.cell.max()) + 1
        self._sums[:, :, rows] += told_by_share
        self._counts[rows] += 1

    def by_share(self) -> np.ndarray:
        """(G + 1,) logarithms of L(γ) by all views together, as of the model."""
        if not self._costs:
            return by_share(np.zeros((1, 0)), self._parameters)[:, 0]
        of_cell = by_surface(self._sums / self._counts, self._group)[:, None]
        views = len(self._row) / (self._counts.sum() / len(self._costs))
        return by_share(of_cell, self._parameters)[:, 0] - views * np.mean(self._costs, axis=0)

    def evidence(self) -> Evidence:
        """Of all views together."""
        return evidence_of(self.by_share(), self._parameters)

    def _rows_of(self, points: np.ndarray, groups: np.ndarray) -> np.ndarray:
        """Row of each point; new ones are of these surfaces."""
        known = len(self._row)
        rows = np.array([self._row.setdefault(int(p), len(self._row)) for p in points])
        new = rows >= known
        self._sums = np.pad(self._sums, ((0, 0), (0, 0), (0, len(self._row) - known)))
        self._counts = np.pad(self._counts, (0, len(self._row) - known))
        self._group = np.concatenate([self._group, groups[new]])
        return rows
