"""The page of a comparison."""

import base64
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from dslab.experiments.comparison.figures import FIGURES
from dslab.experiments.comparison.plots import draw_errors, draw_paths, draw_stages, draw_within
from dslab.experiments.pages import render_page
from dslab.experiments.report.plots.draw import Image, Plot, rendered
from dslab.experiments.report.plots.style import NARROW_IN, WIDE_IN, settings

_TEMPLATES = Path(__file__).with_name("templates")


def comparison_html(content: dict[str, Any]) -> str:
    """Write the HTML text: self-contained, without a script.

    Args:
        content: from ``comparison_content``.
    """
    with settings():
        plots = [_plots(sequence, content["thresholds"]) for sequence in content["sequences"]]
    return render_page(
        _TEMPLATES,
        {"data_uri": _data_uri, "spread": spread_text},
        content=content,
        plots=plots,
        figures=FIGURES,
    )


def spread_text(spread: dict[str, Any], digits: int = 3) -> str:
    """A mean and the ends of its interval, if it has one."""
    if spread["mean"] is None:
        return "–"
    text = f"{spread['mean']:.{digits}g}"
    return (
        text if spread["low"] is None else f"{text} [{spread['low']:.{digits}g}, {spread['high']:.{digits}g}]"
    )


def _plots(sequence: dict[str, Any], thresholds: Any) -> dict[str, Plot]:
    drawn = {
        "paths": ("Paths over the truth", draw_paths),
        "errors": ("Position errors over time", draw_errors),
        "within": ("Shares of the path within an error", partial(_within, thresholds)),
        "stages": ("CPU time of stages", draw_stages),
    }
    return {
        name: _plot(f"{label}, {sequence['name']}.", sequence, draw) for name, (label, draw) in drawn.items()
    }


def _within(thresholds: Any, sequence: dict[str, Any], width_in: float) -> Figure:
    return draw_within(sequence, thresholds, width_in)


def _plot(alt: str, sequence: dict[str, Any], draw: Any) -> Plot:
    return rendered("", alt, draw(sequence, WIDE_IN), draw(sequence, NARROW_IN))


def _data_uri(image: Image) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(image.svg).decode()
