"""Common style of the plots. Colours are safe for colour-blind readers (Okabe and Ito)."""

import textwrap
from collections.abc import Sequence
from math import ceil
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from dslab.experiments.pictures.labels import label

BLUE, ORANGE, GREEN, PURPLE, SKY = "#0072B2", "#D55E00", "#00795A", "#A8447F", "#56B4E9"
GREY, PALE = "#6b7177", "#b4bcc4"
THREAD_COLOURS = (ORANGE, GREEN, PURPLE, SKY)
WIDE_IN, NARROW_IN = 7.6, 3.6
"""Widths of the two drawings of a plot: for a page, and for a telephone's."""
_ENTRY_IN, _LETTER_IN = 0.65, 0.085
"""In a legend at 9 points a mark with its spaces, and a letter."""

_SETTINGS = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    # Equal figures give equal files.
    "svg.hashsalt": "dual-slam-lab",
}


def settings():
    """Context for drawing and saving plots."""
    return rc_context(_SETTINGS)


def new_figure(height_in: float, width_in: float) -> Figure:
    """Create a figure outside the global state of pyplot."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def panels(
    count: int, columns: int, width_in: float, height_in: float, heading_in: float, **shared: Any
) -> tuple[Figure, list[Axes]]:
    """Create a figure of so many panels in rows, one below the other on a narrow page.

    Args:
        count: of panels.
        columns: at most, on a wide page.
        width_in: of the figure.
        height_in: of a row.
        heading_in: room over the rows.
        shared: arguments of ``Figure.subplots``.
    """
    columns = min(columns if width_in > NARROW_IN else 1, count)
    rows = -(-count // columns)
    figure = new_figure(heading_in + height_in * rows, width_in)
    grid = figure.subplots(rows, columns, squeeze=False, **shared).ravel()
    for empty in grid[count:]:
        empty.remove()
    return figure, list(grid[:count])


def thread_colour(number: int) -> str:
    """Colour of recovery thread j and of results for n = j."""
    return THREAD_COLOURS[(number - 1) % len(THREAD_COLOURS)]


def bars(estimate: float, low: float, high: float) -> list[list[float]]:
    """Error bars for matplotlib: distances, never negative."""
    return [[max(estimate - low, 0.0)], [max(high - estimate, 0.0)]]


def draw_share(axes: Axes, at: float, share: dict[str, Any], colour: str, mark: str) -> None:
    """Draw a share with its interval."""
    ends = bars(share["value"], share["low"], share["high"])
    axes.errorbar(at, share["value"], yerr=ends, fmt=mark, color=colour, markersize=4.5, elinewidth=1)


def shares_over(axes: Axes, labels: Sequence[str]) -> None:
    """Set up axes for shares over doses of these names."""
    axes.set_xticks(range(len(labels)), labels, fontsize=8)
    axes.set_xlim(-0.5, len(labels) - 0.5)
    axes.set_ylim(-0.03, 1.03)
    percent_axis(axes.yaxis)
    axes.tick_params(axis="y", labelsize=8, labelleft=True)
    axes.grid(visible=False, axis="x")


def plain_ticks(axis: Any) -> None:
    """Write the numbers of major ticks in full, and none of minor ones."""
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(NullFormatter())


def percent_axis(axis: Any) -> None:
    """Format tick labels as percentages, also on a log axis."""
    axis.set_major_formatter(lambda value, _: f"{100 * value:.4g} %")
    axis.set_minor_formatter(NullFormatter())


def log_ticks(axis: Any, low: float, high: float) -> None:
    """Set log ticks at 1, 2 and 5, or at powers of ten on long axes."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 150 * low else (1.0,), numticks=20))


def wrapped(text: str, width_in: float) -> str:
    """Break a name of a row or a panel into lines that leave room for the plot."""
    return label("\n".join(textwrap.wrap(text, 34 if width_in > NARROW_IN else 16)[:3]))


def legend_above(figure: Figure, handles: Sequence[Any], columns: int, width_in: float) -> None:
    """Add a legend over the panels, never within them."""
    columns = columns if width_in > NARROW_IN else min(columns, 2)
    figure.legend(handles=handles, loc="outside upper left", ncols=columns, fontsize=9)


def columns_that_fit(handles: Sequence[Any], width_in: float) -> int:
    """Columns of a legend of :func:`legend_above` that fill the width evenly, of as few rows as it takes."""
    needed_in = sum(_ENTRY_IN + _LETTER_IN * len(str(handle.get_label())) for handle in handles)
    rows = ceil(needed_in / width_in)
    return ceil(len(handles) / max(1, rows))


def legend_mark(colour: str, name: str, shape: str = "o") -> Line2D:
    """Entry of a legend for points with error bars."""
    return Line2D([], [], color=colour, marker=shape, linewidth=1.4, label=label(name))
