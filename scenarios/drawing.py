"""Drawing of all distributions of a family."""

from functools import reduce
from typing import Any

from dslab.scenarios.distributions import Choice, is_distribution, parse_distribution
from dslab.scenarios.faults import field_annotation
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.yaml_file import Location, field_path


class Draw:
    """One draw of all distributions, with the place in the file of each part."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._written: dict[Location, Location] = {}
        self._numbers: list[Location] = []

    def __call__(self, node: Any, at: Location, written: Location) -> Any:
        """Draw a node; the outcome shares no mapping or list with it.

        Args:
            node: as written.
            at: its location in the scenario.
            written: its location in the family.
        """
        self._written[at] = written
        if is_distribution(node):
            found = parse_distribution(node)
            drawn = found.draw(rng_for(self._seed, "family", field_path(written)))
            if isinstance(found, Choice):
                return self(found.options[int(drawn)], at, (*written, "choice", int(drawn)))
            self._numbers.append(at)
            return drawn
        if isinstance(node, dict):
            return {key: self(value, (*at, key), (*written, key)) for key, value in node.items()}
        if isinstance(node, list):
            return [self(value, (*at, k), (*written, k)) for k, value in enumerate(node)]
        return node

    def round_whole_numbers(self, data: dict[str, Any]) -> None:
        """Round drawn numbers of whole-numbered fields."""
        for at in self._numbers:
            if field_annotation(at, data) is int:
                holder: Any = reduce(lambda part, key: part[key], at[:-1], data)
                holder[at[-1]] = round(holder[at[-1]])

    def written_at(self, at: Location) -> Location:
        """Place in the file of a part of the outcome, which may be missing there."""
        known = next(n for n in range(len(at), -1, -1) if at[:n] in self._written or n == 0)
        return (*self._written.get(at[:known], ()), *at[known:])
