"""Checks that the systems of an experiment can run in its workers, before anything runs."""

from collections.abc import Iterable
from pathlib import Path

from dslab.experiments.campaign.worker_pool import WorkerPoolSettings
from dslab.experiments.eq1.free_systems import LIMITS
from dslab.experiments.eq1.spec import ExperimentSpec
from dslab.experiments.eq1.units import system_label
from dslab.experiments.runs.systems.command import CommandSystem
from dslab.experiments.runs.systems.own_class import ClassSystem
from dslab.experiments.runs.systems.registry import Registry, System, system_digest
from dslab.scenarios.errors import InputError


def find_systems(spec: ExperimentSpec, folders: Iterable[Path] = ()) -> dict[str, System]:
    """The systems of an experiment, by the names that they have in its cells.

    Args:
        spec: of the experiment.
        folders: of descriptions, beside ours and those of ``DSLAB_SYSTEMS``.

    Raises:
        InputError: there is no such system, or it cannot be started.
    """
    registry = Registry.open(folders)
    found = {}
    for named in spec.systems:
        try:
            system = registry.find(named)
        except InputError as error:
            where = f"experiment {spec.name}: systems" if error.where == "--system" else error.where
            raise InputError(where, error.problem, error.remedy) from None
        if isinstance(system, CommandSystem):
            system.check()
        found[system_label(named)] = system
    return found


def takes_real_time(systems: dict[str, System]) -> bool:
    """True if one of the systems takes frames in real time."""
    return any(isinstance(system, CommandSystem) and system.takes_real_time for system in systems.values())


def check_workers(spec: ExperimentSpec, systems: dict[str, System], settings: WorkerPoolSettings) -> None:
    """Check that workers leave the systems the quiet and the time that they need.

    Raises:
        InputError: a system in real time would run beside others, or could be ended by the limit of a unit
            and not by its own.
    """
    if takes_real_time(systems) and (settings.workers > 1 or settings.scheduler is not None):
        name = next(name for name in systems if takes_real_time({name: systems[name]}))
        problem = f"{name} takes frames in real time, and what runs beside it changes what it does"
        raise InputError("--workers", problem, "give --workers 1, or leave out what is not in real time")
    for name, system in systems.items():
        needed_s = _longest_s(spec, system)
        if needed_s > settings.timeout_s:
            problem = (
                f"{settings.timeout_s:g} s are less than the {needed_s:.0f} s that a unit may take {name}"
            )
            raise InputError("--timeout", problem, "give more, or lower the limits of the system")


def digests_of(systems: dict[str, System]) -> dict[str, str]:
    """Hashes of classes and descriptions, by name of the system; none of ours."""
    return {name: digest for name, system in systems.items() if (digest := system_digest(system))}


def _longest_s(spec: ExperimentSpec, system: System) -> float:
    """Longest duration of a unit's runs by their own limits; 0 of our systems, which have none."""
    whole_s = spec.lead_in_s + spec.exposed_s + spec.tail_s
    if isinstance(system, CommandSystem):
        limits, runs, fed_s = system.spec.limits, 2, spec.lead_in_s + whole_s
    elif isinstance(system, ClassSystem):
        limits, runs, fed_s = LIMITS, 1, whole_s
    else:
        return 0.0
    return runs * limits.start_s + limits.slow_down * fed_s
