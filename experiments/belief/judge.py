"""Whether beliefs are as often right as they say: slope, loss and recall."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from dslab.experiments.belief.logs import Asked
from dslab.slam.belief.ledger import Ledger
from dslab.slam.belief.model import Parameters, of_torn, prior


@dataclass(frozen=True)
class Judged:
    """Beliefs of hypotheses whose truth is known.

    Attributes:
        hypotheses, false: number of them, and of those that are false.
        slope: factor on the log-odds at which they fit best; 1 if they are calibrated.
        loss: mean of minus the logarithm of what was believed of what is so.
        recall: share of the right ones that are believed more than any false one.
    """

    hypotheses: int
    false: int
    slope: float
    loss: float
    recall: float


def beliefs(asked: Sequence[Asked], parameters: Parameters) -> np.ndarray:
    """(n,) log-odds of each hypothesis: the motion to it, all its views, and what a correction tears."""
    return np.array(
        [
            prior(one.unseen, parameters, one.kind)
            + Ledger(parameters, one.sights).evidence().ratio
            + (of_torn(one.torn, parameters) if np.isfinite(one.torn) else 0.0)
            for one in asked
        ]
    )


def judge(odds: np.ndarray, false: np.ndarray) -> Judged:
    """Judge log-odds (n,) of hypotheses, of which some (n,) bool are false."""
    sign = np.where(false, 1.0, -1.0)
    found = minimize_scalar(
        lambda factor: np.logaddexp(0, sign * factor * odds).mean(), bounds=(0.0, 20.0), method="bounded"
    )
    worst = odds[false].max(initial=-np.inf)
    return Judged(
        len(odds), int(false.sum()), float(found.x), float(np.logaddexp(0, sign * odds).mean()),
        float((odds[~false] > worst).mean()) if (~false).any() else np.nan,
    )  # fmt: skip
