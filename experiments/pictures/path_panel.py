"""Path of a run from above, over the truth where it is known."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from dslab.experiments.evaluation.breakages import BreakageOutcome
from dslab.experiments.evaluation.frame_outcomes import FrameOutcome
from dslab.experiments.evaluation.scene import Scene
from dslab.experiments.pictures import palette
from dslab.experiments.runs.execution import RunRecord


@dataclass(frozen=True)
class DrawnRun:
    """A run with all that its picture shows of it.

    Attributes:
        name: of the system, as a label.
        color: of its path and curve.
        scene: its maps, aligned with the truth for display.
        outcomes: of its breakages.
        frames: outcome of every frame.
    """

    name: str
    color: str
    record: RunRecord
    scene: Scene
    outcomes: list[BreakageOutcome]
    frames: list[FrameOutcome]


def draw_path(axes: Axes, run: DrawnRun, segment_colors: dict[str, str]) -> None:
    """Draw the paths of a run, with its segments, breakages and repairs.

    Marks lie on the true path. Without truth they lie on that of the map with most frames, which alone is
    drawn then, since every map has a frame of its own.
    """
    ground = [i for i in range(3) if run.scene.up[i] == 0]
    truth = run.scene.T_world_cam
    paths = {map_id: _positions(run, map_id)[:, ground] for map_id in run.scene.final}
    if truth is None:
        paths = dict(list(paths.items())[:1])
    place = truth[:, ground, 3] if truth is not None else next(iter(paths.values()), None)
    if place is not None:
        _draw_segments(axes, run.record, place, segment_colors)
    if truth is not None and place is not None:
        axes.plot(*place.T, color=palette.TRUTH, linewidth=4, label="truth", zorder=1)
    recovered = np.array([outcome is FrameOutcome.RECOVERED for outcome in run.frames], bool)
    for rank, path in enumerate(paths.values()):
        label, line = (run.name, "-") if rank == 0 else ("map that was not fused", ":")
        axes.plot(*path.T, line, color=run.color, label=label, linewidth=1.8, zorder=3)
        part = np.where(recovered[:, None], path, np.nan)
        if np.isfinite(part).any():
            axes.plot(
                *part.T, line, color=palette.RECOVERED, label="placed by recovery", linewidth=3.5, zorder=3
            )
    if place is not None:
        _mark(axes, place, run.outcomes)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set_title(_headline(run), fontsize=9)
    axes.set_xlabel(_unit(run, len(paths)), fontsize=8)
    axes.tick_params(labelsize=8)


def _positions(run: DrawnRun, map_id: int) -> np.ndarray:
    """(frames, 3) positions of a map, NaN where a frame has none."""
    trajectory = run.scene.final[map_id]
    position = np.full((len(run.record.results), 3), np.nan)
    position[trajectory.frames] = trajectory.T_map_cam[:, :3, 3]
    return position


def _draw_segments(axes: Axes, record: RunRecord, place: np.ndarray, colors: dict[str, str]) -> None:
    for segment in record.sequence.segments:
        if segment.first_frame >= 0:
            inside = place[segment.first_frame : segment.last_frame + 1]
            axes.plot(*inside.T, color=colors[segment.kind], linewidth=10, solid_capstyle="butt", zorder=0)


def _mark(axes: Axes, place: np.ndarray, outcomes: list[BreakageOutcome]) -> None:
    """Mark breakages and repairs at the last known place up to their frames."""
    known = np.isfinite(place).all(axis=1)
    latest = np.maximum.accumulate(np.where(known, np.arange(len(place)), -1))
    marks = {
        "breakage": ([o.breakage.frame for o in outcomes], "x", palette.BREAKAGE, 9),
        "recovered, maps fused": ([o.fusion.frame for o in outcomes if o.recovered and o.fusion], "o", "", 8),
        "relocalized": ([o.relocalized.frame for o in outcomes if o.relocalized], "D", "", 6),
        "merged by place": ([o.joined.frame for o in outcomes if o.joined], "s", "", 7),
    }
    for label, (frames, marker, color, size) in marks.items():
        found = [latest[frame] for frame in frames if latest[frame] >= 0]
        if found:
            style = {
                "color": color or palette.HEALED,
                "markersize": size,
                "markeredgewidth": 2 if color else 1,
            }
            axes.plot(*place[found].T, marker, label=label, zorder=5, **style)


def _headline(run: DrawnRun) -> str:
    posed = sum(outcome is not FrameOutcome.NONE for outcome in run.frames) / max(1, len(run.frames))
    count = len(run.outcomes)
    maps = len(run.record.trajectories)
    where = f" in one of {maps} maps" if maps > 1 else ""
    lines = [run.name, f"{posed:.1%} of the frames have a pose{where}"]
    if count:
        repairs = {
            "recovered": sum(o.recovered for o in run.outcomes),
            "relocalized": sum(o.relocalized is not None for o in run.outcomes),
            "merged by place": sum(o.joined is not None for o in run.outcomes),
        }
        done = ", ".join(f"{number} {how}" for how, number in repairs.items() if number) or "none repaired"
        lines.append(f"{count} breakage{'' if count == 1 else 's'}: {done}")
    else:
        lines.append("no breakage")
    return "\n".join(lines)


def _unit(run: DrawnRun, drawn: int) -> str:
    hidden = len(run.record.trajectories) - drawn
    maps = "map" if hidden == 1 else "maps"
    if run.scene.T_world_cam is None:
        others = f"; {hidden} smaller {maps}, each in a frame of its own, not drawn" if hidden else ""
        return f"no truth: units of the map{others}"
    return f"m; {hidden} {maps} not drawn, too small to align" if hidden else "m"
