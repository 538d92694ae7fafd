"""What the plots share: size, colours, marks. Colours are told apart by colour-blind eyes (Okabe and Ito)."""

from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

BLUE, ORANGE, GREEN, PURPLE, SKY = "#0072B2", "#D55E00", "#00795A", "#A8447F", "#56B4E9"
GREY, PALE = "#6b7177", "#b4bcc4"
THREAD_COLOURS = (ORANGE, GREEN, PURPLE, SKY)
VERDICT_MARKS = {"consistent": "o", "optimistic": "^", "pessimistic": "v", "undecided": "x"}
WIDTH_IN = 7.6

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
    # The same figures give the same file.
    "svg.hashsalt": "dual-slam-lab",
}


def settings():
    """The context in which plots are made and saved."""
    return rc_context(_SETTINGS)


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """A figure outside pyplot's global state."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def thread_colour(number: int) -> str:
    """The colour of recovery thread j, and of what n = j threads give."""
    return THREAD_COLOURS[(number - 1) % len(THREAD_COLOURS)]


def bars(estimate: float, low: float, high: float) -> list[list[float]]:
    """Error bars as matplotlib wants them: distances, never negative."""
    return [[max(estimate - low, 0.0)], [max(high - estimate, 0.0)]]


def percent_axis(axis: Any) -> None:
    """Tick labels as percentages, on a log axis too."""
    axis.set_major_formatter(lambda value, _: f"{100 * value:.4g} %")
    axis.set_minor_formatter(NullFormatter())


def log_ticks(axis: Any, low: float, high: float) -> None:
    """Ticks at 1, 2 and 5 where an axis is short, at powers of ten where it is long."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 150 * low else (1.0,), numticks=20))


def shorten(text: str, length: int = 22) -> str:
    """A name that fits a tick label."""
    return text if len(text) <= length else text[: length - 1] + "…"


def direct_legend(axes: Axes, **where: Any) -> None:
    """A legend, where there is anything to tell."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**({"fontsize": 9} | where))
