"""The spec of an experiment: cells, units and seeds as typed and validated data.

A cell is a scenario base with one dose of one degradation, run by one system. Its units have a clean lead-in,
an exposed segment in part of which the degradation acts, and a clean tail. Index ``i`` has the same world and
the same nuisance seed in every cell: two cells differ only in what their names state.
"""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import yaml
from pydantic import Field, ValidationError, model_validator

from experiments.eq1.spec_parts import Base, Degradation, Stopping, Threads
from experiments.eq1.unit_drawing import Cell, draw_scenario, written_base
from experiments.eq1.unit_settings import unit_settings
from experiments.eq1.units import ArmName, ThreadChoice, UnitSpec, content_hash
from scenarios.distributions import NotationError
from scenarios.errors import InputError, collect
from scenarios.families import distributions_in, in_order_of_lines, load_family
from scenarios.faults import all_faults, guess
from scenarios.seeds import rng_for
from scenarios.strict import Grown
from scenarios.yaml_file import Location, YamlFile, read_yaml
from slam.dual.recovery.registry import RECOVERY_KINDS

PRESET_DIR = Path(__file__).parent / "presets"
SPEC_VERSION = 1
SystemName = Literal["dual", "dual+", "paper", "paper+"]
_NAME = r"^[a-z0-9][a-z0-9_-]*$"
_SEED_END = 2**53  # exact in JSON and in every table


