"""Plots of variants: differences as a forest, lines over a setting, histograms, dots of worlds."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from dslab.experiments.claims.variants.figures import MIDDLE, POOLED
from dslab.experiments.claims.variants.quantities import QUANTITIES
from dslab.experiments.claims.variants.spec import VariantsSpec
from dslab.experiments.pictures.labels import label
from dslab.experiments.report.plots.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PALE,
    PURPLE,
    SKY,
    bars,
    columns_that_fit,
    legend_above,
    legend_mark,
    panels,
    percent_axis,
    plain_ticks,
    settings,
    wrapped,
)
from dslab.experiments.statistics.verdicts import LEVEL

Data = dict[str, Any]
_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY)
_MARKS = "osD^v<>P"
_ROW_IN, _HEADING_IN = 0.19, 0.75
_BINS = 20
"""Of a histogram: each is 5 % of the path."""


def draw(spec: VariantsSpec, figures: Data, width_in: float) -> Figure:
    """The plot that the spec names."""
    with settings():
        return _PLOTS[spec.plot](spec, figures, width_in)


def _forest(spec: VariantsSpec, figures: Data, width_in: float) -> Figure:
    """A panel per measure, a row per contrast: the pooled difference, and those of the conditions as dots."""
    rows = list(dict.fromkeys((row["variant"], row["against"]) for row in figures["contrasts"]))
    height_in = 0.6 + _ROW_IN * len(rows)
    figure, axes = panels(len(spec.measures), 4, width_in, height_in, _HEADING_IN, sharey=True)
    colours = dict(zip(figures["conditions"], _COLOURS * len(figures["conditions"]), strict=False))
    for measure, own in zip(spec.measures, axes, strict=True):
        for row in figures["contrasts"]:
            if row["measure"] == measure and row["value"] is not None:
                _draw_difference(own, row, -rows.index((row["variant"], row["against"])), colours)
        own.axvline(0, color=GREY, linewidth=0.8)
        own.set_title(wrapped(_heading(measure), width_in / len(spec.measures)), fontsize=8)
        own.tick_params(axis="x", labelsize=7)
        if QUANTITIES[measure].is_share:
            percent_axis(own.xaxis)
        elif QUANTITIES[measure].is_log:
            own.xaxis.set_major_formatter(lambda value, _: f"×{np.exp(value):.2g}")
        names = [variant if len({a for _, a in rows}) == 1 else f"{variant} – {a}" for variant, a in rows]
        own.set_yticks([-place for place in range(len(rows))], [label(name) for name in names], fontsize=7)
        own.set_ylim(-len(rows) + 0.4, 0.6)
    marks = [legend_mark(colour, name, ".") for name, colour in colours.items()]
    told = legend_mark("black", f"all conditions, told from 0 (p ≤ {LEVEL:g} by Holm)")
    marks += [told, legend_mark(PALE, "all conditions, not told")]
    legend_above(figure, marks, columns_that_fit(marks, width_in), width_in)
    return figure


def _draw_difference(axes: Axes, row: Data, at: float, colours: dict[str, str]) -> None:
    if row["condition"] != POOLED:
        place = list(colours).index(row["condition"]) - (len(colours) - 1) / 2
        axes.plot(row["value"], at - 0.18 * place, ".", color=colours[row["condition"]], markersize=4)
        return
    colour = "black" if row["p"] is not None and row["p"] <= LEVEL else PALE
    ends = None if row["low"] is None else bars(row["value"], row["low"], row["high"])
    axes.errorbar(row["value"], at, xerr=ends, fmt="o", color=colour, markersize=4, elinewidth=1.2)


def _heading(measure: str) -> str:
    quantity = QUANTITIES[measure]
    return f"{quantity.label}: ratio" if quantity.is_log else quantity.label


def _lines(spec: VariantsSpec, figures: Data, width_in: float) -> Figure:
    """A panel per measure over the setting: a line per system and condition."""
    lines = list(dict.fromkeys((row["system"], row["condition"]) for row in figures["estimates"]))
    figure, axes = panels(len(spec.measures), 3, width_in, 2.5, _HEADING_IN)
    systems = list(dict.fromkeys(system for system, _ in lines))
    styles = dict(zip(figures["conditions"], ["-", "--", ":", "-."] * len(lines), strict=False))
    for measure, own in zip(spec.measures, axes, strict=True):
        for place, (system, condition) in enumerate(lines):
            keys = {"measure": measure, "system": system, "condition": condition}
            points = [row for row in figures["estimates"] if all(row[key] == keys[key] for key in keys)]
            points.sort(key=lambda row: row["at"])
            at = np.array([row["at"] for row in points]) * 1.03 ** (place - (len(lines) - 1) / 2)
            value, low, high = (
                np.array([row[end] for row in points], float) for end in ("value", "low", "high")
            )  # without an end NaN, and no bar
            colour = _COLOURS[systems.index(system) % len(_COLOURS)]
            form = {"color": colour, "linestyle": styles[condition], "linewidth": 1.2, "elinewidth": 0.8}
            own.errorbar(at, value, yerr=[value - low, high - value], fmt="o", markersize=3.5, **form)
        own.set_xscale("log")
        ticks = sorted({variant.at for variant in spec.variants if variant.at is not None})
        own.set_xticks(ticks)
        own.xaxis.set_minor_locator(NullLocator())
        plain_ticks(own.xaxis)
        own.set_xlabel(label(spec.axis), fontsize=8)
        own.set_title(wrapped(QUANTITIES[measure].label, width_in / 3), fontsize=8)
        own.tick_params(labelsize=8)
        own.set_ylim(bottom=0)
        if QUANTITIES[measure].is_share:
            own.set_ylim(-0.03, 1.03)
            percent_axis(own.yaxis)
    marks = [legend_mark(_COLOURS[systems.index(s) % len(_COLOURS)], f"{s}, {c}") for s, c in lines]
    for mark, (_, condition) in zip(marks, lines, strict=True):
        mark.set_linestyle(styles[condition])
    legend_above(figure, marks, columns_that_fit(marks, width_in), width_in)
    return figure


def _histogram(spec: VariantsSpec, figures: Data, width_in: float) -> Figure:
    """A row per variant: how much of the path its runs cover, and their ATE."""
    figure, axes = panels(2 * len(spec.variants), 2, width_in, 2.3, _HEADING_IN)
    for place, variant in enumerate(spec.variants):
        covered, error = axes[2 * place : 2 * place + 2]
        bins = np.linspace(0, 1, _BINS + 1)
        covered.axvspan(*MIDDLE, color=SKY, alpha=0.18, linewidth=0)
        covered.hist(_all(figures, variant.name, "path_share"), bins, color=BLUE)
        onsets = _all(figures, variant.name, "onset_share")
        covered.hist(onsets, bins, histtype="step", color=ORANGE, linewidth=1.2)
        percent_axis(covered.xaxis)
        covered.set_xlabel("share of the path in the largest map", fontsize=8)
        errors = _all(figures, variant.name, "ate_share")
        error.hist(np.clip(errors, 1e-4, 1), np.geomspace(1e-4, 1, 25), color=BLUE)
        error.set_xscale("log")
        percent_axis(error.xaxis)
        error.set_xlabel("ATE over the path that it covers", fontsize=8)
        for own in (covered, error):
            own.set_title(label(variant.name), fontsize=9)
            own.tick_params(labelsize=8)
            own.set_ylabel("runs", fontsize=8)
    marks = [legend_mark(BLUE, "runs", "s"), legend_mark(ORANGE, "where their stress began", "_")]
    legend_above(figure, [*marks, legend_mark(SKY, "between 60 and 95 %", "s")], 3, width_in)
    return figure


def _dots(spec: VariantsSpec, figures: Data, width_in: float) -> Figure:
    """A panel per measure and condition: a dot per world, and the median with its interval."""
    conditions = figures["conditions"]
    height_in = 0.75 + 0.28 * len(spec.variants)
    count = len(spec.measures) * len(conditions)
    figure, axes = panels(count, len(conditions), width_in, height_in, 0.1)
    places = [(measure, condition) for measure in spec.measures for condition in conditions]
    for (measure, condition), own in zip(places, axes, strict=True):
        for place, variant in enumerate(spec.variants):
            keys = {"variant": variant.name, "condition": condition, "measure": measure}
            _draw_dots(
                own, figures, keys, -place, _COLOURS[place % len(_COLOURS)], _MARKS[place % len(_MARKS)]
            )
        own.set_yticks(
            [-place for place in range(len(spec.variants))],
            [label(variant.name) for variant in spec.variants],
            fontsize=8,
        )
        own.set_ylim(-len(spec.variants) + 0.4, 0.6)
        own.set_xlim(left=0)
        own.tick_params(axis="x", labelsize=7)
        own.set_xlabel(QUANTITIES[measure].label, fontsize=8)
        own.set_title(label(condition), fontsize=8)
    return figure


def _draw_dots(axes: Axes, figures: Data, keys: Data, at: float, colour: str, mark: str) -> None:
    found = next(row for row in figures["values"] if all(row[key] == keys[key] for key in keys))
    values = found["values"]
    scatter = 0.22 * np.sin(2.4 * np.arange(len(values)))  # apart, and the same in every drawing
    axes.plot(values, at + scatter, mark, color=colour, markersize=2.5, alpha=0.5, linewidth=0)
    middle = next((row for row in figures["estimates"] if all(row[key] == keys[key] for key in keys)), None)
    if middle is not None:
        ends = None if middle["low"] is None else bars(middle["value"], middle["low"], middle["high"])
        axes.errorbar(middle["value"], at, xerr=ends, fmt="|", color="black", markersize=9, elinewidth=1.2)
    if found["never"]:
        axes.annotate(
            f"none: {found['never']}",
            (1.0, at + 0.25),
            xycoords=("axes fraction", "data"),
            ha="right",
            fontsize=6,
        )


def _all(figures: Data, variant: str, measure: str) -> list[float]:
    rows = (row for row in figures["values"] if (row["variant"], row["measure"]) == (variant, measure))
    return [value for row in rows for value in row["values"]]


_PLOTS: dict[str, Callable[[VariantsSpec, Data, float], Figure]] = {
    "forest": _forest,
    "lines": _lines,
    "histogram": _histogram,
    "dots": _dots,
}
