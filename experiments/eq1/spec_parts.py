"""The parts of an experiment's spec: bases, degradations, threads; and what mixes populations in a cell.

A cell that mixes two of which one breaks often and the other seldom contradicts Eq. 1 by itself.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from dslab.experiments.eq1.units import ThreadChoice
from dslab.scenarios.distributions import is_distribution
from dslab.scenarios.errors import InputError
from dslab.scenarios.families import load_family
from dslab.scenarios.motions import Trajectory
from dslab.scenarios.segments import SEGMENT_KINDS, ImageSegment
from dslab.scenarios.strict import Strict
from dslab.scenarios.yaml_file import Location

_DEFAULT_MOTION = Trajectory().kind
Node = dict[str, Any]
"""A part of a scenario, any node of which may be a distribution."""


def severity_fields(kind: str) -> list[str]:
    """Fields of a kind of segment that say how bad it is; empty for an unknown kind."""
    model = SEGMENT_KINDS.get(kind)
    times = ("kind", "start_s", "duration_s", "ramp_s", "fall_s")
    return [name for name in model.model_fields if name not in times] if model else []


def _as_choice(data: Any) -> Any:
    return {"kind": data} if isinstance(data, str) else data


def _number_or_drawn(data: Any) -> Any:
    options = data.get("choice") if is_distribution(data) else None
    for option in options if isinstance(options, list) else ():
        _number_or_drawn(option)
    number = isinstance(data, int | float) and not isinstance(data, bool) and 0 <= data < math.inf
    if not (number or is_distribution(data)):
        raise ValueError(f"{data!r} is not valid, give a number from 0 or a distribution")
    return data


def _span_or_rest(data: Any) -> Any:
    return None if data is None else _number_or_drawn(data)


Span = Annotated[Any, BeforeValidator(_number_or_drawn)]
SpanOrRest = Annotated[Any, BeforeValidator(_span_or_rest)]
Threads = tuple[Annotated[ThreadChoice, BeforeValidator(_as_choice)], ...]


class Base(Strict):
    """World, trajectory and camera of units, one kind of world and of motion; any other node may be drawn.

    The world is drawn from a unit's world seed, path and camera from its sequence's.
    """

    family: str | None = Field(None, description="scenario family or member whose fields these are laid over")
    each_member: bool = Field(False, description="one base per member of the family, named base-member")
    world: Node = Field(default_factory=dict)
    trajectory: Node = Field(default_factory=dict)
    camera: Node = Field(default_factory=dict)

    @property
    def own(self) -> dict[str, Any]:
        """The fields given in the base itself."""
        return {name: part for name in ("world", "trajectory", "camera") if (part := getattr(self, name))}

    @model_validator(mode="after")
    def _check_world(self) -> "Base":
        if self.family is None and not self.world:
            raise ValueError("it has no world, give world or family")
        members = ()
        if self.family is not None:
            try:
                members = load_family(self.family).members
            except InputError:
                raise ValueError(f"there is no family {self.family}, see `dslab scenarios list`") from None
        if self.each_member and not members:
            raise ValueError("each_member needs a family with members, give one or leave it out")
        return self


Doses = Annotated[tuple[float, ...], Field(min_length=1, max_length=20)]


class Degradation(Strict):
    """One kind of degradation in several doses, each a cell."""

    kind: str = Field(description="kind of the segment")
    dose: str = Field(description="field of the segment that the doses set")
    doses: Doses | dict[str, Doses] = Field(
        description="of every base, or by their names of those in which it acts"
    )
    severities: Doses | dict[str, Doses] | None = Field(
        None, description="severities that stand for the doses in the results; the doses by default"
    )
    creeping: bool = Field(False, description="the dose rises over the whole duration; of kinds with ramp_s")
    begins_s: Span = Field(0.0, description="start after the onset; a number or a distribution")
    acts_s: SpanOrRest = Field(None, description="duration, likewise; by default to the end of L")
    fields: Node = Field(
        default_factory=dict, description="further fields of the segment, distributions allowed"
    )

    @property
    def label(self) -> str:
        """Its name in cells and records: creeping stress is a kind of its own."""
        return f"{self.kind}-creeping" if self.creeping else self.kind

    def doses_of(self, base: str) -> tuple[float, ...]:
        """The doses of a base; none if it does not act there."""
        return _of_base(self.doses, base)

    def severities_of(self, base: str) -> tuple[float, ...]:
        """The severities of a base that stand for its doses."""
        return self.doses_of(base) if self.severities is None else _of_base(self.severities, base)

    def base_fault(self, bases: Collection[str]) -> str:
        """What is wrong with its doses for these bases; empty if nothing is."""
        for name, given in (("doses", self.doses), ("severities", self.severities)):
            unknown = sorted(set(given) - set(bases)) if isinstance(given, dict) else []
            if unknown:
                return f"{name}: {unknown[0]} is no base, use {' or '.join(bases)}"
        for base in bases:
            doses, severities = self.doses_of(base), self.severities_of(base)
            if len(severities) != len(doses):
                return f"{len(severities)} severities for {len(doses)} doses, give one per dose"
            if len(set(severities)) < len(severities):
                return "two doses have the same severity, make them differ"
        return ""

    @model_validator(mode="after")
    def _check_fields(self) -> "Degradation":
        model = SEGMENT_KINDS.get(self.kind)
        if self.creeping and model is not None and not issubclass(model, ImageSegment):
            raise ValueError(f"creeping: {self.kind} has no ramp_s, use a kind that acts on images")
        own = ("ramp_s", "fall_s") if self.creeping else ()
        severities = severity_fields(self.kind)
        if severities and self.dose not in severities:
            known = " or ".join(severities)
            raise ValueError(f"dose: a segment of kind {self.kind} has no {self.dose}, use {known}")
        taken = [name for name in ("kind", "start_s", "duration_s", *own, self.dose) if name in self.fields]
        if taken:
            raise ValueError(f"fields repeats {taken[0]}, leave it out there")
        return self


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


def _of_base(given: tuple[float, ...] | dict[str, tuple[float, ...]], base: str) -> tuple[float, ...]:
    return given.get(base, ()) if isinstance(given, dict) else given


def _kinds(part: Any, default: str | None) -> set[Any]:
    """The kinds that a world or trajectory as written may have."""
    if is_distribution(part):
        return {kind for option in _options(part) for kind in _kinds(option, default)}
    return set(_options(part.get("kind", default))) if isinstance(part, Mapping) else {default}


def _options(value: Any) -> list[Any]:
    """What a value as written may become: the options of a choice, else itself."""
    chosen = value.get("choice") if is_distribution(value) else None
    return chosen if isinstance(chosen, list) else [value]
