"""How fast an experiment runs: units per hour, where their time goes, what a second worker gives."""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from experiments.campaign.schedule import Experiment
from experiments.campaign.unit_job import Job
from experiments.campaign.worker_pool import WorkerPool, WorkerPoolSettings, embedded_worker_pool
from experiments.eq1.records import Outcome
from experiments.eq1.units import UnitSpec
from experiments.runs.provenance import usable_cores

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Lap:
    """The same units on so many workers.

    Attributes:
        workers: processes.
        units: that ended well.
        wall_s: from the first unit to the end of the last.
        cpu_s: of the workers and of the driver, all that was spent meanwhile.
        render_s, slam_s: CPU time of the units in these.
    """

    workers: int
    units: int
    wall_s: float
    cpu_s: float
    render_s: float
    slam_s: float


def bench_experiment(
    experiment: Experiment, units: int, workers: int, job: Job, progress: Progress | None = None
) -> dict[str, Any]:
    """Run the same units on one worker, then on several, each time with nothing rendered before.

    Every worker first runs a unit that is not counted: it loads what is compiled.

    Args:
        experiment: whose units are run, over all its cells.
        units: how many, in each of the two laps.
        workers: of the second lap.
        job: runs a unit.
        progress: told of every unit.

    Returns:
        ``laps``, one dictionary each: the fields of :class:`Lap` with ``units_per_hour`` and the shares of
        CPU time ``render_share``, ``slam_share`` and ``overhead_share`` (all else); ``speed_up`` in units per
        hour, and ``speed_up_cores_free``: what it would be had every worker a core of its own, by CPU times.
    """
    laps = [
        _lap(experiment, units, n, job, progress or (lambda step, done, total: None)) for n in (1, workers)
    ]
    one, many = laps
    return {
        "experiment": experiment.name,
        "cores": usable_cores(),
        "laps": [_figures(lap) for lap in laps],
        "speed_up": _ratio(_per_hour(many), _per_hour(one)),
        "speed_up_cores_free": _ratio(workers * one.cpu_s * many.units, many.cpu_s * one.units),
    }


def _lap(experiment: Experiment, units: int, workers: int, job: Job, progress: Progress) -> Lap:
    cells = experiment.cell_names()
    chosen = [experiment.unit(cells[k % len(cells)], k // len(cells)) for k in range(units)]
    # Of worlds of their own: what they render is of no use to the units that count.
    first = [experiment.unit(cells[0], 10_000 + k) for k in range(workers)]
    step = f"{workers} worker{'s' if workers > 1 else ''}"
    with tempfile.TemporaryDirectory(prefix="dslab-") as folder:
        settings = WorkerPoolSettings(workers=workers, cache_dir=Path(folder))
        with embedded_worker_pool(settings, job) as pool:
            _run(pool, first, lambda done: progress(f"{step}, loading", done, workers))
            began_s, began_cpu_s = time.perf_counter(), _cpu_s()
            records = _run(pool, chosen, lambda done: progress(step, done, units))
            wall_s, cpu_s = time.perf_counter() - began_s, _cpu_s() - began_cpu_s
    well = [r for r in records if r is not None and r["outcome"] != Outcome.INFRASTRUCTURE_ERROR]
    render_s, slam_s = (sum(r[name] or 0.0 for r in well) for name in ("render_s", "slam_s"))
    return Lap(workers, len(well), wall_s, cpu_s, render_s, slam_s)


def _run(pool: WorkerPool, units: list[UnitSpec], told: Callable[[int], None]) -> list[dict[str, Any] | None]:
    waiting, records = list(units), []
    told(0)
    while len(records) < len(units):
        for worker in pool.free()[: len(waiting)]:
            pool.start(waiting.pop(0), worker)
        records += [ended.record for ended in pool.wait(1.0)]
        told(len(records))
    return records


def _cpu_s() -> float:
    """CPU time of this process and of all that it has started and that are there."""
    me = psutil.Process()
    times = [process.cpu_times() for process in (me, *me.children(recursive=True))]
    return sum(t.user + t.system for t in times)


def _figures(lap: Lap) -> dict[str, Any]:
    overhead_s = lap.cpu_s - lap.render_s - lap.slam_s
    return vars(lap) | {
        "units_per_hour": _per_hour(lap),
        "render_share": _ratio(lap.render_s, lap.cpu_s),
        "slam_share": _ratio(lap.slam_s, lap.cpu_s),
        "overhead_share": _ratio(overhead_s, lap.cpu_s),
    }


def _per_hour(lap: Lap) -> float:
    return 3600 * lap.units / lap.wall_s


def _ratio(value: float, by: float) -> float | None:
    return value / by if by else None
