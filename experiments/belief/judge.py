"""Whether beliefs are as often right as they say: slope, loss and recall, beside the rules that decide."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from dslab.experiments.belief.logs import Asked
from dslab.slam.belief.ledger import Ledger
from dslab.slam.belief.model import Parameters, prior


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
    """(n,) log-odds of each hypothesis, by the motion to it and by all its views."""
    return np.array(
        [
            prior(one.unseen, parameters, one.kind) + Ledger(parameters, one.sights).evidence().ratio
            for one in asked
        ]
    )


def shares(asked: Sequence[Asked]) -> np.ndarray:
    """(n,) share of the views of each hypothesis that the rules find no fault with."""
    return np.array([np.mean([not fault for fault in one.faults]) for one in asked])


def as_odds(score: np.ndarray, false: np.ndarray) -> tuple[float, float]:
    """Logistic of a score that fits best: offset and factor."""

    def loss(x: np.ndarray) -> float:
        return float(np.logaddexp(0, np.where(false, 1, -1) * (x[0] + x[1] * score)).mean())

    found = minimize(loss, np.array([0.0, 1.0]), method="Nelder-Mead")
    return float(found.x[0]), float(found.x[1])


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
