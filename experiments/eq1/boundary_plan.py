"""What a boundary search asks, and its trials as units of an experiment.

The experiment has one base, one kind of stress with its doses, and a sham. Trial t is unit t of the cell of
its dose: it has world t, which no other trial has.
"""

from dataclasses import dataclass
from typing import Any, Literal

from pydantic import ValidationError

from dslab.experiments.eq1.doses import DoseAxis, dose_axis
from dslab.experiments.eq1.records import dual_column, failure_column, thread_column
from dslab.experiments.eq1.spec import ExperimentSpec
from dslab.experiments.eq1.spec_parts import Degradation
from dslab.experiments.eq1.units import RECOVERING, system_label
from dslab.scenarios.errors import InputError
from dslab.scenarios.faults import all_faults, guess

FailureName = Literal["breakage", "dual", "system", "mission", "recovery"]
FAILURES: dict[FailureName, str] = {
    "breakage": "tracking breaks (B)",
    "dual": "tracking breaks and every recovery thread fails (D)",
    "system": "tracking breaks and no thread recovers, or the first to say so is wrong (S)",
    "mission": "the system fails, or is silently or falsely wrong (M)",
    "recovery": "the first thread does not cross the segment, whether or not tracking breaks (R_1)",
}
"""What a search can be of; with all threads of the spec."""
OF_ANY: tuple[FailureName, ...] = ("breakage", "system", "mission")
"""Those of a system without recovery threads: it breaks, does not come back, or its mission fails."""
_CREEPING, _PREFIX = "-creeping", "boundary-"
_ONE_UNIT_PER_WORLD: dict[str, Any] = {
    "sequences_per_world": 1,
    "repeats": 1,
    "sham": True,
    "confirmatory": (),
    "confirmatory_threads": None,
    "levels": (),
}


@dataclass(frozen=True)
class BoundaryPlan:
    """A search for the dose at which a failure has a probability.

    Attributes:
        spec: the experiment whose units the trials are; ``worlds`` is their number.
        kind: of stress, as the cells and records call it.
        of: name of the failure.
        level: its probability at the dose that is sought.
        axis: the doses, those of the spec.
        shams: number of trials without stress, which are the first.
        batch: number of trials whose doses are chosen together.
    """

    spec: ExperimentSpec
    kind: str
    of: FailureName
    level: float
    axis: DoseAxis
    shams: int
    batch: int

    @property
    def system(self) -> str:
        """Name of the system that fails."""
        return system_label(self.spec.systems[0])

    @property
    def failure(self) -> str:
        """The failure in short words."""
        return self.of if self.of == "breakage" else f"{self.of} failure"

    @property
    def trials(self) -> int:
        """Number of trials, with the shams."""
        return self.spec.worlds

    @property
    def column(self) -> str:
        """Column of the records that holds the failure."""
        threads = len(self.spec.threads)
        return {
            "breakage": "breakage",
            "dual": dual_column(threads),
            "system": failure_column("s", threads),
            "mission": failure_column("m", threads),
            "recovery": thread_column("cross", 1, "failed"),
        }[self.of]

    @property
    def strengths(self) -> tuple[float, ...]:
        """Strengths of the doses, ascending."""
        return tuple(map(self.axis.strength, self.axis.doses))

    @property
    def dose_cells(self) -> list[str]:
        """Cells of the doses, in their order."""
        return [name for name, cell in self.spec.cells.items() if cell.dose is not None]

    @property
    def sham_cell(self) -> str:
        """The cell without stress."""
        return next(name for name, cell in self.spec.cells.items() if cell.dose is None)


