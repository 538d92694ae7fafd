"""Picture of runs over one sequence: sample frames, paths from above, inliers over time."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from dslab.experiments.evaluation.breakages import breakage_outcomes
from dslab.experiments.evaluation.frame_outcomes import frame_outcomes
from dslab.experiments.evaluation.scene import lay_out
from dslab.experiments.pictures import palette
from dslab.experiments.pictures.labels import label
from dslab.experiments.pictures.path_panel import DrawnRun, draw_path
from dslab.experiments.pictures.time_panel import draw_inliers, draw_lanes
from dslab.experiments.runs.execution import RunRecord
from dslab.scenarios.describe import describe_kind
from dslab.sim.sequence import Sequence

_SAMPLES = 5
_SAMPLE_WIDTH_PX = 320


def draw_runs(path: Path, records: Mapping[str, RunRecord]) -> None:
    """Write the figure of some runs as a PNG file; arguments as :func:`runs_figure`."""
    runs_figure(records).savefig(path)


def runs_figure(records: Mapping[str, RunRecord]) -> Figure:
    """Draw sample frames, paths, and inliers over time of some runs over one sequence.

    Each map is drawn with its final path, aligned to the truth for display only; without truth the map with
    most frames is drawn in its own frame.

    Args:
        records: one run per system, by name.
    """
    sequence = next(iter(records.values())).sequence
    colors = palette.segment_colors(segment.kind for segment in sequence.segments)
    runs = [drawn_run(name, record, place) for place, (name, record) in enumerate(records.items())]
    figure = Figure(figsize=(13, 8.6 + 0.25 * len(runs)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.add_gridspec(4, 1, height_ratios=[1.35, 3.4, 1.5, 0.25 + 0.25 * len(runs)])
    samples = _sample_frames(sequence)
    for place, frame in enumerate(samples):
        axes = figure.add_subplot(rows[0].subgridspec(1, len(samples))[place])
        _draw_frame(axes, sequence, frame, colors)
    panels = rows[1].subgridspec(1, len(runs))
    for place, run in enumerate(runs):
        draw_path(figure.add_subplot(panels[place]), run, colors)
    inliers = figure.add_subplot(rows[2])
    draw_inliers(inliers, runs, colors)
    draw_lanes(figure.add_subplot(rows[3], sharex=inliers), runs, colors)
    legend_of(figure, [run.name for run in runs], colors)
    return figure


def drawn_run(name: str, record: RunRecord, place: int) -> DrawnRun:
    """A run with what its picture shows; ``place`` is its place in the order of display."""
    sequence = record.sequence
    outcomes = breakage_outcomes(record.events, sequence.segments, list(sequence.stamps_s))
    frames = frame_outcomes(record)
    color = palette.system_color(name, place)
    return DrawnRun(label(name), color, record, lay_out(record), outcomes, frames)


def _sample_frames(sequence: Sequence) -> list[int]:
    """Middle frame of every segment, then frames spread over the sequence."""
    acting = [s for s in sequence.segments if s.first_frame >= 0]
    chosen = [(s.first_frame + s.last_frame) // 2 for s in acting][:_SAMPLES]
    spread = np.linspace(0.03, 0.97, _SAMPLES - len(chosen)) * (len(sequence) - 1)
    return sorted({*chosen, *(int(f) for f in spread)})


def _draw_frame(axes: Axes, sequence: Sequence, frame: int, colors: dict[str, str]) -> None:
    step = max(1, sequence.camera.width_px // _SAMPLE_WIDTH_PX)
    axes.imshow(sequence.frames[frame][::step, ::step], cmap="gray", vmin=0, vmax=255)
    kinds = sequence.kinds_at(frame)
    time_s = sequence.stamps_s[frame] - sequence.stamps_s[0]
    # Two lines each, so that all frames are of one size.
    axes.set_title(f"{time_s:.1f} s\n{', '.join(map(describe_kind, kinds)) or ' '}", fontsize=8)
    axes.set_xticks([])
    axes.set_yticks([])
    if kinds:
        for spine in axes.spines.values():
            spine.set(color=colors[kinds[-1]], linewidth=3)


def legend_of(figure: Figure, systems: list[str], colors: dict[str, str]) -> None:
    """Draw one legend for all axes below them: truth, systems, other paths and marks, segments."""
    found = {}
    for axes in figure.axes:
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(text, handle)
    first = {text: found[text] for text in ("truth", *systems) if text in found}
    found = first | found | {describe_kind(kind): Patch(color=color) for kind, color in colors.items()}
    if found:
        columns = min(len(found), 8)
        figure.legend(found.values(), found.keys(), loc="outside lower center", ncols=columns, fontsize=8)
