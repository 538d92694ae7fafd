"""The spec of an experiment: cells, units and seeds as typed and validated data.

A cell is a scenario base, one kind of world and of motion, with one dose of one degradation, run by one
system, ours or any other. Its units have a clean lead-in, an exposed segment in part of which the
degradation acts, and a clean tail. They are replicates of sequences in worlds. Index ``i`` has the same
world, path and noise in every cell: two cells differ only in what their names state.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import yaml
from pydantic import Field, ValidationError, model_validator

from dslab.experiments.eq1.records import SHAM
from dslab.experiments.eq1.spec_parts import Base, Degradation, Threads, base_mixtures, stress_mixtures
from dslab.experiments.eq1.unit_drawing import Cell, Drawn, draw_scenario, written_base
from dslab.experiments.eq1.units import (
    RECOVERING,
    ArmName,
    ThreadChoice,
    UnitSpec,
    content_hash,
    system_label,
    unit_settings,
)
from dslab.scenarios.distributions import NotationError
from dslab.scenarios.errors import InputError, collect
from dslab.scenarios.families import distributions_in, in_order_of_lines, load_family
from dslab.scenarios.faults import all_faults, guess
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.strict import Strict
from dslab.scenarios.yaml_file import Location, YamlFile, read_yaml
from dslab.slam.dual.recovery.registry import RECOVERY_KINDS

PRESET_DIR = Path(__file__).parent / "presets"
START_WITHIN_S = 1.0
"""Replicates start within this time of the lead-in, or within half of it."""
LevelName = Literal["sequences", "worlds"]
_NAME = r"^[a-z0-9][a-z0-9_-]*$"
_SEED_END = 2**53  # exact in JSON and in every table


class ExperimentSpec(Strict):
    """The spec of an experiment."""

    name: str = Field(pattern=_NAME, max_length=40)
    description: str = ""
    root_seed: int = Field(0, ge=0, lt=_SEED_END)
    bases: dict[Annotated[str, Field(pattern=_NAME)], Base] = Field(min_length=1)
    degradations: tuple[Degradation, ...] = Field(min_length=1)
    systems: tuple[Annotated[str, Field(min_length=1)], ...] = Field(
        ("dual",),
        min_length=1,
        description="names of `dslab systems list`, or module:Class; those without recovery threads run the "
        "free arm alone",
    )
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
    worlds: int = Field(ge=1, le=100_000, description="of every cell: the sample")
    sequences_per_world: int = Field(1, ge=1, le=100, description="paths in one world")
    repeats: int = Field(
        1, ge=1, le=100, description="replicates of a sequence: other noise, start frame and random seeds"
    )
    sham: bool = Field(True, description="a cell without a degradation for every base")
    confirmatory: tuple[str, ...] = Field((), description="cells whose tests decide; named before the run")
    confirmatory_threads: int | None = Field(
        None, ge=1, description="how many of the first threads decide there, one after the other; null: all"
    )
    levels: tuple[LevelName, ...] = Field(
        (), description="within what chance is to be told apart: sequences need repeats, worlds sequences"
    )

    @model_validator(mode="after")
    def _check_consistency(self) -> "ExperimentSpec":
        for name in ("systems", "arms", "degradations"):
            items = getattr(self, name)
            named = [getattr(item, "label", None) or system_label(item) for item in items]
            twice = next((item for i, item in enumerate(named) if item in named[:i]), None)
            if twice is not None:
                raise ValueError(f"{name} names {twice} twice, keep one of them")
        alone = [system_label(system) for system in self.systems if system not in RECOVERING]
        if alone and "free" not in self.arms:
            raise ValueError(f"{alone[0]} has no recovery threads to cross with, add free to arms")
        for thread in self.threads:
            if thread.kind not in RECOVERY_KINDS:
                known = " or ".join(sorted(RECOVERY_KINDS))
                raise ValueError(f"unknown recovery thread {thread.kind!r}, use {known}")
        if any(thread in self.threads[:i] for i, thread in enumerate(self.threads)):
            raise ValueError("two threads are the same, give those of one kind different seeds")
        for degradation in self.degradations:
            if fault := degradation.base_fault(self.bases):
                raise ValueError(f"degradations, {degradation.label}: {fault}")
        bare = [base for base in self.bases if not any(d.doses_of(base) for d in self.degradations)]
        if bare:
            raise ValueError(f"bases: no degradation has a dose for {bare[0]}, give one or leave it out")
        if (self.confirmatory_threads or 0) > len(self.threads):
            raise ValueError(
                f"confirmatory_threads is {self.confirmatory_threads} of {len(self.threads)} threads, "
                "give at most as many"
            )
        needed = len(self.threads) + 1
        for level, name in (("sequences", "repeats"), ("worlds", "sequences_per_world")):
            if level in self.levels and getattr(self, name) < needed:
                raise ValueError(
                    f"{name} is {getattr(self, name)}, but chance within {level} with {len(self.threads)} "
                    f"threads takes {needed}, give {name}: {needed} or leave {level} out of levels"
                )
        return self

    # -- cells and units ---------------------------------------------------------------------------------

    @cached_property
    def cells(self) -> dict[str, Cell]:
        """Every cell by name: base (if several), kind, number of the dose (or sham), system (if several)."""
        named = [(name, base, member) for name, base in self.bases.items() for member in _members(base)]
        found = {}
        for name, base, member in named:
            place = name if member is None else f"{name}-{member}"
            written = written_base(base.family, member, base.own)
            doses: list[tuple[str, int | None, int | None]] = [
                (f"{degradation.label}/{dose + 1}", number, dose)
                for number, degradation in enumerate(self.degradations)
                for dose in range(len(degradation.doses_of(name)))
            ]
            for stress, number, dose in [*doses, *([(SHAM, None, None)] if self.sham else [])]:
                image = f"{place}/{stress}" if len(named) > 1 else stress
                for system in self.systems:
                    cell = Cell(image, name, written, number, dose, system)
                    found[f"{image}/{system_label(system)}" if len(self.systems) > 1 else image] = cell
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
        """Number of units of a cell.

        Raises:
            InputError: the cell is unknown.
        """
        self._cell(cell)
        return self.units

    @property
    def units(self) -> int:
        """Number of units of every cell."""
        return self.worlds * self.replicates_per_world

    @property
    def replicates_per_world(self) -> int:
        """Number of units of a cell in one world, whose indices follow one another."""
        return self.sequences_per_world * self.repeats

    def unit(self, cell: str, index: int) -> UnitSpec:
        """Draw one unit, of any index from 0: a pure function of the spec.

        Raises:
            InputError: the cell is unknown, or the drawn scenario is not valid.
        """
        return self._unit(cell, index, lambda at: f"experiment {self.name}: {'.'.join(map(str, at))}")

    def _unit(self, cell: str, index: int, where: Callable[[Location], str]) -> UnitSpec:
        of_cell = self._cell(cell)
        kind, severity = SHAM, 0.0
        if of_cell.degradation is not None and of_cell.dose is not None:
            degradation = self.degradations[of_cell.degradation]
            kind, severity = degradation.label, degradation.severities_of(of_cell.base)[of_cell.dose]
        number, repeat = divmod(index, self.repeats)
        world, sequence = divmod(number, self.sequences_per_world)

        def seed(*names: str | int) -> int:
            return int(rng_for(self.root_seed, "experiment", *names).integers(_SEED_END))

        seeds = {
            "world_seed": seed("world", world),
            "sequence_seed": seed("sequence", world, sequence),
            "repeat_seed": seed("repeat", world, sequence, repeat),
        }
        scenario = draw_scenario(self, of_cell, index, seeds, where)
        start_s = min(START_WITHIN_S, self.lead_in_s / 2)
        starts = max(1, round(start_s * scenario.camera.fps))
        start = rng_for(seeds["repeat_seed"], "experiment", "start").integers(starts)
        return UnitSpec(
            experiment=self.name,
            cell=cell,
            base=of_cell.base,
            kind=kind,
            severity=severity,
            index=index,
            sequence=sequence,
            repeat=repeat,
            **seeds,
            scenario=scenario,
            start_frame=int(start),
            onset_s=self.lead_in_s,
            exposed_s=self.exposed_s,
            threads=self.threads,
            settings=self.settings,
            system=of_cell.system,
            arms=self.arms if _recovers(of_cell.system) else ("free",),
        )

    def _cell(self, name: str) -> Cell:
        if name not in self.cells:
            likely = guess(name, list(self.cells))
            remedy = f"use {likely}one of {', '.join(self.cells)}"
            raise InputError(f"experiment {self.name}: {name}", "no such cell", remedy)
        return self.cells[name]

    @property
    def content_hash(self) -> str:
        """Hash of all that determines units and the tests, without the number of worlds and description."""
        data = self.model_dump(mode="json", exclude={"description", "worlds"})
        return content_hash({**data, "written": {name: cell.written for name, cell in self.cells.items()}})

    def as_yaml(self) -> str:
        """The spec with all defaults, as YAML that ``load_spec`` reads."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False, allow_unicode=True)


