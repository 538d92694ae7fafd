"""Speed of an experiment: units per hour, shares of CPU time, speed-up by more workers."""

import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import psutil

from dslab.experiments.campaign.workers import MEMORY_MB, TIME_S, RunUnit
from dslab.experiments.eq1.records import Outcome
from dslab.experiments.eq1.spec import ExperimentSpec
from dslab.experiments.eq1.units import UnitSpec
from dslab.experiments.jobs.pool import Pool, PoolSettings, open_pool
from dslab.experiments.runs.provenance import usable_cores
from dslab.sim.unfinished import scratch_folder

Progress = Callable[[str, int, int], None]


def bench_experiment(
    experiment: ExperimentSpec, units: int, workers: int, job: RunUnit, progress: Progress
) -> dict[str, Any]:
    """Run the same units on one worker, then on several, each time with nothing rendered before.

    Every worker first runs a unit that is not counted, which loads compiled code.

    Args:
        experiment: source of the units, over all its cells.
        units: number of units in each of the two laps.
        workers: number of workers in the second lap.
        job: runs a unit.
        progress: called with (step, done, total) after every unit.

    Returns:
        ``laps``, one dictionary each: ``workers``, ``units`` without infrastructure error, ``wall_s``,
        ``cpu_s`` of workers and driver, ``render_s`` and ``slam_s`` of the units, ``units_per_hour`` and the
        shares of CPU time ``render_share``, ``slam_share`` and ``overhead_share`` (all else); ``speed_up`` in
        units per hour; and ``speed_up_cores_free``, by CPU time, as if every worker had its own core.
    """
    one, many = (_lap(experiment, units, n, job, progress) for n in (1, workers))
    return {
        "experiment": experiment.name,
        "cores": usable_cores(),
        "laps": [one, many],
        "speed_up": _ratio(many["units_per_hour"], one["units_per_hour"]),
        "speed_up_cores_free": _ratio(workers * one["cpu_s"] * many["units"], many["cpu_s"] * one["units"]),
    }


def _lap(
    experiment: ExperimentSpec, units: int, workers: int, job: RunUnit, progress: Progress
) -> dict[str, Any]:
    cells = experiment.cell_names()
    chosen = [experiment.unit(cells[k % len(cells)], k // len(cells)) for k in range(units)]
    # Worlds of their own, so that their cached frames do not serve the counted units.
    first = [experiment.unit(cells[0], 10_000 + k) for k in range(workers)]
    step = f"{workers} worker{'s' if workers > 1 else ''}"
    with scratch_folder() as folder:
        settings = PoolSettings(workers, None, TIME_S, MEMORY_MB)
        with open_pool(partial(job, cache_dir=folder), settings) as pool:
            _run(pool, first, lambda done: progress(f"{step}, loading", done, workers))
            began_s, began_cpu_s = time.perf_counter(), _cpu_s()
            records = _run(pool, chosen, lambda done: progress(step, done, units))
            wall_s, cpu_s = time.perf_counter() - began_s, _cpu_s() - began_cpu_s
    completed = [r for r in records if r is not None and r["outcome"] != Outcome.INFRASTRUCTURE_ERROR]
    render_s, slam_s = (sum(r[name] or 0.0 for r in completed) for name in ("render_s", "slam_s"))
    return {
        "workers": workers,
        "units": len(completed),
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "render_s": render_s,
        "slam_s": slam_s,
        "units_per_hour": 3600 * len(completed) / wall_s,
        "render_share": _ratio(render_s, cpu_s),
        "slam_share": _ratio(slam_s, cpu_s),
        "overhead_share": _ratio(cpu_s - render_s - slam_s, cpu_s),
    }


def _run(pool: Pool, units: list[UnitSpec], show: Callable[[int], None]) -> list[dict[str, Any] | None]:
    records = []
    show(0)
    for ended in pool.run(deque(units)):
        records.append(ended.value)
        show(len(records))
    return records


def _cpu_s() -> float:
    """CPU time of this process and its living descendants."""
    me = psutil.Process()
    times = [process.cpu_times() for process in (me, *me.children(recursive=True))]
    return sum(t.user + t.system for t in times)


def _ratio(value: float, by: float) -> float | None:
    return value / by if by else None
