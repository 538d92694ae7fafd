"""A batch in the layout of the paper's Figures 6 to 9.

Source: Huang et al., "Dual-SLAM: A framework for robust single camera navigation", IROS 2020.
"""

from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from dslab.experiments.batch.paper_tables import short_name
from dslab.experiments.batch.rows import ERROR
from dslab.experiments.comparison.left_runs import read_run
from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.pictures.labels import label
from dslab.experiments.report.plots.draw import rendered
from dslab.experiments.report.plots.style import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    WIDE_IN,
    legend_above,
    new_figure,
    settings,
)
from dslab.experiments.result_folder import TRUTH_FILE
from dslab.sim.io.folders import subfolder

FIGURES_DIR = "figures"
MOST_SEQUENCES = 6
"""Sequences that Figures 6 to 8 show: those in which most trials fail come first."""
OTHER_DATA = "measured on other data than the paper's"
_COLOURS = (ORANGE, BLUE, GREEN, PURPLE, SKY)
_PARTS = {"no pose": "#ffffff", "another map": SKY, "posed later": GREEN, "tracked": BLUE}
_FAILED, _UNKNOWN = "#222222", "#d8d8d8"


def write_figures(rows: pd.DataFrame, folder: Path) -> list[Path]:
    """Draw the figures into a folder of the batch, as PNG and SVG; returns the PNG files.

    Args:
        rows: of :func:`experiments.batch.run.run_batch`.
        folder: of the batch, with the result folders of its runs.
    """
    made = rows[rows.ended != ERROR]
    drawings = {
        "figure_6": (draw_initialisation, (made,)),
        "figure_7": (draw_profiles, (made, folder)),
        "figure_8": (draw_overlays, (made, folder)),
        "figure_9": (draw_end_errors, (made,)),
    }
    place, written = subfolder(folder, FIGURES_DIR), []
    with settings():
        for name, (draw, arguments) in drawings.items():
            figure = draw(*arguments)
            if figure is None:
                continue
            written.append(rendered(name, "", figure).write(place))
    return written


def draw_initialisation(rows: pd.DataFrame) -> Figure | None:
    """Figure 6: frames, and seconds, up to the first pose, per trial; hatched where there is none."""
    sources, systems = _shown(rows), _systems(rows)
    if not sources:
        return None
    figure = new_figure(0.8 + 2.1 * len(sources), WIDE_IN)
    panels = np.ravel(figure.subplots(len(sources), 1, squeeze=False))
    for axes, source in zip(panels, sources, strict=True):
        own = rows[rows.source == source]
        trials = sorted(set(own.run))
        for place, system in enumerate(systems):
            of = own[own.system == system].set_index("run")
            frames = of.frames_to_initialise.reindex(trials).astype("Float64")
            height = frames.fillna(of.frames.reindex(trials)).to_numpy(float, na_value=np.nan)
            at = np.arange(len(trials)) + 0.8 * ((place + 0.5) / len(systems) - 0.5)
            drawn = axes.bar(at, height, 0.8 / len(systems), color=_colour(place))
            for bar, known in zip(drawn, frames.notna(), strict=True):
                if not known:
                    bar.set(fill=False, hatch="///", edgecolor=_colour(place))
        _add_seconds(axes, own)
        axes.set_xticks(range(len(trials)), [str(trial) for trial in trials], fontsize=8)
        axes.set_title(label(short_name(source)), fontsize=9, loc="left")
        axes.set_ylabel("frames", fontsize=9)
    panels[-1].set_xlabel("trial", fontsize=9)
    handles = [Patch(color=_colour(i), label=label(system)) for i, system in enumerate(systems)]
    handles.append(Patch(fill=False, hatch="///", label="no map"))
    return _marked(figure, handles, "Fig. 6, initialization")


