"""What the views of one supposed place have said: every point speaks once, however many views show it."""

import numpy as np
from scipy.special import logsumexp

from dslab.slam.belief.model import (
    LOG_WEIGHT,
    Evidence,
    Parameters,
    Sight,
    by_surface,
    evidence_of_cells,
    told,
)


class Ledger:
    """Evidence of the views that were asked for one place.

    A point counts with the mean of its log-ratios over the views that should show it, in the surface in which
    it was first expected: twice the same view says no more than once, and a first view that was covered does
    not count for ever. How much a view shows at all, v of the model, is each view's own. It is held at its
    posterior, which costs its divergence from the prior, so that of one view the evidence is exact.

    Args:
        parameters: of the model.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._sums = np.zeros((len(LOG_WEIGHT), 0))
        self._counts, self._group = np.zeros(0), np.zeros(0, np.int64)
        self._row: dict[int, int] = {}
        self._costs: list[float] = []
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
        of_view = by_surface(ratios, sight.cell).sum(axis=1) + LOG_WEIGHT
        log_share = of_view - logsumexp(of_view)
        share = np.exp(log_share)
        self._costs.append(float((share * (log_share - LOG_WEIGHT)).sum()))
        rows = self._rows_of(sight.point, sight.cell.astype(np.int64) + self._groups)
        self._groups += int(sight.cell.max()) + 1
        self._sums[:, rows] += np.tensordot(share, ratios, axes=1)
        self._counts[rows] += 1

    def evidence(self) -> Evidence:
        """Of all views together."""
        if not self._costs:
            return Evidence(0.0, 0.0)
        said = evidence_of_cells(self.of_cell(), self._parameters)
        cost = float(np.mean(self._costs))
        return Evidence(said.here - cost, said.elsewhere - cost)

    def of_cell(self) -> np.ndarray:
        """(1, g) log-ratios of the surfaces, v of every view at its posterior."""
        if not self._costs:
            return np.zeros((1, 0))
        return by_surface((self._sums / self._counts)[None], self._group)

    def _rows_of(self, points: np.ndarray, groups: np.ndarray) -> np.ndarray:
        """Row of each point; new ones are of these surfaces."""
        known = len(self._row)
        rows = np.array([self._row.setdefault(int(p), len(self._row)) for p in points])
        new = rows >= known
        self._sums = np.pad(self._sums, ((0, 0), (0, len(self._row) - known)))
        self._counts = np.pad(self._counts, (0, len(self._row) - known))
        self._group = np.concatenate([self._group, groups[new]])
        return rows
