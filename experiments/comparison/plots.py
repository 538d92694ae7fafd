"""Plots of a comparison: paths, errors over time, shares of the path within a threshold, stages."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dslab.experiments.evaluation.robustness import LEAST, MOST
from dslab.experiments.pictures.labels import label
from dslab.experiments.pictures.palette import TRUTH, system_color
from dslab.experiments.report.plots.style import (
    NARROW_IN,
    columns_that_fit,
    legend_above,
    log_ticks,
    new_figure,
    percent_axis,
)

_LINES = ("-", "--", "-.", ":")


def draw_paths(sequence: dict[str, Any], width_in: float) -> Figure:
    """Draw the path of every system over the true one, in the plane in which that extends most."""
    figure = new_figure(width_in * 0.7, width_in)
    axes = figure.subplots()
    truth = np.asarray(sequence["truth"], float)
    ground = np.sort(np.argsort(np.nanmax(truth, axis=0) - np.nanmin(truth, axis=0))[1:])
    axes.plot(*truth[:, ground].T, color=TRUTH, linewidth=4, zorder=1)
    for place, (system, line, colour) in enumerate(_lines(sequence)):
        path = np.asarray(system["positions"], float)[:, ground]
        axes.plot(*path.T, line, color=colour, linewidth=1.6, zorder=2 + place)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{'xyz'[ground[0]]}, m", ylabel=f"{'xyz'[ground[1]]}, m")
    handles = [Line2D([], [], color=TRUTH, linewidth=4, label="truth"), *_legend(sequence)]
    legend_above(figure, handles, columns_that_fit(handles, width_in), width_in)
    return figure


def draw_errors(sequence: dict[str, Any], width_in: float) -> Figure:
    """Draw the position error of every system over time; a line ends where there is no pose."""
    figure, axes = _panel(width_in)
    for system, line, colour in _lines(sequence):
        errors = np.maximum(np.asarray(system["errors_m"], float), 1e-6)
        axes.plot(system["time_s"], errors, line, color=colour, linewidth=1.4)
    axes.set_yscale("log")
    axes.set(xlabel="time, s", ylabel="position error, m")
    handles = _legend(sequence)
    legend_above(figure, handles, columns_that_fit(handles, width_in), width_in)
    return figure


def draw_within(sequence: dict[str, Any], width_in: float, thresholds: np.ndarray) -> Figure:
    """Draw the share of the path within each error threshold; robustness is the mean over the shaded part."""
    figure, axes = _panel(width_in)
    axes.axvspan(LEAST, MOST, color="#eef2f6", zorder=0)
    for system, line, colour in _lines(sequence):
        axes.plot(thresholds, system["within"], line, color=colour, linewidth=1.6)
    axes.set_xscale("log")
    log_ticks(axes.xaxis, thresholds[0], thresholds[-1])
    percent_axis(axes.xaxis)
    percent_axis(axes.yaxis)
    axes.set(ylim=(0, 1.02), xlabel="position error over the length of the path", ylabel="of the path within")
    handles = _legend(sequence)
    legend_above(figure, handles, columns_that_fit(handles, width_in), width_in)
    return figure


def draw_stages(sequence: dict[str, Any], width_in: float) -> Figure:
    """Draw the median CPU time of every stage, a stacked bar per system."""
    systems = sequence["systems"]
    stages = list(dict.fromkeys(stage for system in systems for stage in system["stages"]))
    figure = new_figure(0.9 + 0.45 * len(systems), width_in)
    axes, left, rows = figure.subplots(), np.zeros(len(systems)), np.arange(len(systems))
    shades = np.linspace(0.25, 0.85, max(2, len(stages)))
    for stage, shade in zip(stages, shades, strict=False):
        times = np.array([system["stages"].get(stage) or 0.0 for system in systems])
        axes.barh(
            rows, times, left=left, color=str(shade), edgecolor="white", label=label(stage.replace("_", " "))
        )
        left += times
    axes.set_yticks(rows, [label(system["name"]) for system in systems])
    axes.invert_yaxis()
    axes.set_xlabel("CPU, ms per frame")
    legend_above(figure, axes.get_legend_handles_labels()[0], 5, width_in)
    return figure


def _panel(width_in: float) -> tuple[Figure, Axes]:
    figure = new_figure(3.0 if width_in > NARROW_IN else 2.8, width_in)
    return figure, figure.subplots()


def _lines(sequence: dict[str, Any]) -> list[tuple[dict[str, Any], str, str]]:
    """Every system with its line and colour."""
    return [
        (system, _LINES[place % 4], system_color(system["name"], place))
        for place, system in enumerate(sequence["systems"])
    ]


def _legend(sequence: dict[str, Any]) -> list[Line2D]:
    return [
        Line2D([], [], color=colour, linestyle=line, label=label(system["name"]))
        for system, line, colour in _lines(sequence)
    ]
