"""Speed of a system on a sequence over repeated runs."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from dslab.experiments.benchmarks.fusions import fusion_figures
from dslab.experiments.evaluation.summary import is_tracked, stage_times, time_figures
from dslab.experiments.runs import execution
from dslab.experiments.runs.execution import Mode, RunRecord, SystemFactory, SystemKind, execute
from dslab.experiments.runs.pacing import RealTime
from dslab.sim.sequence import Sequence

if TYPE_CHECKING:
    from dslab.slam.dual.config import DualConfig


def bench(
    sequence: Sequence,
    system_kind: SystemKind,
    runs: int,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
    build: SystemFactory | None = None,
    mode: Mode = "lockstep",
    real_time: bool = False,
    dual: "DualConfig | None" = None,
) -> dict:
    """Run a system several times over the same frames; the times of all runs are pooled.

    Args:
        sequence: the input.
        system_kind: ``base`` or ``dual``.
        runs: number of runs.
        seed: root of every random stream of the system, the same in every run.
        progress: called with (step, done, total).
        build: makes the system; by default ``slam.factory.build_system``, whose kernels are compiled first.
        mode: schedule of the system's parts, unless ``build`` is given.
        real_time: feed the frames at the pace of their stamps.
        dual: settings of Dual-SLAM, unless ``build`` is given; None for its defaults.

    Returns:
        Times as in the summary of a run, with frames per second (median over runs), peak memory (largest),
        the size of the map (last run), ``fusions`` as of ``experiments.benchmarks.fusions.fusion_figures``.

    Raises:
        InputError: a frame cannot be read.
    """
    show = progress or (lambda step, done, total: None)
    if build is None:
        from dslab.slam.warmup import warm_up

        warm_up(show)
        build = execution.system_factory(mode, dual)
    records: list[RunRecord] = []
    for run in range(runs):
        title = f"run {run + 1} of {runs}"
        records.append(
            execute(
                sequence,
                system_kind,
                seed,
                progress=lambda done, total, title=title: show(title, done, total),
                build=build,
                pace=RealTime(sequence) if real_time else None,
            )
        )
    return _figures(sequence, system_kind, mode, records)


def _figures(sequence: Sequence, system_kind: SystemKind, mode: Mode, records: list[RunRecord]) -> dict:
    results = [result for record in records for result in record.results]
    last = records[-1]
    return {
        "sequence": sequence.name,
        "system": system_kind,
        "mode": mode,
        "runs": len(records),
        "frames": len(sequence),
        "dropped_frames": [record.dropped_frames for record in records],
        "tracked": sum(is_tracked(r) for r in last.results),
        "stages": stage_times(results),
        **time_figures(results),
        "frames_per_s": float(np.median([len(r.results) / r.wall_s for r in records])),
        "peak_rss_mb": max(r.peak_rss_mb for r in records),
        "keyframes": sum(len(k.frames) for k in last.keyframes),
        "map_points": sum(last.map_points.values()),
        "fusions": fusion_figures(records),
    }
