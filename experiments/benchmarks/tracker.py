"""Speed of a system on a sequence over repeated runs, and what recoveries and fusions beside it cost."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dslab.experiments.evaluation.summary import is_tracked, stage_times, time_figures
from dslab.experiments.runs import execution
from dslab.experiments.runs.execution import Mode, RunRecord, SystemKind, execute
from dslab.experiments.runs.pacing import RealTime
from dslab.sim.sequence import Sequence as ImageSequence

if TYPE_CHECKING:
    from dslab.slam.dual.config import DualConfig

_STAGE = "fusion"


def bench(
    sequence: ImageSequence,
    system_kind: SystemKind,
    runs: int,
    seed: int,
    progress: Callable[[str, int, int], None],
    mode: Mode = "lockstep",
    real_time: bool = False,
    dual: "DualConfig | None" = None,
) -> dict[str, Any]:
    """Run a system several times over the same frames; the times of all runs are pooled.

    Args:
        sequence: the input.
        system_kind: name of one of our systems.
        runs: number of runs.
        seed: root of every random stream of the system, the same in every run.
        progress: called with (step, done, total).
        mode: schedule of the system's parts.
        real_time: feed the frames at the pace of their stamps.
        dual: settings of Dual-SLAM; None for its defaults.

    Returns:
        Times as in the summary of a run, with frames per second (median over runs), peak memory (largest),
        the size of the map (last run), ``fusions`` as of :func:`fusion_figures`.

    Raises:
        InputError: a frame cannot be read.
    """
    from dslab.slam.warmup import warm_up

    warm_up(progress)
    build, records = execution.system_factory(mode, dual), []
    for run in range(runs):
        title = f"run {run + 1} of {runs}"
        records.append(
            execute(
                sequence,
                system_kind,
                seed,
                progress=lambda done, total, title=title: progress(title, done, total),
                build=build,
                pace=RealTime(sequence) if real_time else None,
            )
        )
    results = [result for record in records for result in record.results]
    last = records[-1]
    return {
        "sequence": sequence.name,
        "system": system_kind,
        "mode": mode,
        "runs": runs,
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


def fusion_figures(records: Sequence[RunRecord]) -> dict[str, Any]:
    """Figures of fusions over repeated runs.

    Returns:
        ``count``: number of fusions; ``hold_up_ms_max``: longest wall time that the tracking thread spent on
        one, None without any. ``beside_frames``: frames fed from the start of a recovery to its end or
        fusion, and those in which a fusion was taken over; ``beside_dropped``: frames dropped there;
        ``other_frames``, ``other_dropped``: all others.
    """
    hold_ups_ms = [r.ms[_STAGE] for record in records for r in record.results if _STAGE in r.ms]
    figures = {"count": 0, "hold_up_ms_max": max(hold_ups_ms, default=None)}
    figures |= dict.fromkeys(("beside_frames", "beside_dropped", "other_frames", "other_dropped"), 0)
    for record in records:
        beside, dropped = _beside_recovery(record), _dropped_after(record.sequence.stamps_s)
        figures["count"] += sum(e.kind == "fusion" and e.record()["accepted"] for e in record.events)
        for name, mask in (("beside", beside), ("other", ~beside)):
            figures[f"{name}_frames"] += int(mask.sum())
            figures[f"{name}_dropped"] += int(dropped[mask].sum())
    return figures


def _beside_recovery(record: RunRecord) -> np.ndarray:
    """(n,) bool mask of the frames during which a recovery or a fusion was under way."""
    beside = np.zeros(len(record.results), bool)
    started: dict[int, int] = {}
    for event in record.events:
        if event.kind == "recovery_start":
            started.setdefault(event.map_id, event.frame)
        elif event.kind == "recovery_end":
            beside[started[event.map_id] : event.frame + 1] = True
        elif event.kind == "fusion":
            first = started.get(event.record()["new_map_id"], event.frame)
            beside[first : event.frame + 1] = True
    return beside


def _dropped_after(stamps_s: np.ndarray) -> np.ndarray:
    """(n,) int number of frames dropped after each frame fed."""
    if len(stamps_s) < 2:
        return np.zeros(len(stamps_s), int)
    steps_s = np.diff(stamps_s)
    return np.append(np.rint(steps_s / np.median(steps_s)).astype(int) - 1, 0)
