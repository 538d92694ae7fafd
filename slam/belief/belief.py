"""What is believed of one supposed place."""

from collections.abc import Iterable

import numpy as np
from scipy.special import expit, logsumexp

from dslab.slam.belief.fitted import fitted
from dslab.slam.belief.ledger import Ledger
from dslab.slam.belief.model import Parameters, Sight, Unseen, of_torn, prior

DISBELIEVED = "disbelieved"
"""Of a place that was supposed: rather another."""


class Belief:
    """A supposed place: the motion to it, and what views say of it.

    Args:
        kind: ``relocalization``, ``loop`` or ``join``.
        unseen: the motion.
        before: of the same place, whose views count too.
        parameters: of the model; those that the lab has fitted by default.
    """

    def __init__(
        self,
        kind: str,
        unseen: Unseen,
        before: "Belief | None" = None,
        parameters: Parameters | None = None,
    ) -> None:
        parameters = parameters or fitted()
        self._ledger = Ledger(parameters) if before is None else before._ledger.copy()
        self._parameters = parameters
        self._before = prior(unseen, parameters, kind)
        self._torn: float | None = None if kind == "loop" else 0.0
        self._told = self._ledger.evidence().ratio

    @property
    def log_odds(self) -> float:
        """That the camera is there, and not at a place that nobody has supposed."""
        return self._before + self._told + (self._torn or 0.0)

    def over(self, rivals: Iterable[float]) -> float:
        """Log-odds, given those of other supposed places, of which at most one can be."""
        return self.log_odds - float(logsumexp([0.0, *rivals]))

    def chance(self, rivals: Iterable[float] = ()) -> float:
        """The same as a probability."""
        return float(expit(self.over(rivals)))

    def add(self, sight: Sight) -> float:
        """Take in a further view; the logarithm of its own likelihood here over elsewhere."""
        alone = self._ledger.add(sight).ratio
        self._told = self._ledger.evidence().ratio
        return alone

    def tear(self, share: float) -> None:
        """Take in what share of its map's observations a loop's correction tears, for what was known."""
        self._torn = of_torn(share, self._parameters)

    def is_beyond(self, alpha: float, rivals: Iterable[float] = (), hoping: bool = False) -> bool:
        """Return True if the chance that it is elsewhere is less than ``alpha``, and a view has spoken.

        Args:
            alpha: the chance.
            rivals: log-odds of other supposed places, as of :meth:`over`.
            hoping: of a loop whose map was not asked, whether it could be so if nothing were torn.
        """
        hope = of_torn(0.0, self._parameters) if hoping and self._torn is None else 0.0
        return self._ledger.views > 0 and self.over(rivals) + hope >= np.log((1 - alpha) / alpha)
