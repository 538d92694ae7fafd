"""Speed of a system on a sequence, over repeated runs."""

from collections.abc import Callable

import numpy as np

from experiments.execution import SystemFactory, SystemKind, execute
from experiments.summary import is_tracked, stage_times, time_figures
from sim.sequence import Sequence


def bench(
    sequence: Sequence,
    system_kind: SystemKind,
    runs: int,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
    build: SystemFactory | None = None,
) -> dict:
    """Run a system several times over the same frames; the times of all runs are pooled.

    Args:
        sequence: what to feed.
        system_kind: ``base`` or ``dual``.
        runs: how often.
        seed: root of every random stream of the system, the same in every run.
        progress: called with (step, done, total).
        build: makes the system; ``slam.system.build_system`` by default, whose kernels are compiled first.

    Returns:
        Times as in the summary of a run, with frames per second (median over runs), peak memory (largest) and
        the size of the map (last run).
    """
    show = progress or (lambda step, done, total: None)
    if build is None:
        from slam.warmup import warm_up

        warm_up(show)
    records = [
        execute(
            sequence,
            system_kind,
            seed,
            progress=lambda done, total, run=run: show(f"run {run + 1} of {runs}", done, total),
            build=build,
        )
        for run in range(runs)
    ]
    results = [result for record in records for result in record.results]
    last = records[-1]
    return {
        "sequence": sequence.name,
        "system": system_kind,
        "runs": runs,
        "frames": len(sequence),
        "tracked": sum(is_tracked(r) for r in last.results),
        "stages": stage_times(results),
        **time_figures(results),
        "frames_per_s": float(np.median([len(r.results) / r.wall_s for r in records])),
        "peak_rss_mb": max(r.peak_rss_mb for r in records),
        "keyframes": sum(len(k.frames) for k in last.keyframes),
        "map_points": sum(last.map_points.values()),
    }
