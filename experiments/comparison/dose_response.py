"""Systems against the dose of a stress: a table of points, and their plot."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dslab.experiments.pictures.labels import label
from dslab.experiments.pictures.palette import system_color
from dslab.experiments.report.conditions import axis_label
from dslab.experiments.report.plots.style import (
    NARROW_IN,
    bars,
    columns_that_fit,
    legend_above,
    log_ticks,
    panels,
    percent_axis,
    plain_ticks,
)
from dslab.experiments.statistics.spreads import Bounds, Spread, spread_of
from dslab.experiments.statistics.world_intervals import FEW
from dslab.scenarios.describe import describe_kind

DOSE_FIGURES: dict[str, tuple[str, Bounds]] = {
    "broke": ("runs that break", "event"),
    "failed": ("runs without an intact map", "event"),
    "completeness": ("completeness", "share"),
    "ate_m": ("ATE, m", "amount"),
}
"""Figures of a dose–response: their titles and bounds."""
_MARKS = "osD^vP"
_ROOM = 0.06
"""Of the axis, between the marks of the systems at one dose."""


def dose_response(runs: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Sum up runs per system and dose.

    The sample is the sequences where there are five or more, whose runs count as one, else the runs.

    Args:
        runs: with ``sequence`` (any that tells sequences apart), ``dose``, ``system``, ``declares``,
            ``breakages``, ``intact``, ``completeness`` and ``ate_m``; a figure may be None.

    Returns:
        Per system and dose: ``system``, ``dose``, number of ``sequences`` and ``runs``, and the ``Spread`` of
        every figure of DOSE_FIGURES; ``broke`` is of systems that declare something.
    """
    table = pd.DataFrame(list(map(_figures, runs)))
    if table.empty:
        return []
    found = []
    for _, own in table.groupby(["system", "dose"], sort=False):
        spreads = {name: asdict(_spread(own, name, of)) for name, (_, of) in DOSE_FIGURES.items()}
        counts = {"sequences": own.sequence.nunique(), "runs": len(own)}
        about = {"system": own.system.iloc[0], "dose": float(own.dose.iloc[0])}
        found.append(about | counts | spreads)
    order = {name: place for place, name in enumerate(dict.fromkeys(table.system))}
    return sorted(found, key=lambda point: (order[point["system"]], point["dose"]))


def dose_table(points: list[dict[str, Any]]) -> pd.DataFrame:
    """The points as a flat table: ``completeness``, ``completeness_low``, ``completeness_high`` and so on."""
    rows = []
    for point in points:
        row = {name: value for name, value in point.items() if name not in DOSE_FIGURES}
        for name in DOSE_FIGURES:
            ends = {f"{name}_{end}": point[name][end] for end in ("low", "high")}
            row |= {name: point[name]["mean"]} | ends
        rows.append(row)
    return pd.DataFrame(rows)


def dose_title(kind: str, field: str) -> str:
    """Title of the axis of a dose: ``motion blur, exposure (s)``."""
    return f"{describe_kind(kind)}, {axis_label(field)}"


def draw_dose_response(points: list[dict[str, Any]], axis: str, width_in: float) -> Figure:
    """Draw every figure against the dose, a line with 95 % intervals per system."""
    systems = list(dict.fromkeys(point["system"] for point in points))
    figure, places = panels(len(DOSE_FIGURES), 2, width_in, 2.2, 0.9, sharex=True)
    doses = sorted({point["dose"] for point in points})
    for axes, (name, (title, bounds)) in zip(places, DOSE_FIGURES.items(), strict=True):
        is_log = _set_axis(axes, doses)
        for place, system in enumerate(systems):
            known = [p for p in points if p["system"] == system and p[name]["mean"] is not None]
            shift = _ROOM * (place - (len(systems) - 1) / 2)
            at = [_moved(p["dose"], shift, doses, is_log) for p in known]
            colour, mark = system_color(system, place), _MARKS[place % len(_MARKS)]
            axes.plot(at, [p[name]["mean"] for p in known], color=colour, linewidth=1, alpha=0.6)
            for x, point in zip(at, known, strict=True):
                _mark(axes, x, point[name], colour, mark)
        axes.set_title(title, fontsize=9, loc="left")
        axes.tick_params(labelsize=8, labelbottom=True)
        if bounds == "amount":
            axes.set_ylim(bottom=0)
        else:
            axes.set_ylim(-0.04, 1.04)
            percent_axis(axes.yaxis)
    between = "; " if width_in > NARROW_IN else "\n"
    figure.supxlabel(label(f"{axis}{between}bars: 95 % over {_sample(points)}"), fontsize=9)
    handles = [
        Line2D([], [], color=system_color(s, i), marker=_MARKS[i % len(_MARKS)], label=label(s))
        for i, s in enumerate(systems)
    ]
    legend_above(figure, handles, columns_that_fit(handles, width_in), width_in)
    return figure


def _figures(run: Mapping[str, Any]) -> dict[str, Any]:
    broke = run["breakages"] if run["declares"] != "nothing" else None
    intact = run["intact"]
    return {name: run[name] for name in ("sequence", "dose", "system", "completeness", "ate_m")} | {
        "broke": None if broke is None else float(broke > 0),
        "failed": None if intact is None else float(not intact),
    }


def _spread(own: pd.DataFrame, name: str, bounds: Bounds) -> Spread:
    values = own[name].astype(float)
    by_sequence = values.groupby(own.sequence).mean()
    return spread_of(by_sequence if len(by_sequence) >= FEW else values, bounds)


def _sample(points: list[dict[str, Any]]) -> str:
    sequences = max(point["sequences"] for point in points)
    runs = sorted({point["runs"] for point in points})
    counted = f"{runs[0]}" if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"
    if sequences >= FEW:
        return f"{sequences} sequences"
    return f"{counted} runs" + (f" of {sequences} sequences" if sequences > 1 else "")


def _set_axis(axes: Axes, doses: list[float]) -> bool:
    """Set the axis of the doses up; returns True if it is logarithmic."""
    is_log = doses[0] > 0 and doses[-1] >= 8 * doses[0]
    if is_log:
        axes.set_xscale("log")
        log_ticks(axes.xaxis, doses[0], doses[-1])
    if len(doses) <= 6:
        axes.set_xticks(doses)
    plain_ticks(axes.xaxis)
    return is_log


def _moved(dose: float, shift: float, doses: list[float], is_log: bool) -> float:
    """A dose, moved by a share of the distance between neighbours, so that no mark hides another."""
    steps = np.diff(np.log(doses) if is_log else doses)
    step = float(steps.min()) if len(steps) else 1.0
    return float(dose * np.exp(2 * shift * step)) if is_log else dose + 2 * shift * step


def _mark(axes: Axes, x: float, spread: dict[str, Any], colour: str, mark: str) -> None:
    has_bars = spread["low"] is not None
    ends = bars(spread["mean"], spread["low"], spread["high"]) if has_bars else None
    axes.errorbar(
        x, spread["mean"], yerr=ends, fmt=mark, color=colour, markersize=4.5, elinewidth=1.2, capsize=2
    )