def preset_names() -> list[str]:
    """Names of the experiments in the package."""
    return sorted(path.stem for path in PRESET_DIR.glob("*.yaml"))


def load_spec(path_or_preset: str | Path, others: Iterable[str] = ()) -> ExperimentSpec:
    """Load an experiment by the name of a preset or from a YAML file.

    The first unit of every cell is drawn, so that an invalid scenario is found before the run.

    Args:
        path_or_preset: name of a preset, or a file.
        others: names that the caller knows as well, for who misspells one.

    Raises:
        InputError: the preset or file does not exist, or is no valid YAML or experiment.
    """
    text = str(path_or_preset)
    if text in preset_names():
        return _load(PRESET_DIR / f"{text}.yaml")
    if Path(text).suffix in (".yaml", ".yml"):
        return _load(Path(text))
    known = [*preset_names(), *others]
    remedy = f"use {guess(text, known)}one of {', '.join(known)}, or the path of a .yaml file"
    raise InputError(text, "no such experiment", remedy)


def read_spec_file(path: Path) -> YamlFile:
    """Read the YAML file of a spec.

    Raises:
        InputError: it does not exist or is no YAML.
    """
    return read_yaml(path, "experiment", f"a copy of {PRESET_DIR / 'smoke.yaml'}")


def validated(data: Any, file: YamlFile) -> ExperimentSpec:
    """The spec that the data of a file are, each field of the right kind.

    Raises:
        InputError: they are none.
    """
    try:
        spec = ExperimentSpec.model_validate(data)
    except ValidationError as error:
        raise all_faults(error, file.where, root=ExperimentSpec) from None
    collect(distribution_faults(file), None)
    return spec