def draw_profiles(rows: pd.DataFrame, folder: Path) -> Figure | None:
    """Figure 7: the frames of every trial that have a pose, upward; a panel per sequence and system."""
    figure, panels = _panels(rows, _systems(rows), sharey="row")
    for axes, own in panels:
        profiles = [_profile(folder, row) for row in own.itertuples()]
        image = np.zeros((max(1, *map(len, profiles), 1), max(len(profiles), 1)))
        for column, profile in enumerate(profiles):
            image[: len(profile), column] = profile
        axes.imshow(
            image, cmap=ListedColormap(list(_PARTS.values())), vmin=0, vmax=len(_PARTS) - 1, origin="lower",
            aspect="auto", interpolation="nearest",
        )  # fmt: skip
        for edge in range(1, len(profiles)):
            axes.axvline(edge - 0.5, color="#ffffff", linewidth=2)
        axes.set_xticks(range(len(profiles)), [str(run) for run in own.run], fontsize=8)
        axes.grid(visible=False)
        axes.set_xlabel("trial", fontsize=9)
        axes.set_ylabel("frame", fontsize=9)
        axes.label_outer()
    handles = [Patch(facecolor=c, edgecolor="#999999", label=name) for name, c in _PARTS.items()]
    return figure and _marked(figure, handles, "Fig. 7, profiles")


def draw_overlays(rows: pd.DataFrame, folder: Path) -> Figure | None:
    """Figure 8: the path of each system's first trial over the true one; what is lost stays blue."""
    has_truth = [pd.notna(place) and (folder / place / TRUTH_FILE).is_file() for place in rows.folder]
    figure, panels = _panels(rows[np.array(has_truth, bool)], _systems(rows))
    for axes, own in panels:
        if len(own):
            _draw_overlay(axes, folder / own.folder.iloc[0])
        axes.set_aspect("equal", adjustable="datalim")
        axes.tick_params(labelsize=7)
    handles = [Patch(color=BLUE, label="truth"), Patch(color=ORANGE, label="SLAM, first trial; metres")]
    return figure and _marked(figure, handles, "Fig. 8, paths")


def draw_end_errors(rows: pd.DataFrame) -> Figure | None:
    """Figure 9: error between start and end of every trial as a colour; a panel per system."""
    known = rows.end_alignment_m.dropna()
    if not len(known):
        return None
    systems, sources = _systems(rows), list(dict.fromkeys(rows.source))
    trials = sorted(set(rows.run))
    norm = LogNorm(max(float(known.min()), 1e-3), max(float(known.max()), 2e-3))
    figure = new_figure(1.2 + len(systems) * (0.7 + 0.12 * len(trials)), WIDE_IN)
    panels = np.ravel(figure.subplots(len(systems), 1, squeeze=False, sharex=True))
    image = None
    for axes, system in zip(panels, systems, strict=True):
        own = rows[rows.system == system].set_index(["run", "source"])
        cells = pd.MultiIndex.from_product([trials, sources])
        errors = own.end_alignment_m.reindex(cells).to_numpy(float, na_value=np.nan)
        intact = own.intact.reindex(cells).fillna(False).to_numpy(bool)
        shape = (len(trials), len(sources))
        # A trial that was not made is as unknown as one without truth.
        made = cells.isin(own.index)
        shade = np.where(made & ~intact, 0.0, 1.0).reshape(shape)
        axes.imshow(
            shade, cmap=ListedColormap([_FAILED, _UNKNOWN]), vmin=0, vmax=1, origin="lower", aspect="auto"
        )
        shown = np.ma.masked_invalid(np.where(intact, errors, np.nan).reshape(shape))
        image = axes.imshow(
            shown, norm=norm, cmap="viridis", origin="lower", aspect="auto", interpolation="nearest"
        )
        axes.set_title(label(system), fontsize=9, loc="left")
        axes.set_yticks(range(len(trials)), [str(trial) for trial in trials], fontsize=7)
        axes.set_ylabel("trial", fontsize=9)
        axes.grid(visible=False)
    names = [label(short_name(source)) for source in sources]
    panels[-1].set_xticks(range(len(sources)), names, rotation=90 if len(sources) > 6 else 0, fontsize=8)
    figure.colorbar(image, ax=list(panels), label="between start and end (m)")
    handles = [Patch(color=_FAILED, label="no intact map"), Patch(color=_UNKNOWN, label="not known")]
    return _marked(figure, handles, "Fig. 9, errors at the end")


# -- parts ---------------------------------------------------------------------------------------------------


