"""Figures of pairs of views: errors of the pose over baseline and parallax, beside the Cramér-Rao bound.

A world has one value, the median of its pairs; figures are medians over worlds.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from dslab.experiments.claims import ransac_figures
from dslab.experiments.claims.two_view import TwoViewSpec
from dslab.experiments.claims.world_medians import draw_over, over_worlds, shown
from dslab.experiments.report.plots.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    legend_above,
    legend_mark,
    panels,
    plain_ticks,
)
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.world_intervals import ratio_interval

_ERRORS = {"direction_deg": "direction (deg)", "rotation_deg": "rotation (deg)", "depth": "depth (relative)"}
_BOUNDS = {"direction_deg": "bound_direction_deg", "rotation_deg": "bound_rotation_deg"}
_ESTIMATES = ("", "_refined", "_from_truth")
_OVER = {"baseline_m": "true baseline (m)", "parallax_deg": "median parallax (deg)"}
_ENOUGH_RIGHT = 50
"""Right matches of the pairs of a slope: with fewer, a pose is bad for another reason than its baseline."""
_COLOURS = (BLUE, ORANGE, GREEN, PURPLE)
_NOTE = (
    "the bound is the median error of an efficient unbiased estimator with the right matches of the pair, "
    "at the noise of their keypoints, which is measured from their true reprojection errors"
)


def figures(spec: TwoViewSpec, table: pd.DataFrame) -> dict[str, Any]:
    """The figures of a spec's table, by its estimator."""
    return ransac_figures.figures(spec, table) if spec.iterations else conditioning(spec, table)


def draw(spec: TwoViewSpec, found: dict[str, Any], width_in: float) -> Drawing:
    """Draw the figures of a spec."""
    return (ransac_figures.draw if spec.iterations else draw_conditioning)(spec, found, width_in)


def conditioning(spec: TwoViewSpec, table: pd.DataFrame) -> dict[str, Any]:
    """Errors by gap and by bin of parallax, their ratios to the bound, and slopes, each by scene."""
    table = table.assign(**_ratios(table))
    edges = spec.parallax_edges_deg
    bins = pd.cut(table["parallax_deg"], list(edges), labels=False)
    slopes = [
        {"scene": scene, "error": error, "over": over, **_slope(of_scene, error, over)}
        for scene in spec.cells
        for of_scene in [table[table["scene"] == scene]]
        for error in _ERRORS
        for over in _OVER
    ]
    by_parallax = [
        {"from_deg": edges[int(bin_)], "to_deg": edges[int(bin_) + 1], **row}
        for bin_, rows in table.groupby(bins)
        for row in _by_scene(spec, rows)
    ]
    by_gap = [{"gap": gap, **row} for gap, rows in table.groupby("gap") for row in _by_scene(spec, rows)]
    found = {"note": _NOTE, "by_gap": by_gap, "by_parallax": by_parallax, "slopes": slopes}
    return found | {"answer": [_shown(by_gap), *_told(slopes), _NOTE]}


def _ratios(table: pd.DataFrame) -> dict[str, Any]:
    return {
        f"{error}{suffix}_of_bound": table[f"{error}{suffix}"] / table[bound]
        for error, bound in _BOUNDS.items()
        for suffix in _ESTIMATES
    }


def _by_scene(spec: TwoViewSpec, rows: pd.DataFrame) -> Iterator[dict[str, Any]]:
    names = [f"{error}{suffix}" for error in _ERRORS for suffix in _ESTIMATES]
    names += [*_BOUNDS.values(), "depth_true_pose", "noise_px", "right", "off_plane"]
    for scene in spec.cells:
        of_scene = rows[rows["scene"] == scene]
        own = of_scene.dropna(subset=["direction_deg"])
        if len(own):
            yield {
                "scene": scene,
                "worlds": int(own["world"].nunique()),
                "pairs": len(own),
                "without_pose": len(of_scene) - len(own),
                **{over: float(own[over].median()) for over in _OVER},
                **{name: over_worlds(own, name) for name in [*names, *_ratios(own)]},
            }