def boundary_plan(
    spec: ExperimentSpec,
    kind: str,
    of: FailureName,
    level: float,
    *,
    base: str | None = None,
    trials: int = 60,
    shams: int = 8,
    batch: int = 4,
    seed: int = 0,
    axis: DoseAxis | None = None,
    system: str | None = None,
) -> BoundaryPlan:
    """Plan a search in one base of an experiment.

    Args:
        spec: an experiment, from which base, times, threads and settings are taken; of its degradations that
            of the kind, with its times and further fields, else the times of the first.
        kind: of stress; with ``-creeping`` behind it the dose rises over the whole duration.
        of: name of the failure.
        level: its probability at the dose that is sought.
        base: name of the base; None for the first.
        trials: their number, with the shams.
        shams: number of trials without stress.
        batch: number of trials whose doses are chosen together.
        seed: root of every stream: worlds, paths, noise.
        axis: the doses; None for those of the kind.
        system: that fails; None for the first of the experiment.

    Raises:
        InputError: no such kind, base or failure, the level is none, or a scenario is not valid.
    """
    system = system or spec.systems[0]
    _check(of, system, level, trials, shams)
    name, axis = _base(spec, base), axis or dose_axis(kind.removesuffix(_CREEPING))
    # B does not depend on the threads, R_1 on the first alone.
    threads = spec.threads[:1] if of in ("breakage", "recovery") else spec.threads
    design = {
        # All that decides the doses, so that no other search goes on with the ledger. The level does not.
        "name": f"{_PREFIX}{of}-{shams}-{batch}",
        "description": f"Dose of {kind} at which {of} fails with probability {level:g}, in {name}.",
        "root_seed": seed,
        "bases": {name: spec.bases[name]},
        "degradations": (_stress(spec, kind, axis, name),),
        "worlds": trials,
        "systems": (system,),
        "threads": threads,
        "arms": ("crossing",) if of == "recovery" else ("free",),
        **_ONE_UNIT_PER_WORLD,
    }
    own = spec.model_copy(update=design)
    plan = BoundaryPlan(own, own.degradations[0].label, of, level, axis, shams, batch)
    for cell in plan.spec.cells:
        plan.spec.unit(cell, 0)
    return plan


def _check(of: str, system: str, level: float, trials: int, shams: int) -> None:
    if of not in FAILURES:
        raise InputError("--of", f"{of!r} is no failure", f"use one of {', '.join(FAILURES)}")
    if system not in RECOVERING and of not in OF_ANY:
        problem = f"{of} is a failure of recovery threads, which {system_label(system)} does not have"
        raise InputError("--of", problem, f"use one of {', '.join(OF_ANY)}")
    if not 0 < level < 1:
        remedy = "give a probability between that without stress and 1, as 0.5"
        raise InputError("--fail", f"{level:g} is no probability that a dose can have", remedy)
    if trials <= shams:
        problem = f"{trials} trials leave none with stress beside {shams} without"
        raise InputError("--trials", problem, "give more trials or fewer --sham")


def is_search(spec: ExperimentSpec) -> bool:
    """True if the units of an experiment are the trials of a search."""
    return spec.name.startswith(_PREFIX)


def _base(spec: ExperimentSpec, base: str | None) -> str:
    name = next(iter(spec.bases)) if base is None else base
    if name not in spec.bases:
        known = list(spec.bases)
        remedy = f"use {guess(name, known)}one of {', '.join(known)}"
        raise InputError("--world", f"{spec.name} has no {name} among its bases", remedy)
    if spec.bases[name].each_member:
        problem = f"{name} of {spec.name} stands for every member of its family"
        raise InputError("--world", problem, "name one member as the family of a base")
    return name


def _stress(spec: ExperimentSpec, kind: str, axis: DoseAxis, base: str) -> Degradation:
    own = next((one for one in spec.degradations if one.label == kind), None)
    like = own or spec.degradations[0]
    fields = {} if own is None else {k: v for k, v in own.fields.items() if k != axis.field}
    if own is not None and own.dose != axis.field:
        raise InputError(
            "--dose",
            f"the doses of {kind} in {spec.name} are those of {own.dose}",
            f"leave it out, or give a --spec without {kind}",
        )
    try:
        return Degradation(
            kind=kind.removesuffix(_CREEPING),
            creeping=kind.endswith(_CREEPING),
            dose=axis.field,
            doses={base: axis.doses},
            begins_s=like.begins_s,
            acts_s=like.acts_s,
            fields=fields,
        )
    except ValidationError as error:
        raise all_faults(error, lambda at: ".".join(map(str, (kind, *at))), root=Degradation) from None