class ExperimentSpec(Grown):
    """The spec of an experiment."""

    _unwritten: ClassVar = {"settings": {}}

    spec_version: Literal[1] = SPEC_VERSION
    name: str = Field(pattern=_NAME, max_length=40)
    description: str = ""
    root_seed: int = Field(0, ge=0, lt=_SEED_END)
    bases: dict[Annotated[str, Field(pattern=_NAME)], Base] = Field(min_length=1)
    degradations: tuple[Degradation, ...] = Field(min_length=1)
    systems: tuple[SystemName, ...] = Field(("dual",), min_length=1)
    threads: Threads = Field((ThreadChoice(kind="orb"), ThreadChoice(kind="sift")), min_length=1)
    settings: dict[str, Any] = Field(
        default_factory=dict, description="of the systems, as in a settings file of `dslab run`"
    )
    arms: tuple[ArmName, ...] = Field(
        ("free", "crossing"),
        min_length=1,
        description="free and crossing for Eq. 1; pairs for pose error against baseline in the lead-in",
    )
    lead_in_s: float = Field(5.0, gt=0, le=600)
    exposed_s: float = Field(10.0, gt=0, le=600, description="L, the unit length of Eq. 1")
    tail_s: float = Field(15.0, gt=0, le=600)
    units: int = Field(ge=1, le=1_000_000, description="per cell; with a stopping rule the most")
    units_per_world: int = Field(1, ge=1, description="units that share a world: a cluster")
    stopping: Stopping | None = None

    @model_validator(mode="after")
    def _check_consistency(self) -> "ExperimentSpec":
        for name in ("systems", "arms", "degradations"):
            items = getattr(self, name)
            named = [getattr(item, "kind", item) for item in items]
            twice = next((item for i, item in enumerate(named) if item in named[:i]), None)
            if twice is not None:
                raise ValueError(f"{name} names {twice} twice, keep one of them")
        for thread in self.threads:
            if thread.kind not in RECOVERY_KINDS:
                known = " or ".join(sorted(RECOVERY_KINDS))
                raise ValueError(f"unknown recovery thread {thread.kind!r}, use {known}")
        if any(thread in self.threads[:i] for i, thread in enumerate(self.threads)):
            raise ValueError("two threads are the same, give those of one kind different seeds")
        if self.stopping is not None:
            self._check_stopping(self.stopping)
        return self

    def _check_stopping(self, rule: Stopping) -> None:
        if rule.min_units > self.units:
            raise ValueError(f"stopping.min_units is above units = {self.units}, lower it")
        if rule.quantity[-1] != "0" and int(rule.quantity[-1]) > len(self.threads):
            raise ValueError(f"stopping.quantity {rule.quantity} is of no thread, use p0 or a lower number")
        arm = "crossing" if rule.quantity.startswith("pr") else "free"
        if arm not in self.arms:
            raise ValueError(f"stopping.quantity {rule.quantity} is of the {arm} arm, add it to arms")

    # -- cells and units ---------------------------------------------------------------------------------

    @cached_property
    def cells(self) -> dict[str, Cell]:
        """Every cell by name: base (if several), kind, number of the dose, system (if several)."""
        named = [(name, base, member) for name, base in self.bases.items() for member in _members(base)]
        found = {}
        for name, base, member in named:
            place = name if member is None else f"{name}-{member}"
            written = written_base(base.family, member, base.own)
            for number, degradation in enumerate(self.degradations):
                for dose in range(len(degradation.doses)):
                    image = f"{degradation.kind}/{dose + 1}"
                    image = f"{place}/{image}" if len(named) > 1 else image
                    for system in self.systems:
                        cell = Cell(image, name, written, number, dose, system)
                        found[f"{image}/{system}" if len(self.systems) > 1 else image] = cell
        return found

    def model_copy(self, **options: Any) -> Self:
        """A copy with other fields, whose cells are those of these fields."""
        copy = super().model_copy(**options)
        copy.__dict__.pop("cells", None)
        return copy

    def cell_names(self) -> list[str]:
        """The cells, in order."""
        return list(self.cells)

    def units_of(self, cell: str) -> int:
        """Largest number of units of a cell.

        Raises:
            InputError: the cell is unknown.
        """
        self._cell(cell)
        return self.units

    def seeds(self, index: int) -> tuple[int, int]:
        """World seed and nuisance seed of an index, the same in every cell."""
        number = index // self.units_per_world
        world = rng_for(self.root_seed, "experiment", "world", number).integers(_SEED_END)
        nuisance = rng_for(self.root_seed, "experiment", "nuisance", index).integers(_SEED_END)
        return int(world), int(nuisance)

    def unit(self, cell: str, index: int) -> UnitSpec:
        """Draw one unit, of any index from 0: a pure function of the spec.

        Raises:
            InputError: the cell is unknown, or the drawn scenario is not valid.
        """
        return self._unit(cell, index, lambda at: f"experiment {self.name}: {'.'.join(map(str, at))}")

    def _unit(self, cell: str, index: int, where: Callable[[Location], str]) -> UnitSpec:
        of_cell = self._cell(cell)
        world_seed, nuisance_seed = self.seeds(index)
        degradation = self.degradations[of_cell.degradation]
        return UnitSpec(
            experiment=self.name,
            cell=cell,
            kind=degradation.kind,
            severity=(degradation.severities or degradation.doses)[of_cell.dose],
            index=index,
            world_seed=world_seed,
            nuisance_seed=nuisance_seed,
            scenario=draw_scenario(self, of_cell, index, world_seed, nuisance_seed, where),
            onset_s=self.lead_in_s,
            exposed_s=self.exposed_s,
            threads=self.threads,
            settings=self.settings,
            system=of_cell.system,
            arms=self.arms,
        )

    def _cell(self, name: str) -> Cell:
        if name not in self.cells:
            likely = guess(name, list(self.cells))
            remedy = f"use {likely}one of {', '.join(self.cells)}"
            raise InputError(f"experiment {self.name}: {name}", "no such cell", remedy)
        return self.cells[name]

    @property
    def content_hash(self) -> str:
        """Hash of all that determines units, without their number, stopping rule and description."""
        data = self.model_dump(mode="json", exclude={"description", "units", "stopping"})
        return content_hash({**data, "written": {name: cell.written for name, cell in self.cells.items()}})

    def as_yaml(self) -> str:
        """The spec with all defaults, as YAML that ``load_spec`` reads."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False, allow_unicode=True)


def preset_names() -> list[str]:
    """Names of the experiments in the package."""
    return sorted(path.stem for path in PRESET_DIR.glob("*.yaml"))


def load_spec(path_or_preset: str | Path) -> ExperimentSpec:
    """Load an experiment by the name of a preset or from a YAML file.

    The first unit of every cell is drawn, so that an invalid scenario is found before the run.

    Raises:
        InputError: the preset or file does not exist, or is no valid YAML or experiment.
    """
    text = str(path_or_preset)
    if text in preset_names():
        return _load(PRESET_DIR / f"{text}.yaml")
    if Path(text).suffix in (".yaml", ".yml"):
        return _load(Path(text))
    likely = guess(text, preset_names())
    remedy = f"use {likely}one of {', '.join(preset_names())}, or the path of a .yaml file"
    raise InputError(text, "no such experiment", remedy)


def _load(path: Path) -> ExperimentSpec:
    file = read_yaml(path, "experiment", f"a copy of {PRESET_DIR / 'smoke.yaml'}")
    try:
        spec = ExperimentSpec.model_validate(file.data)
    except ValidationError as error:
        raise all_faults(error, file.where, root=ExperimentSpec) from None
    collect(_distribution_faults(file), None)
    unit_settings(spec.settings, spec.threads, file.where)
    faults: list[InputError] = []
    for cell in spec.cell_names():
        try:
            spec._unit(cell, 0, file.where)
        except InputError as error:
            faults += error.faults
    collect(in_order_of_lines(path, faults), None)
    return spec


def _distribution_faults(file: YamlFile) -> list[InputError]:
    """What is meant as a distribution and is none."""
    return [
        InputError(file.where(at), found.problem, found.remedy)
        for key in ("bases", "degradations")
        for at, found in distributions_in(file.data[key], (key,))
        if isinstance(found, NotationError)
    ]


def _members(base: Base) -> tuple[str | None, ...]:
    if base.each_member and base.family is not None:
        return load_family(base.family).members
    return (None,)
