"""Sequences through the base, and how far apart the distributions lie of what it met there."""

from collections import defaultdict
from collections.abc import Sequence as Many
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import ks_2samp

from dslab.experiments.evaluation.summary import summarise
from dslab.experiments.pictures.labels import label
from dslab.experiments.realism.measures import MEASURES, frame_statistics, live_residuals, map_statistics
from dslab.experiments.runs.execution import SlamSystem, execute
from dslab.experiments.runs.files import plain, to_json
from dslab.experiments.runs.sources import open_sequence
from dslab.scenarios.errors import InputError
from dslab.sim.io.folders import Progress, check_free, new_directory
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import CameraRefined, TrackingState
from dslab.slam.core.results import TrackingResult
from dslab.slam.system import MonocularSlam

PICTURE_FILE, FIGURES_FILE = "footage.png", "footage.json"
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_LOOKED_AT_EVERY = 10  # frames, for the statistics of images
_MATCHED_EVERY = 5  # frames, for the residuals of all matches
_REMOVED_FROM = 2.45  # sigma: from here the tracker removes a match
_COLUMNS = 4  # with a panel of the scale, rows of these are full
_SHOWN = (0.005, 0.995)  # quantiles of all samples between which they are drawn
_OF_SUMMARY = (
    "frames", "share_tracked", "maps", "breakages", "keyframes", "true_path_m", "scale_first_over_last",
    "scale_along", "ate_m",
)  # fmt: skip

Samples = dict[str, np.ndarray]


def compare_footage(
    sources: Many[str],
    out_dir: Path,
    seed: int | None = None,
    frames: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the base over every sequence; write a picture of the distributions, and the figures.

    Args:
        sources: names as ``open_sequence`` takes them, each once; the first is the reference.
        out_dir: absent or empty.
        seed: root seed of scenarios and system; None for the scenario's own, and 0.
        frames: only so many of each, from the first on; None for all.
        progress: called with (step, frames done, frames in all).

    Returns:
        By source, as in ``footage.json``: ``figures`` of the run, and of each measure the number of
        ``values``, their ``quantiles`` and the ``distance`` from the first source's.

    Raises:
        InputError: a source is not valid or named twice, or the folder cannot be written.
    """
    twice = [source for place, source in enumerate(sources) if source in sources[:place]]
    if twice:
        raise InputError(twice[0], "is named twice", "name each sequence once")
    check_free(out_dir)
    figures, samples = {}, {}
    for source in sources:
        sequence = open_sequence(source, seed, progress)
        own_seed = seed if seed is not None else int(sequence.meta.get("seed", 0))
        if frames is not None and frames < len(sequence):
            sequence = sequence.only(np.arange(frames))
        figures[source], samples[source] = measure(sequence, own_seed, progress)
    first = samples[sources[0]]
    content = {
        source: {
            "figures": plain(figures[source]),
            "measures": {name: _described(samples[source][name], first[name]) for name in MEASURES},
        }
        for source in sources
    }
    with new_directory(out_dir) as folder:
        _draw(figures, samples).savefig(folder / PICTURE_FILE)
        (folder / FIGURES_FILE).write_text(to_json(content, indent=1) + "\n", encoding="utf-8")
    return content


def measure(
    sequence: Sequence, seed: int = 0, progress: Progress | None = None
) -> tuple[dict[str, Any], Samples]:
    """Run the base in lockstep; figures of the run, and (n,) samples of each measure by its name."""
    found: dict[str, list[np.ndarray]] = defaultdict(list)

    class Looking:
        def frame(self, image: np.ndarray, result: TrackingResult, system: SlamSystem) -> None:
            if result.frame % _LOOKED_AT_EVERY == 0:
                for name, values in frame_statistics(image).items():
                    found[name].append(values)
            tracked = result.state is TrackingState.TRACKING and not result.is_keyframe
            if tracked and result.frame % _MATCHED_EVERY == 0 and isinstance(system, MonocularSlam):
                found["live_residual"].append(live_residuals(system))

    def at_end(system: SlamSystem, _: Sequence) -> None:
        for path in system.trajectories()[:1]:  # the map with most frames
            for name, values in map_statistics(system.map(path.map_id)).items():
                found[name].append(values)

    show = progress and (lambda done, total: progress(f"tracking {sequence.name}", done, total))
    record = execute(sequence, "base", seed, observer=Looking(), progress=show, at_end=at_end)
    tracked = [r for r in record.results if r.state is TrackingState.TRACKING and r.matches]
    found["outliers"] = [np.array([1 - r.inliers / r.matches for r in tracked])]
    found["inliers"] = [np.array([float(r.inliers) for r in tracked])]
    samples = {name: np.concatenate(found[name] or [np.empty(0)]) for name in MEASURES}
    summary, live = summarise(record), samples["live_residual"]
    duration_s, path_m = sequence.stamps_s[-1] - sequence.stamps_s[0], summary["true_path_m"]
    return {
        **{name: summary[name] for name in _OF_SUMMARY},
        "camera_refined": sum(isinstance(event, CameraRefined) for event in record.events),
        "keyframes_per_s": summary["keyframes"] / duration_s if duration_s else None,
        "keyframes_per_m": summary["keyframes"] / path_m if path_m else None,
        "live_residual_over_2.45_sigma": float((live > _REMOVED_FROM).mean()) if len(live) else None,
    }, samples


def _described(own: np.ndarray, first: np.ndarray) -> dict[str, Any]:
    """Quantiles, and the largest difference of the distribution functions, 0 to 1 (Kolmogorov, Smirnov).

    No test is made of it: observations of one map depend on one another.
    """
    return {
        "values": len(own),
        "quantiles": np.quantile(own, QUANTILES).tolist() if len(own) else None,
        "distance": float(ks_2samp(own, first, method="asymp").statistic)
        if len(own) and len(first)
        else None,
    }


def _draw(figures: dict[str, dict[str, Any]], samples: dict[str, Samples]) -> Figure:
    """Distribution functions of every measure, a line per sequence, and the scale along the path."""
    rows = -(-(len(MEASURES) + 1) // _COLUMNS)
    figure = Figure(figsize=(4.2 * _COLUMNS, 2.6 * rows), dpi=110, layout="constrained")
    *panels, last = figure.subplots(rows, _COLUMNS).ravel()[: len(MEASURES) + 1]
    for axes, (name, (measure, is_log)) in zip(panels, MEASURES.items(), strict=True):
        for place, own in enumerate(samples.values()):
            if len(own[name]):
                axes.ecdf(own[name], color=f"C{place}")
        every = np.concatenate([own[name] for own in samples.values()])
        axes.set(xlabel=measure, ylim=(0, 1), xscale="log" if is_log else "linear")
        axes.xaxis.set_minor_formatter("")
        if len(every) and np.ptp(ends := np.quantile(every, _SHOWN)) > 0:
            axes.set_xlim(ends)
    for place, (source, own) in enumerate(figures.items()):
        scale = np.array(own["scale_along"] or [], float)
        last.plot(
            100 * (np.arange(len(scale)) + 0.5) / max(len(scale), 1),
            scale,
            f"C{place}.-",
            label=label(source),
        )
    last.set(xlabel="along the true path, per cent", ylabel="true over estimated length")
    figure.legend(loc="outside upper center", ncols=2)
    return figure
