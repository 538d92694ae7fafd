"""The parts of an experiment's spec: bases, degradations, threads, the stopping rule."""

import math
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from experiments.eq1.units import ThreadChoice
from scenarios.distributions import is_distribution
from scenarios.errors import InputError
from scenarios.families import load_family
from scenarios.segments import SEGMENT_KINDS
from scenarios.strict import Strict

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
    """World, trajectory and camera of units; any node may be a distribution.

    The world is drawn from a unit's world seed, all else from its nuisance seed.
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


class Degradation(Strict):
    """One kind of degradation in several doses, each a cell."""

    kind: str = Field(description="kind of the segment")
    dose: str = Field(description="field of the segment that the doses set")
    doses: tuple[float, ...] = Field(min_length=1, max_length=20)
    severities: tuple[float, ...] | None = Field(
        None, description="severities that stand for the doses in the results; the doses by default"
    )
    begins_s: Span = Field(0.0, description="start after the onset; a number or a distribution")
    acts_s: SpanOrRest = Field(None, description="duration, likewise; by default to the end of L")
    fields: Node = Field(
        default_factory=dict, description="further fields of the segment, distributions allowed"
    )

    @model_validator(mode="after")
    def _check_distinct(self) -> "Degradation":
        if self.severities is not None and len(self.severities) != len(self.doses):
            raise ValueError(
                f"{len(self.severities)} severities for {len(self.doses)} doses, give one per dose"
            )
        numbers = self.severities or self.doses
        if len(set(numbers)) < len(numbers):
            raise ValueError("two doses have the same severity, make them differ")
        severities = severity_fields(self.kind)
        if severities and self.dose not in severities:
            known = " or ".join(severities)
            raise ValueError(f"dose: a segment of kind {self.kind} has no {self.dose}, use {known}")
        taken = [name for name in ("kind", "start_s", "duration_s", self.dose) if name in self.fields]
        if taken:
            raise ValueError(f"fields repeats {taken[0]}, leave it out there")
        return self


class Stopping(Strict):
    """A cell stops when the confidence sequence of one quantity is narrow enough, or at its budget."""

    quantity: str = Field("p0", pattern=r"^(p0|pr[1-9]|d[1-9])$", description="p0, pr1, d1 and so on")
    half_width: float = Field(gt=0, lt=0.5)
    confidence: float = Field(0.95, gt=0.5, lt=1)
    min_units: int = Field(20, ge=1, description="valid units before it may stop")
