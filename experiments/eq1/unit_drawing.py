"""Draw the scenario of a unit from its cell and seeds."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from pydantic import ValidationError

from dslab.experiments.eq1.spec_parts import Base, Degradation
from dslab.scenarios.drawing import Draw
from dslab.scenarios.families import load_family, merged
from dslab.scenarios.faults import all_faults
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.spec import Scenario
from dslab.scenarios.yaml_file import Location

PARTS = ("world", "trajectory", "camera")


@dataclass(frozen=True)
class Cell:
    """One cell of an experiment.

    Attributes:
        image: its name without the system, which does not affect the images.
        base: name of its base in the spec.
        written: world, trajectory and camera as written, one for each variant that the world seed chooses
            from: the members of a family.
        degradation, dose: indices of kind and dose in the spec; None for a sham, which has neither.
        system: the system that is run.
    """

    image: str
    base: str
    written: tuple[dict[str, Any], ...]
    degradation: int | None
    dose: int | None
    system: Any


class Drawn(Protocol):
    """What scenarios are drawn from: the spec of an experiment.

    Attributes:
        bases, degradations, cells: what its conditions are made of, and they by name.
        lead_in_s, exposed_s, tail_s: parts of a sequence.
        repeats: units of a sequence, with noise of their own if there are several.
    """

    @property
    def bases(self) -> Mapping[str, Base]: ...
    @property
    def degradations(self) -> tuple[Degradation, ...]: ...
    @property
    def cells(self) -> Mapping[str, Cell]: ...
    @property
    def lead_in_s(self) -> float: ...
    @property
    def exposed_s(self) -> float: ...
    @property
    def tail_s(self) -> float: ...
    @property
    def repeats(self) -> int: ...


def written_base(family: str | None, member: str | None, own: dict[str, Any]) -> tuple[dict[str, Any], ...]:
    """World, trajectory and camera of a base: its own fields over those of its family.

    Args:
        family: name of a family; None for none.
        member: the only member to use; None for all of them.
        own: fields of the base itself.

    Raises:
        InputError: the family or member does not exist.
    """
    if family is None:
        return ({**{part: {} for part in PARTS}, **own},)
    found = load_family(family)
    chosen = (member,) if member is not None else found.members
    families = [found.member(one) for one in chosen] or [found]
    parts = [{part: f.written.get(part, {}) for part in PARTS} for f in families]
    return tuple(merged(part, own) for part in parts)


def draw_scenario(
    spec: Drawn, cell: Cell, index: int, seeds: dict[str, int], where: Callable[[Location], str]
) -> Scenario:
    """Draw the scenario of a unit.

    The world seed determines the world: its variant, its parameters and itself. The sequence seed determines
    path and camera, in streams independent of kind and dose: they are the same in every cell. Replicates
    differ in noise alone.

    Args:
        spec: of the experiment.
        cell: one of its cells.
        index: of the unit in the cell.
        seeds: ``world_seed``, ``sequence_seed`` and ``repeat_seed``, see
            :class:`experiments.eq1.units.UnitSpec`.
        where: describes a location in the spec, for error messages.

    Raises:
        InputError: the drawn scenario is not valid.
    """
    world_seed, sequence_seed = seeds["world_seed"], seeds["sequence_seed"]
    variant = rng_for(world_seed, "experiment", "variant").random()
    written = cell.written[int(variant * len(cell.written))]
    of_world, of_rest = Draw(world_seed), Draw(sequence_seed)
    data: dict[str, Any] = {
        "name": f"{cell.image}/{index}",
        "duration_s": spec.lead_in_s + spec.exposed_s + spec.tail_s,
        "world": of_world(written["world"], ("world",), ("world",)),
        "trajectory": of_rest(written["trajectory"], ("trajectory",), ("trajectory",)),
        "camera": of_rest(written["camera"], ("camera",), ("camera",)),
        "segments": _segments(spec, cell, of_rest),
        "seed": sequence_seed,
        "world_seed": world_seed,
        "noise_seed": seeds["repeat_seed"] if spec.repeats > 1 else None,
    }
    for draw in (of_world, of_rest):
        draw.round_whole_numbers(data)
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        of_sample = f", in cell {cell.image} as drawn for unit {index}"
        raise all_faults(error, lambda at: where(_in_spec(spec, cell, at)), of_sample) from None


def _segments(spec: Drawn, cell: Cell, draw: Draw) -> list[dict[str, Any]]:
    """The degradation as a segment; none in a sham."""
    if cell.degradation is None or cell.dose is None:
        return []
    degradation = spec.degradations[cell.degradation]

    def drawn(value: Any, *name: str) -> Any:
        return draw(value, ("segments", 0, *name), ("segment", *name))

    begins_s = drawn(degradation.begins_s, "begins_s")
    left_s = spec.exposed_s - begins_s
    acts_s = left_s if degradation.acts_s is None else min(drawn(degradation.acts_s, "acts_s"), left_s)
    segment = {
        "kind": degradation.kind,
        "start_s": spec.lead_in_s + begins_s,
        "duration_s": acts_s,
        **{name: drawn(value, name) for name, value in degradation.fields.items()},
        degradation.dose: degradation.doses_of(cell.base)[cell.dose],
    }
    return [segment | ({"ramp_s": acts_s, "fall_s": 0.0} if degradation.creeping else {})]


def _in_spec(spec: Drawn, cell: Cell, at: Location) -> Location:
    """Location in the spec of a field of the scenario."""
    if at[:1] != ("segments",) or cell.degradation is None:
        return ("bases", cell.base, *at)
    inside, place = at[2:], ("degradations", cell.degradation)
    name = inside[0] if inside else "kind"
    degradation = spec.degradations[cell.degradation]
    if name == degradation.dose and cell.dose is not None:
        of_base = (cell.base,) if isinstance(degradation.doses, dict) else ()
        return (*place, "doses", *of_base, cell.dose)
    if name in ("start_s", "duration_s"):
        return (*place, "begins_s" if name == "start_s" else "acts_s")
    return (*place, name) if name == "kind" else (*place, "fields", *inside)
