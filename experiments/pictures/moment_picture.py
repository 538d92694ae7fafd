"""Picture of one moment of some runs: the frame with its features, the path so far, inliers over time."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dslab.experiments.pictures import palette
from dslab.experiments.pictures.labels import label
from dslab.experiments.pictures.path_panel import DrawnRun, draw_path
from dslab.experiments.pictures.run_picture import drawn_run, legend_of
from dslab.experiments.pictures.time_panel import draw_inliers, draw_lanes
from dslab.experiments.runs.execution import RunRecord
from dslab.experiments.runs.read_back import until
from dslab.scenarios.describe import describe_kind


class ShownFrame(Protocol):
    """A frame to be shown; see ``recording.recorded_frame``."""

    @property
    def frame(self) -> int: ...
    @property
    def image(self) -> np.ndarray: ...
    @property
    def features(self) -> Mapping[str, np.ndarray]: ...
    @property
    def inliers(self) -> Mapping[str, np.ndarray]: ...


def moment_figure(records: Mapping[str, RunRecord], stamp_s: float, shown: ShownFrame | None) -> Figure:
    """Draw a moment of some runs over one sequence.

    A row for each system has the frame with its features, and the path as far as this frame, aligned to the
    truth for display; below lie the inliers of the whole runs, with a line at the moment.

    Args:
        records: one run per system, by name.
        stamp_s: the moment; in real time each system has dropped frames of its own.
        shown: the recorded frame nearest to it; None for none.
    """
    sequence = next(iter(records.values())).sequence
    colors = palette.segment_colors(segment.kind for segment in sequence.segments)
    figure = Figure(figsize=(13, 4.4 * len(records) + 2.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    lanes = 0.25 + 0.25 * len(records)
    rows = figure.add_gridspec(len(records) + 2, 1, height_ratios=[*[4.4] * len(records), 1.5, lanes])
    for place, (name, record) in enumerate(records.items()):
        panels = rows[place].subgridspec(1, 1 if shown is None else 2)
        if shown is not None:
            _draw_frame(figure.add_subplot(panels[0]), shown, name)
        axes = figure.add_subplot(panels[-1])
        frame = frame_at(record, stamp_s)
        early = drawn_run(name, until(record, frame), place)
        draw_path(axes, early, colors)
        _mark_camera(axes, early, frame)
        figures = axes.get_title().replace(f"{early.name}:", f"{early.name}, so far:", 1)
        axes.set_title(f"{_state(record, frame)}\n{figures}", fontsize=9)
    whole = [drawn_run(name, record, place) for place, (name, record) in enumerate(records.items())]
    inliers = figure.add_subplot(rows[-2])
    draw_inliers(inliers, whole, colors)
    below = figure.add_subplot(rows[-1], sharex=inliers)
    draw_lanes(below, whole, colors)
    for axes in (inliers, below):
        axes.axvline(stamp_s - sequence.stamps_s[0], color="black", linewidth=1.2, zorder=6)
    legend_of(figure, [run.name for run in whole], colors)
    return figure


def frame_at(record: RunRecord, stamp_s: float) -> int:
    """The frame of a run that is nearest to a moment."""
    return int(np.abs(record.sequence.stamps_s - stamp_s).argmin())


def _draw_frame(axes: Axes, shown: ShownFrame, name: str) -> None:
    axes.imshow(shown.image, cmap="gray", vmin=0, vmax=255)
    for points, color, size in ((shown.features, palette.FEATURE, 3), (shown.inliers, palette.INLIER, 7)):
        if name in points:
            axes.scatter(*points[name].T, s=size, color=color, linewidths=0)
    counts = [len(points.get(name, ())) for points in (shown.inliers, shown.features)]
    said = f"{counts[0]} features of the map (green), {counts[1]} others" if sum(counts) else "no features"
    axes.set_title(f"frame {shown.frame}: {said}", fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])


def _mark_camera(axes: Axes, run: DrawnRun, frame: int) -> None:
    """A ring about the true place of the camera; without truth about its last pose."""
    ground = [i for i in range(3) if run.scene.up[i] == 0]
    truth = run.scene.T_world_cam
    places = truth[: frame + 1] if truth is not None else _last_map(run)
    known = places[np.isfinite(places).all(axis=(1, 2))] if len(places) else places
    if len(known):
        at = known[-1, ground, 3]
        axes.plot(*at[:, None], "o", color="black", fillstyle="none", markersize=13, label="camera", zorder=6)


def _last_map(run: DrawnRun) -> np.ndarray:
    return next((path.T_map_cam for path in run.scene.final.values()), np.empty((0, 4, 4)))


def _state(record: RunRecord, frame: int) -> str:
    result = record.results[frame]
    segments = ", ".join(map(describe_kind, record.sequence.kinds_at(frame)))
    stamps_s = record.sequence.stamps_s
    words = [f"{stamps_s[frame] - stamps_s[0]:.2f} s, frame {frame}: {result.state}"]
    words += [result.reason] if result.reason else []
    words += [f"{result.inliers} inliers"] + ([f"under {segments}"] if segments else [])
    return label(", ".join(words).replace("_", " "))
