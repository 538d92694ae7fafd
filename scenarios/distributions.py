"""Notation of distributions, which may replace any node of a scenario.

``{uniform: [low, high]}`` and ``{log_uniform: [low, high]}`` replace a number, ``{choice: [a, b, c]}``
anything, also whole mappings and lists, with ``weights: [...]`` beside it if the options are not equally
likely.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np

KEYS = ("uniform", "log_uniform", "choice")
"""The keys that make a mapping a distribution; no field of a scenario has such a name."""


class NotationError(Exception):
    """A mapping with a distribution's key that is not a valid distribution.

    Args:
        problem: the fault.
        remedy: the correct notation.
    """

    def __init__(self, problem: str, remedy: str) -> None:
        self.problem, self.remedy = problem, remedy
        super().__init__(f"{problem}; {remedy}")


@dataclass(frozen=True)
class Uniform:
    """A number from ``low`` to ``high``, uniformly distributed."""

    low: float
    high: float

    def draw(self, rng: np.random.Generator) -> float:
        """A number."""
        return min(self.low + (self.high - self.low) * rng.random(), self.high)


@dataclass(frozen=True)
class LogUniform:
    """A number from ``low`` to ``high``, both above 0, uniform in its logarithm."""

    low: float
    high: float

    def draw(self, rng: np.random.Generator) -> float:
        """A number."""
        drawn = self.low * math.exp(math.log(self.high / self.low) * rng.random())
        return min(max(drawn, self.low), self.high)


@dataclass(frozen=True)
class Choice:
    """One of several nodes, which may hold distributions in turn.

    Attributes:
        options: the nodes, as written.
        weights: relative probabilities.
    """

    options: tuple[Any, ...]
    weights: tuple[float, ...]

    def draw(self, rng: np.random.Generator) -> int:
        """The index of an option."""
        bounds = list(accumulate(self.weights))
        # An option without weight is never drawn, not even at a bound.
        return bisect_right(bounds, rng.random() * bounds[-1], hi=_last_likely(self.weights))


Distribution = Uniform | LogUniform | Choice


def is_distribution(node: Any) -> bool:
    """Return True if a node has a distribution's key."""
    return isinstance(node, dict) and any(key in node for key in KEYS)


def parse_distribution(node: dict[str, Any]) -> Distribution:
    """Parse the distribution of a node.

    Raises:
        NotationError: the node is not a valid distribution.
    """
    kind = next(key for key in KEYS if key in node)
    beside = [str(key) for key in node if key != kind and not (kind == "choice" and key == "weights")]
    if beside:
        also = " and weights" if kind == "choice" else ""
        raise NotationError(f"{beside[0]} stands beside {kind}", f"leave {kind}{also} alone in its mapping")
    if kind == "choice":
        return _choice(node["choice"], node.get("weights"))
    low, high = _bounds(kind, node[kind])
    if kind == "uniform":
        return Uniform(low, high)
    if low <= 0:
        raise NotationError(f"log_uniform from {low:g} has no logarithm", "start above 0, or use uniform")
    return LogUniform(low, high)


def _bounds(kind: str, given: Any) -> tuple[float, float]:
    if not isinstance(given, list) or len(given) != 2 or not all(map(_is_number, given)):
        raise NotationError(f"{kind} {given!r} has no two numbers", f"write {kind}: [low, high]")
    low, high = map(float, given)
    if low > high:
        raise NotationError(f"{kind} from {low:g} to {high:g} is empty", "give the lower number first")
    return low, high


def _choice(options: Any, weights: Any) -> Choice:
    if not isinstance(options, list) or not options:
        raise NotationError("choice has no options", "write choice: [a, b, c]")
    if weights is None:
        return Choice(tuple(options), (1.0,) * len(options))
    if not isinstance(weights, list) or not all(_is_number(w) and w >= 0 for w in weights):
        raise NotationError(f"weights {weights!r} are no list of numbers", "give a number from 0 per option")
    if len(weights) != len(options):
        raise NotationError(
            f"{len(weights)} weights for {len(options)} options", "give one weight per option"
        )
    if not any(weights):
        raise NotationError("every weight is 0", "give at least one option a weight above 0")
    return Choice(tuple(options), tuple(map(float, weights)))


def _is_number(value: Any) -> bool:
    # The bound excludes infinities, NaN, and sums of weights that overflow.
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _last_likely(weights: tuple[float, ...]) -> int:
    return max(index for index, weight in enumerate(weights) if weight > 0)