def _slope(rows: pd.DataFrame, error: str, over: str) -> dict[str, Any]:
    """Least-squares slope of log error on log distance within worlds, which so have levels of their own."""
    fit = rows[(rows["right"] >= _ENOUGH_RIGHT) & (rows[error] > 0) & (rows[over] > 0)]
    logs = np.log(fit[[over, error]].astype(float)).assign(world=fit["world"])
    apart = logs[[over, error]] - logs.groupby("world")[[over, error]].transform("mean")
    sums = pd.DataFrame({"xy": apart[over] * apart[error], "xx": apart[over] ** 2})
    by_world = sums.groupby(fit["world"]).mean()
    if len(by_world) < 2:
        return {"slope": None, "worlds": len(by_world)}
    slope = ratio_interval(*(Figure.mean(by_world[name].to_numpy()) for name in ("xy", "xx")))
    return {"slope": slope and vars(slope), "worlds": len(by_world)}


def _shown(by_gap: Sequence[dict[str, Any]]) -> list[dict[str, str]]:
    """The table that is printed."""
    return [
        {
            "scene": row["scene"],
            "base-\nline m": f"{row['baseline_m']:.2f}",
            "paral-\nlax deg": f"{row['parallax_deg']:.2f}",
            "direction deg": shown(row["direction_deg"]),
            "bound": shown(row["bound_direction_deg"], ends=False),
            "over\nbound": shown(row["direction_deg_of_bound"], ends=False),
            "refi-\nned": shown(row["direction_deg_refined_of_bound"], ends=False),
            "from\ntruth": shown(row["direction_deg_from_truth_of_bound"], ends=False),
            "rotation\ndeg": shown(row["rotation_deg"], ends=False),
            "depth": shown(row["depth"], ends=False),
        }
        for row in sorted(by_gap, key=lambda row: row["scene"])
    ]


def _told(slopes: Sequence[dict[str, Any]]) -> Iterator[str]:
    for row in slopes:
        if row["over"] == "baseline_m" and row["slope"]:
            yield (
                f"{row['scene']}: the error of {row['error'].partition('_')[0]} goes with the baseline "
                f"to the power {shown(row['slope'])}, {row['worlds']} worlds"
            )


def draw_conditioning(spec: TwoViewSpec, found: dict[str, Any], width_in: float) -> Drawing:
    """Draw errors over baseline and over parallax, log-log, dashed the bound; then error over bound."""
    places = [(error, over) for over in _OVER for error in _ERRORS]
    ratios = [(error, "baseline_m") for error in _BOUNDS]
    figure, axes = panels(len(places) + len(ratios), 3, width_in, 2.6, 0.5)
    for place, (error, over) in zip(axes, places, strict=False):
        rows = found["by_gap" if over == "baseline_m" else "by_parallax"]
        for scene, colour in zip(spec.cells, _COLOURS, strict=False):
            own = [row for row in rows if row["scene"] == scene]
            _draw_line(place, own, over, error, colour, "-", "o")
            if error in _BOUNDS:
                _draw_line(place, own, over, _BOUNDS[error], colour, "--", "")
        _set_up(place, over, f"error of {_ERRORS[error]}")
    for place, (error, over) in zip(axes[len(places) :], ratios, strict=True):
        for scene, colour in zip(spec.cells, _COLOURS, strict=False):
            own = [row for row in found["by_gap"] if row["scene"] == scene]
            _draw_line(place, own, over, f"{error}_of_bound", colour, "-", "o")
            _draw_line(place, own, over, f"{error}_from_truth_of_bound", colour, ":", "s")
        place.axhline(1, color=GREY, linewidth=1)
        _set_up(place, over, f"{error.partition('_')[0]}: error over bound")
    marks = [legend_mark(colour, scene) for scene, colour in zip(spec.cells, _COLOURS, strict=False)]
    marks += [legend_mark(GREY, "dashed: bound", ""), legend_mark(GREY, "dotted: from the truth", "s")]
    for mark, style in zip(marks[-2:], ("--", ":"), strict=True):
        mark.set_linestyle(style)
    legend_above(figure, marks, 6, width_in)
    return figure


def _draw_line(
    axes: Axes, rows: Sequence[dict[str, Any]], over: str, name: str, colour: str, line: str, mark: str
) -> None:
    points = [(row[over], row[name]) for row in rows if row[name] and row[name]["value"]]
    draw_over(axes, points, colour, line, mark, ends=line == "-")


def _set_up(axes: Axes, over: str, title: str) -> None:
    axes.set(xscale="log", yscale="log")
    axes.set_title(title, fontsize=9)
    axes.set_xlabel(_OVER[over], fontsize=8)
    axes.tick_params(labelsize=8)
    plain_ticks(axes.xaxis)
    plain_ticks(axes.yaxis)
