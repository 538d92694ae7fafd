"""Plots of single trials: profiles over frames (Fig. 7), last errors (Fig. 9)."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from dslab.experiments.report.plots.style import (
    BLUE,
    GREEN,
    NARROW_IN,
    ORANGE,
    PALE,
    SKY,
    legend_above,
    new_figure,
    panels,
)

_EXPOSED: dict[str, Any] = {"facecolor": "none", "edgecolor": "#222222", "linewidth": 0.9, "zorder": 3}
_PARTS = {
    "tracked": BLUE,
    "bridged by recovery": GREEN,
    "a new map, not joined": SKY,
    "lost for good": ORANGE,
    "relocalized later": PALE,
}
_COLUMNS = 3


def draw_timeline(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw two bars per trial over frames, base above Dual-SLAM, a panel per cell."""
    cells = [cell for cell in report["timeline"] if cell["units"]]
    if not cells:
        return None
    figure, places = panels(len(cells), _COLUMNS, width_in, 2.3, 0.9)
    figure.set_figwidth(max(3.2 * min(_COLUMNS if width_in > NARROW_IN else 1, len(cells)), NARROW_IN))
    names = {c["cell"]: f"{c['number']}. {c['name']}" for c in report["conditions"]}
    for axes, cell in zip(places, cells, strict=True):
        for place, unit in enumerate(cell["units"]):
            _draw_trial(axes, place, unit, cell["frames"])
        axes.set_title(names[cell["cell"]], fontsize=9)
        axes.set(xlim=(0, cell["frames"]), ylim=(len(cell["units"]) - 0.4, -0.6))
        axes.set_yticks(range(len(cell["units"])), [str(unit["index"]) for unit in cell["units"]], fontsize=7)
        axes.grid(visible=False)
        axes.set_xlabel("frame", fontsize=9)
        axes.set_ylabel("trial", fontsize=9)
    handles = [Patch(color=colour, label=part) for part, colour in _PARTS.items()]
    handles.append(Patch(**_EXPOSED, label="exposed segment"))
    legend_above(figure, handles, 3, figure.get_figwidth())
    return figure


def _draw_trial(axes: Axes, place: int, unit: dict[str, Any], frames: int) -> None:
    if unit["onset_frame"] is not None and unit["end_frame"] is not None:
        width = unit["end_frame"] - unit["onset_frame"] + 1
        axes.barh(place, width, left=unit["onset_frame"], height=0.86, **_EXPOSED)
    for offset, parts in ((-0.2, base_parts(unit, frames)), (0.2, dual_parts(unit, frames))):
        for start, end, part in parts:
            axes.barh(place + offset, end - start, left=start, height=0.32, color=_PARTS[part])


def base_parts(unit: dict[str, Any], frames: int) -> list[tuple[int, int, str]]:
    """Parts of a base run as (first frame, frame after, part); relocalization has no frame."""
    if not unit["breakage"] or unit["breakage_frame"] is None:
        return [(0, frames, "tracked")]
    broke = unit["breakage_frame"]
    after = "relocalized later" if unit["relocalized"] else "lost for good"
    return [(0, broke, "tracked"), (broke, frames, after)]


def dual_parts(unit: dict[str, Any], frames: int) -> list[tuple[int, int, str]]:
    """Parts of a Dual-SLAM run, in the form of base_parts."""
    if not unit["breakage"] or unit["breakage_frame"] is None:
        return [(0, frames, "tracked")]
    broke, again = unit["breakage_frame"], unit["reinit_frame"]
    before = (0, broke, "tracked")
    if again is None:
        after = "lost for good"
        return [before, (broke, frames, after)]
    if unit["dual_failure"]:
        return [before, (broke, again, "lost for good"), (again, frames, "a new map, not joined")]
    return [before, (broke, again, "bridged by recovery"), (again, frames, "tracked")]


def draw_end_errors(report: dict[str, Any], width_in: float) -> Figure | None:
    """Draw the position error of the last pose per cell and trial, base beside Dual-SLAM."""
    cells = report["end_errors"]
    values = [v for cell in cells for name in ("base_m", "dual_m") for v in cell[name] if v]
    if not values:
        return None
    most = max(len(cell["index"]) for cell in cells)
    figure = new_figure(2.2 + min(0.09 * most, 4.5), width_in)
    beside = figure.subplots(1, 2, sharey=True)
    norm = LogNorm(max(min(values), 1e-3), max(*values, 2e-3))
    image = None
    numbers = {c["cell"]: str(c["number"]) for c in report["conditions"]}
    for axes, name, title in zip(beside, ("base", "dual"), ("base", "Dual-SLAM"), strict=True):
        image = _heat(axes, cells, name, most, norm)
        axes.set_title(title, fontsize=10)
        axes.set_xticks(range(len(cells)), [numbers[c["cell"]] for c in cells], fontsize=8)
        axes.set_xlabel("condition", fontsize=9)
        axes.grid(visible=False)
    beside[0].set_ylabel("trial")
    if image is not None:
        figure.colorbar(image, ax=list(beside), label="error of the last pose (m)", shrink=0.9)
    failed = [
        Patch(facecolor="#222222", label="failed"),
        Patch(facecolor="#d8d8d8", label="no last pose or truth"),
    ]
    legend_above(figure, failed, 2, width_in)
    return figure


def _heat(axes: Axes, cells: list[dict[str, Any]], name: str, most: int, norm: LogNorm) -> Any:
    errors = np.full((most, len(cells)), np.nan)
    shade = np.full((most, len(cells), 4), 0.0)
    for column, cell in enumerate(cells):
        for row, (error, failed) in enumerate(zip(cell[f"{name}_m"], cell[f"{name}_failed"], strict=True)):
            shade[row, column] = (0.13, 0.13, 0.13, 1) if failed else (0.85, 0.85, 0.85, 1)
            if error is not None and not failed:
                errors[row, column] = max(error, norm.vmin or 0)
    axes.imshow(shade, origin="lower", aspect="auto", interpolation="nearest")
    return axes.imshow(
        np.ma.masked_invalid(errors),
        norm=norm,
        cmap="viridis",
        origin="lower",
        aspect="auto",
        interpolation="nearest",
    )