def _systems(rows: pd.DataFrame) -> list[str]:
    return list(dict.fromkeys(rows.system))


def _shown(rows: pd.DataFrame) -> list[str]:
    """Sequences to show, those with most failed trials first."""
    failed = (~rows.intact.fillna(False)).groupby(rows.source, sort=False).sum()
    return failed.sort_values(ascending=False, kind="stable").index[:MOST_SEQUENCES].tolist()


def _panels(
    rows: pd.DataFrame, systems: list[str], **shared: Any
) -> tuple[Figure | None, list[tuple[Axes, pd.DataFrame]]]:
    """A named panel per sequence and system, with its trials in order; no figure without a sequence."""
    sources = _shown(rows)
    if not sources:
        return None, []
    figure = new_figure(0.8 + 2.3 * len(sources), WIDE_IN)
    grid = figure.subplots(len(sources), len(systems), squeeze=False, **shared)
    panels = []
    for (y, source), (x, system) in product(enumerate(sources), enumerate(systems)):
        own = rows[(rows.source == source) & (rows.system == system)].sort_values("run")
        names = [*([system] if y == 0 else []), *([short_name(source)] if x == 0 else [])]
        grid[y, x].set_title("\n".join(map(label, names)), fontsize=9, loc="left")
        panels.append((grid[y, x], own))
    return figure, panels


def _colour(place: int) -> str:
    return _COLOURS[place % len(_COLOURS)]


def _marked(figure: Figure, handles: list[Any], what: str) -> Figure:
    """Add the legend, and what the figure is after and what it is not."""
    legend_above(figure, handles, len(handles), WIDE_IN)
    figure.supxlabel(f"after {what}: {OTHER_DATA}", fontsize=8, color="#555555")
    return figure


def _add_seconds(axes: Axes, own: pd.DataFrame) -> None:
    """A second axis in seconds, by the frames and times of the trials."""
    known = own.dropna(subset=["frames_to_initialise", "time_to_initialise_s"])
    known = known[known.frames_to_initialise > 1]
    if len(known):
        steps = (known.frames_to_initialise - 1).astype(float)
        frame_s = float((known.time_to_initialise_s.astype(float) / steps).median())
        both_ways = partial(np.multiply, frame_s), partial(np.multiply, 1 / frame_s)
        seconds = axes.secondary_yaxis("right", functions=both_ways)
        seconds.set_ylabel("s", fontsize=9)


def _profile(folder: Path, row: Any) -> np.ndarray:
    """(frames,) index in _PARTS of every frame of a run; empty if its folder was removed."""
    place = folder / str(row.folder)
    if pd.isna(row.folder) or not (place / "frames.csv").is_file():
        return np.zeros(0, int)
    frames = pd.read_csv(place / "frames.csv")
    posed = np.isin(frames.stamp_s.round(6), np.round(_stamps_s(place / "trajectory.txt"), 6))
    tracked = (frames.state == "tracking").to_numpy(bool)
    parts = list(_PARTS)
    named = np.select([posed & tracked, posed, tracked], ["tracked", "posed later", "another map"], "no pose")
    skipped = 0 if pd.isna(row.first_frame) else int(row.first_frame)
    return np.concatenate([np.zeros(skipped, int), [parts.index(name) for name in named]]).astype(int)


def _stamps_s(path: Path) -> np.ndarray:
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    return np.array([float(line.split()[0]) for line in lines if line and not line.startswith("#")])


def _draw_overlay(axes: Axes, place: Path) -> None:
    run = read_run(place)
    truth = run.T_world_cam[:, :3, 3]
    ground = np.sort(np.argsort(np.nanmax(truth, axis=0) - np.nanmin(truth, axis=0))[1:])
    axes.plot(*truth[:, ground].T, color=BLUE, linewidth=2.4)
    ate = metrics.ate(run.pairs) if len(run.pairs) else Undefined("no pose")
    if isinstance(ate, Undefined):
        return
    aligned = np.full((len(truth), 3), np.nan)
    aligned[run.pairs.frames] = ate.alignment.points(run.pairs.T_map_cam[:, :3, 3])
    axes.plot(*aligned[:, ground].T, color=ORANGE, linewidth=1.8)
