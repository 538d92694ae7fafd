"""Page of a report: one self-contained HTML file."""

import re
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from dslab.experiments.pages import render_page
from dslab.experiments.report.answer import MEANINGS
from dslab.experiments.report.conditions import describe_label, thread_names
from dslab.experiments.report.describe import FILTERS
from dslab.experiments.report.paper_figures import PAPER
from dslab.experiments.report.plots.draw import Plot

_TEMPLATES = Path(__file__).with_name("templates")


def report_html(report: dict[str, Any], plots: dict[str, Plot]) -> str:
    """Write the HTML text: rounded figures, plots as data URIs, no script."""
    return render_page(
        _TEMPLATES,
        FILTERS | {"labelled": _labelled, "in_order": _in_order, "stress": describe_label},
        report=report,
        plots=plots,
        paper=PAPER,
        threads=report["analysis"]["threads"],
        named={condition["cell"]: condition for condition in report["conditions"]},
        thread_names=thread_names(report),
        meanings=MEANINGS,
    )


def _labelled(rows: Markup, heads: list[str]) -> Markup:
    """Write the head of its column into every cell: on narrow screens a row becomes a card."""

    def labelled(row: re.Match[str]) -> str:
        names = iter(heads)
        return re.sub(r"<t[hd](?=[ >])", lambda cell: f'{cell[0]} data-label="{escape(next(names))}"', row[0])

    return Markup(re.sub(r"<tr.*?</tr>", labelled, rows, flags=re.DOTALL))


def _in_order(cells: list[dict[str, Any]], conditions: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Judged cells in the order of the spec, then by kind of world and n."""
    place = {condition["cell"]: condition["number"] for condition in conditions}
    return sorted(cells, key=lambda cell: (place[cell["cell"]], cell["world"], cell["n"]))
