"""The page of a report: one HTML file that holds all it shows."""

import base64
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from experiments.report.describe import FILTERS
from experiments.report.paper_figures import PAPER
from experiments.report.plots.draw import Plot

_TEMPLATES = Path(__file__).with_name("templates")


def report_html(report: dict[str, Any], plots: dict[str, Plot]) -> str:
    """The HTML file: figures rounded from the object that report.json holds, plots as data URIs, no script.

    Args:
        report: as `report_content` makes it.
        plots: by name.
    """
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= FILTERS | {"data_uri": _data_uri}
    style = (_TEMPLATES / "style.css").read_text(encoding="utf-8")
    return environment.get_template("page.html.j2").render(
        report=report, plots=plots, paper=PAPER, style=style, threads=report["analysis"]["threads"]
    )


def _data_uri(plot: Plot) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(plot.svg).decode("ascii")
