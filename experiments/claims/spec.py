"""The spec of a claim's experiment: what the paper says, and the worlds in which it is tested.

Its conditions are drawn by the code of Eq. 1's experiments: a base is one kind of world and of motion, a
degradation a stress in several doses. World ``w`` is the same in every condition.
"""

from functools import cached_property
from typing import Annotated, Any, ClassVar

import yaml
from pydantic import AfterValidator, Field, model_validator

from dslab.experiments.eq1.spec_parts import Base, Degradation
from dslab.experiments.eq1.unit_drawing import Cell, draw_scenario, written_base
from dslab.experiments.eq1.units import content_hash
from dslab.scenarios.errors import InputError
from dslab.scenarios.faults import guess
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.spec import Scenario
from dslab.scenarios.strict import Strict
from dslab.slam.factory import DIRECT, SYSTEMS

Unit = dict[str, Any]
"""Plain JSON data that names its world; what of it is a number or text is in its rows too."""
Row = dict[str, Any]
"""A flat row of plain numbers, text and None."""
ENOUGH_WORLDS = 30
"""With fewer worlds an experiment is a look."""


def _with_points(systems: tuple[str, ...]) -> tuple[str, ...]:
    known = [name for name in SYSTEMS if name not in DIRECT]
    for name in systems:
        if name not in known:
            raise ValueError(f"{name} is no system of ours with points in a map, use {' or '.join(known)}")
    return systems


SystemsWithPoints = Annotated[tuple[str, ...], AfterValidator(_with_points)]
"""Systems of ours that have points in a map, as a field of a spec."""
SYSTEMS_WITH_POINTS = Field(("base",), min_length=1, description="of ours, with points in a map")
MEASURED = "measured"
"""Context in which the spec of a folder is validated: its rows are there, whatever the code at hand knows."""
_NAME = r"^[a-z0-9][a-z0-9_-]*$"
_SEED_END = 2**53  # exact in JSON and in every table


class ClaimSpec(Strict):
    """What every kind of experiment on a claim has; a kind adds its own fields and the literal of its name.

    Attributes:
        repeats: no unit is repeated with other noise.
    """

    repeats: ClassVar[int] = 1

    kind: Any  # the literal of its name in each kind
    name: str = Field(pattern=_NAME, max_length=40)
    description: str = ""
    claim: str = Field(min_length=1, description="the paper's sentence")
    section: str = Field(min_length=1, description="where the paper says it, as V-C")
    root_seed: int = Field(ge=0, lt=_SEED_END)
    worlds: int = Field(ge=1, le=100_000, description="of every condition: the sample")
    unit_s: float | None = Field(None, gt=0, description="worker time of a unit, as measured")
    bases: dict[Annotated[str, Field(pattern=_NAME)], Base] = Field(min_length=1)
    degradations: tuple[Degradation, ...] = ()
    sham: bool = Field(True, description="a condition without a degradation for every base")
    lead_in_s: float = Field(0.0, ge=0, le=600)
    exposed_s: float = Field(10.0, gt=0, le=600, description="in which the degradation acts")
    tail_s: float = Field(0.0, ge=0, le=600)

    @model_validator(mode="after")
    def _check_conditions(self) -> "ClaimSpec":
        for degradation in self.degradations:
            if fault := degradation.base_fault(self.bases):
                raise ValueError(f"degradations, {degradation.label}: {fault}")
        if not self.sham and not any(d.doses_of(base) for d in self.degradations for base in self.bases):
            raise ValueError("there is no condition, give degradations or sham: true")
        return self

    @cached_property
    def cells(self) -> dict[str, Cell]:
        """Every condition by name: its base, then kind and number of the dose of its stress if it has one."""
        found = {}
        for base, of in self.bases.items():
            written = written_base(of.family, None, of.own)
            doses = [
                (f"{base}/{degradation.label}/{dose + 1}", number, dose)
                for number, degradation in enumerate(self.degradations)
                for dose in range(len(degradation.doses_of(base)))
            ]
            for name, number, dose in [*([(base, None, None)] if self.sham else []), *doses]:
                found[name] = Cell(name, base, written, number, dose, None)
        return found

    def scenario(self, condition: str, world: int, sequence: int = 0) -> Scenario:
        """Draw the scenario of a condition: a pure function of the spec.

        Args:
            condition: one of ``cells``.
            world: number of the world, the same place in every condition of a base.
            sequence: number of the path in that world.

        Raises:
            InputError: there is no such condition, or the drawn scenario is not valid.
        """
        return self.draw(condition, world, sequence, lambda at: f"{self.name}: {'.'.join(map(str, at))}")

    def draw(self, condition: str, world: int, sequence: int, where: Any) -> Scenario:
        """As :meth:`scenario`; ``where`` describes a :data:`Location` in the spec."""
        if condition not in self.cells:
            likely = guess(condition, list(self.cells))
            remedy = f"use {likely}one of {', '.join(self.cells)}"
            raise InputError(f"{self.name}: {condition}", "no such condition", remedy)

        def seed(*names: str | int) -> int:
            return int(rng_for(self.root_seed, "experiment", *names).integers(_SEED_END))

        seeds = {
            "world_seed": seed("world", world),
            "sequence_seed": seed("sequence", world, sequence),
            "repeat_seed": seed("repeat", world, sequence, 0),
        }
        return draw_scenario(self, self.cells[condition], world, seeds, where)

    def seed(self, *names: str | int) -> int:
        """A seed of this name, below 2^31, for what a unit draws itself."""
        return int(rng_for(self.root_seed, "claim", *names).integers(2**31))

    @property
    def is_look(self) -> bool:
        """True if there are too few worlds for more than a look."""
        return self.worlds < ENOUGH_WORLDS

    @property
    def content_hash(self) -> str:
        """Hash of all that determines the rows, without the number of worlds and what is only told."""
        told = {"description", "claim", "section", "worlds", "unit_s"}
        data = self.model_dump(mode="json", exclude=told)
        return content_hash({**data, "written": {name: cell.written for name, cell in self.cells.items()}})

    def as_yaml(self) -> str:
        """The spec with all defaults, as YAML that ``load_claim`` reads."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
