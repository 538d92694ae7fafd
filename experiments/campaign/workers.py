"""The workers of an experiment's units: that its systems can run in them is known before anything runs."""

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from dslab.experiments.eq1.arms import LIMITS
from dslab.experiments.eq1.spec import ExperimentSpec
from dslab.experiments.eq1.units import system_label
from dslab.experiments.jobs.pool import Pool, PoolSettings, open_pool
from dslab.experiments.runs.provenance import usable_cores
from dslab.experiments.runs.systems.command import CommandSystem
from dslab.experiments.runs.systems.own_class import ClassSystem
from dslab.experiments.runs.systems.registry import (
    DualSystem,
    Registry,
    System,
    check_startable,
    system_digest,
    takes_real_time,
)
from dslab.scenarios.errors import InputError

TIME_S, MEMORY_MB = 1800.0, 4000
"""Limits of a unit, if no others are given."""
RunUnit = Callable[..., dict[str, Any]]
"""Takes a unit, ``cache_dir`` and ``folders``, returns its record; a function of a module."""


@dataclass(frozen=True)
class UnitWorkers:
    """Where units run.

    Attributes:
        settings: number and limits of the workers.
        folders: of descriptions of systems, beside ours and those of ``DSLAB_SYSTEMS``.
        digests: hashes of classes and descriptions, by name of the system; none of ours.
    """

    settings: PoolSettings = field(default=PoolSettings(1, None, TIME_S, MEMORY_MB))
    folders: tuple[Path, ...] = ()
    digests: dict[str, str] = field(default_factory=dict)

    def open(self) -> AbstractContextManager[Pool]:
        """Open a pool that takes units and returns their records."""
        from dslab.experiments.eq1.trial import run_unit

        return open_pool(partial(run_unit, folders=self.folders), self.settings)


def unit_workers(
    spec: ExperimentSpec,
    folders: Iterable[Path] = (),
    workers: int | None = None,
    scheduler: str | None = None,
    time_s: float = TIME_S,
    memory_mb: int = MEMORY_MB,
) -> UnitWorkers:
    """Find the systems of an experiment, and choose workers for its units.

    Args:
        spec: of the experiment.
        folders: see :class:`UnitWorkers`.
        workers: processes; None for one per core, or for a single one if a system takes frames in real time.
        scheduler: address of a Dask scheduler to use instead.
        time_s, memory_mb: limits of a unit; no limit of memory if that is 0.

    Raises:
        InputError: there is no such system, or it cannot be started; one in real time would run beside
            others, or one could be ended by the limit of a unit and not by its own.
    """
    folders = tuple(folder.absolute() for folder in folders)
    systems = find_systems(spec, folders)
    alone = any(map(takes_real_time, systems.values()))
    settings = PoolSettings(workers or (1 if alone else usable_cores()), scheduler, time_s, memory_mb or None)
    for name, system in systems.items():
        if takes_real_time(system) and (settings.workers > 1 or scheduler is not None):
            problem = f"{name} takes frames in real time, and what runs beside it changes what it does"
            raise InputError("--workers", problem, "give --workers 1, or leave out what is not in real time")
        if (needed_s := _longest_s(spec, system)) > time_s:
            problem = f"{time_s:g} s are less than the {needed_s:.0f} s that a unit may take {name}"
            raise InputError("--timeout", problem, "give more, or lower the limits of the system")
    digests = {name: digest for name, system in systems.items() if (digest := system_digest(system))}
    return UnitWorkers(settings, folders, digests)


def find_systems(spec: ExperimentSpec, folders: Iterable[Path] = ()) -> dict[str, System]:
    """The systems of an experiment, by the names that they have in its cells.

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
        check_startable(system)
        found[system_label(named)] = system
    return found


def _longest_s(spec: ExperimentSpec, system: System) -> float:
    """Longest duration of a unit's runs by their own limits; 0 of our systems, which have none."""
    whole_s = spec.lead_in_s + spec.exposed_s + spec.tail_s
    if isinstance(system, DualSystem):
        return 2 * sum(_longest_s(spec, part) for part in system.parts)
    if isinstance(system, CommandSystem):
        limits, runs, fed_s = system.spec.limits, 2, spec.lead_in_s + whole_s
    elif isinstance(system, ClassSystem):
        limits, runs, fed_s = LIMITS, 1, whole_s
    else:
        return 0.0
    return runs * limits.start_s + limits.slow_down * fed_s
