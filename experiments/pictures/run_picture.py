"""Picture of runs: paths from above, inliers over time, sample frames."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from experiments.evaluation.breakages import BreakageOutcome, breakage_outcomes
from experiments.evaluation.frame_outcomes import FrameOutcome, frame_outcomes
from experiments.evaluation.scene import Scene, lay_out
from experiments.runs.execution import RunRecord, SystemKind
from sim.sequence import Sequence

_SYSTEM_COLORS = ("#d9622b", "#1f6fb4", "#208040", "#8050b0")
_RECOVERED_COLOR, _LOST_COLOR = "#30b040", "#c00020"
_SEGMENT_COLORS = {"low_texture": "#e8cf8a", "motion_blur": "#c9b3e6", "fast_rotation": "#a9d5c5"}
_SAMPLES = 5


def draw_runs(path: Path, sequence: Sequence, records: dict[SystemKind, RunRecord]) -> None:
    """Write the figure of some runs as a PNG file; arguments as :func:`runs_figure`."""
    runs_figure(sequence, records).savefig(path)


def runs_figure(sequence: Sequence, records: dict[SystemKind, RunRecord]) -> Figure:
    """Draw sample frames, paths and inliers of some runs over one sequence.

    Each map is drawn with its final path, aligned to the truth for display only; frames placed by a recovery
    are green. A cross marks a breakage, a disc a recovery.

    Args:
        sequence: the input sequence.
        records: one run per system, by name.
    """
    figure = Figure(figsize=(13, 8.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    top, middle, bottom = np.ravel(figure.subfigures(3, 1, height_ratios=[1.35, 3.3, 1.9]))
    for axes, frame in zip(top.subplots(1, _SAMPLES), _sample_frames(sequence), strict=True):
        _draw_frame(axes, sequence, frame)
    panels = middle.subplots(1, len(records))
    for place, (axes, record) in enumerate(zip(np.atleast_1d(panels), records.values(), strict=True)):
        outcomes = breakage_outcomes(record.events, sequence.segments, list(sequence.stamps_s))
        _draw_paths(axes, record, _system_color(place), lay_out(record), outcomes)
    _draw_inliers(bottom.subplots(), sequence, records)
    return figure


def _sample_frames(sequence: Sequence) -> list[int]:
    """Middle frame of every segment, then frames spread over the sequence."""
    acting = [s for s in sequence.segments if s.first_frame >= 0]
    chosen = [(s.first_frame + s.last_frame) // 2 for s in acting][:_SAMPLES]
    spread = np.linspace(0.03, 0.97, _SAMPLES - len(chosen)) * (len(sequence) - 1)
    return sorted([*chosen, *(int(f) for f in spread)])


def _draw_frame(axes: Axes, sequence: Sequence, frame: int) -> None:
    axes.imshow(sequence.frames[frame], cmap="gray", vmin=0, vmax=255)
    kinds = sequence.kinds_at(frame)
    axes.set_title(", ".join([f"{sequence.stamps_s[frame]:.1f} s", *kinds]).replace("_", " "), fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])
    if kinds:
        for spine in axes.spines.values():
            spine.set(color=_SEGMENT_COLORS.get(kinds[-1], "0.6"), linewidth=3)


def _draw_paths(
    axes: Axes, record: RunRecord, color: str, scene: Scene, outcomes: list[BreakageOutcome]
) -> None:
    ground = [i for i in range(3) if scene.up[i] == 0]
    if scene.T_world_cam is not None:
        _draw_truth(axes, record.sequence, scene.T_world_cam[:, ground, 3])
    recovered = np.array([outcome is FrameOutcome.RECOVERED for outcome in frame_outcomes(record)], bool)
    for rank, trajectory in enumerate(scene.final.values()):
        frames = len(trajectory.frames)
        label = (
            f"{record.system_kind}, {frames} frames" if rank == 0 else f"map {trajectory.map_id}, not fused"
        )
        position = np.full((len(record.results), 3), np.nan)
        position[trajectory.frames] = trajectory.T_map_cam[:, :3, 3]
        style = {"linestyle": "-" if rank == 0 else ":", "linewidth": 1.8, "zorder": 3}
        axes.plot(*position[:, ground].T, color=color, label=label, **style)
        position[~recovered] = np.nan
        if np.isfinite(position).any():
            style["linewidth"] = 3.5
            axes.plot(*position[:, ground].T, color=_RECOVERED_COLOR, label="placed by recovery", **style)
    if scene.T_world_cam is not None:
        _mark(axes, scene.T_world_cam[:, ground, 3], outcomes)
    unplaced = len(record.trajectories) - len(scene.final)
    if unplaced:
        note = f"{unplaced} map(s) not drawn: no alignment with the truth"
        axes.text(0.01, 0.01, note, transform=axes.transAxes, fontsize=8, color=_LOST_COLOR)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set_title(_headline(record, outcomes), fontsize=11)
    axes.set_xlabel("m", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=8, loc="best", framealpha=0.9)


def _draw_truth(axes: Axes, sequence: Sequence, path: np.ndarray) -> None:
    """Draw the true path from above, (N, 2), over wide lines for the segments."""
    axes.plot(*path.T, color="0.72", linewidth=4, label="truth", zorder=1)
    for segment in sequence.segments:
        inside = path[segment.first_frame : segment.last_frame + 1]
        axes.plot(
            *inside.T,
            color=_SEGMENT_COLORS.get(segment.kind, "0.6"),
            linewidth=10,
            solid_capstyle="butt",
            zorder=0,
            label=segment.kind.replace("_", " "),
        )


def _headline(record: RunRecord, outcomes: list[BreakageOutcome]) -> str:
    recovered = sum(o.recovered for o in outcomes)
    relocalized = sum(o.relocalized is not None for o in outcomes)
    posed = sum(outcome is not FrameOutcome.NONE for outcome in frame_outcomes(record)) / max(
        1, len(record.results)
    )
    return (
        f"{record.system_kind}: {posed:.0%} of the frames, {len(outcomes)} breakage(s), "
        f"{recovered} recovered, {relocalized} relocalized"
    )


def _mark(axes: Axes, positions: np.ndarray, outcomes: list[BreakageOutcome]) -> None:
    if not outcomes:
        return
    broke = positions[[o.breakage.frame for o in outcomes]]
    axes.plot(
        *broke.T, "x", color=_LOST_COLOR, markersize=10, markeredgewidth=2.5, zorder=5, label="breakage"
    )
    mended = positions[[o.fusion.frame for o in outcomes if o.fusion is not None and o.recovered]]
    if len(mended):
        axes.plot(*mended.T, "o", color="#208040", markersize=8, zorder=5, label="recovered and fused")
    found = positions[[o.relocalized.frame for o in outcomes if o.relocalized is not None]]
    if len(found):
        axes.plot(*found.T, "D", color="#208040", markersize=6, zorder=5, label="relocalized")


def _draw_inliers(axes: Axes, sequence: Sequence, records: dict[SystemKind, RunRecord]) -> None:
    for index, segment in enumerate(sequence.segments):
        if segment.first_frame >= 0:
            # Labels of overlapping segments are stacked.
            over = sum(
                s.first_frame <= segment.first_frame <= s.last_frame for s in sequence.segments[:index]
            )
            span = sequence.stamps_s[[segment.first_frame, segment.last_frame]]
            axes.axvspan(*span, color=_SEGMENT_COLORS.get(segment.kind, "0.8"), alpha=0.6, zorder=0)
            axes.text(
                span.mean(),
                0.97 - 0.08 * over,
                segment.kind.replace("_", " "),
                transform=axes.get_xaxis_transform(),
                ha="center",
                va="top",
                fontsize=8,
            )
    for place, (kind, record) in enumerate(records.items()):
        axes.plot(
            sequence.stamps_s,
            [r.inliers for r in record.results],
            color=_system_color(place),
            # All curves are equal up to the first breakage; the widest is drawn first.
            linewidth=1.2 + 1.4 * (len(records) - 1 - place),
            alpha=0.9 if place == len(records) - 1 else 0.5,
            label=kind,
        )
    axes.set_xlim(sequence.stamps_s[0], sequence.stamps_s[-1])
    # The few frames of an initialization have many more inliers and would flatten the curves.
    every = [r.inliers for record in records.values() for r in record.results]
    axes.set_ylim(0, 1.4 * max(1.0, float(np.percentile(every, 98))))
    axes.set_xlabel("s", fontsize=8)
    axes.set_ylabel("inliers", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=8, loc="lower left")


def _system_color(place: int) -> str:
    return _SYSTEM_COLORS[place % len(_SYSTEM_COLORS)]