def _load(path: Path) -> ExperimentSpec:
    file = read_spec_file(path)
    spec = validated(file.data, file)
    unit_settings(spec.settings, spec.threads, file.where)
    faults = list(mixtures(spec, file))
    for cell in spec.cell_names():
        try:
            spec._unit(cell, 0, file.where)
        except InputError as error:
            faults += error.faults
    collect(in_order_of_lines(path, faults), None)
    collect(list(_confirmatory_faults(spec, file)), None)
    return spec


def distribution_faults(file: YamlFile) -> list[InputError]:
    """What is meant as a distribution and is none."""
    return [
        InputError(file.where(at), found.problem, found.remedy)
        for key in ("bases", "degradations")
        for at, found in distributions_in(file.data.get(key, {}), (key,))
        if isinstance(found, NotationError)
    ]


def mixtures(spec: Drawn, file: YamlFile) -> Iterator[InputError]:
    """What mixes populations in a cell."""
    cells = spec.cells.values()
    drawn_from = {(cell.base, id(cell.written)): cell.written for cell in cells}
    for (name, _), variants in drawn_from.items():
        yield from base_mixtures(name, spec.bases[name], variants, file.where)
    yield from stress_mixtures(spec.degradations, file.where)


def _confirmatory_faults(spec: ExperimentSpec, file: YamlFile) -> Iterator[InputError]:
    """Names of cells to confirm that are none, or whose system Eq. 1 is not about."""
    known = [
        name for name, of in spec.cells.items() if of.degradation is not None and of.system in RECOVERING
    ]
    for number, cell in enumerate(spec.confirmatory):
        if cell not in known:
            remedy = f"use {guess(cell, known)}one of {', '.join(known)}" if known else "leave it out"
            yield InputError(
                file.where(("confirmatory", number)),
                f"{cell} is no cell with a dose and recovery threads",
                remedy,
            )


def _recovers(system: str) -> bool:
    """Return True if a system has a crossing arm: ours with recovery threads, and Dual-SLAM over any."""
    return system in RECOVERING or system.startswith("dual(")


def _members(base: Base) -> tuple[str | None, ...]:
    if base.each_member and base.family is not None:
        return load_family(base.family).members
    return (None,)
