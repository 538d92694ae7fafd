"""Page of a report: one self-contained HTML file."""

import base64
from pathlib import Path
from typing import Any

from experiments.pages import render_page
from experiments.report.describe import FILTERS
from experiments.report.paper_figures import PAPER
from experiments.report.plots.draw import Plot

_TEMPLATES = Path(__file__).with_name("templates")


def report_html(report: dict[str, Any], plots: dict[str, Plot]) -> str:
    """Write the HTML text: rounded figures, plots as data URIs, no script.

    Args:
        report: figures from `report_content`.
        plots: by name.
    """
    return render_page(
        _TEMPLATES,
        FILTERS | {"data_uri": _data_uri},
        report=report,
        plots=plots,
        paper=PAPER,
        threads=report["analysis"]["threads"],
    )


def _data_uri(plot: Plot) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(plot.svg).decode("ascii")
