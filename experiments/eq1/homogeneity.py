"""Check that a cell is one population: one kind of world, one kind of motion, one kind of degradation.

A cell that mixes two of which one breaks often and the other seldom contradicts Eq. 1 by itself.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from dslab.experiments.eq1.spec_parts import Base, Degradation
from dslab.scenarios.distributions import is_distribution
from dslab.scenarios.errors import InputError
from dslab.scenarios.motions import Trajectory
from dslab.scenarios.yaml_file import Location

_DEFAULT_MOTION = Trajectory().kind


def base_mixtures(
    name: str, base: Base, variants: Sequence[Mapping[str, Any]], where: Callable[[Location], str]
) -> Iterator[InputError]:
    """What in a base mixes kinds of world or of motion in a cell.

    Args:
        name: of the base.
        base: as in the spec.
        variants: world, trajectory and camera as written, of which one is drawn for a world.
        where: describes a location in the spec.
    """
    remedy = "give each a base of its own"
    if base.family is not None and not base.world:
        remedy = "name one member, or set each_member: true"
    for part, what, default in (("world", "worlds", None), ("trajectory", "motions", _DEFAULT_MOTION)):
        kinds = {kind for variant in variants for kind in _kinds(variant.get(part, {}), default)}
        if len(kinds) > 1:
            at = ("bases", name, part if part in base.own else "family")
            mixed = " and ".join(sorted(map(str, kinds)))
            yield InputError(where(at), f"mixes {what} of kinds {mixed} in one cell", remedy)


def stress_mixtures(
    degradations: Sequence[Degradation], where: Callable[[Location], str]
) -> Iterator[InputError]:
    """What mixes kinds of one degradation, such as the axis of a rotation, in a cell."""
    for number, degradation in enumerate(degradations):
        for field, value in degradation.fields.items():
            options = _options(value)
            if len({option for option in options if isinstance(option, str)}) > 1:
                mixed = " and ".join(map(str, options))
                at = ("degradations", number, "fields", field)
                remedy = "give each an experiment of its own, or keep one"
                yield InputError(where(at), f"mixes {mixed} in one cell", remedy)


def _kinds(part: Any, default: str | None) -> set[Any]:
    """The kinds that a world or trajectory as written may have."""
    if is_distribution(part):
        return {kind for option in _options(part) for kind in _kinds(option, default)}
    return set(_options(part.get("kind", default))) if isinstance(part, Mapping) else {default}


def _options(value: Any) -> list[Any]:
    """What a value as written may become: the options of a choice, else itself."""
    chosen = value.get("choice") if is_distribution(value) else None
    return chosen if isinstance(chosen, list) else [value]
