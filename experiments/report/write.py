"""Writes a report: report.html, report.json, plots/, and recordings where they are asked for."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from experiments.report.content import report_content
from experiments.report.page import report_html
from experiments.report.plots.draw import draw_plots
from experiments.report.recordings import add_recordings
from experiments.runs.files import to_json
from sim.io.folders import new_directory, unwritable, write_file

PAGE, FIGURES, PLOTS = "report.html", "report.json", "plots"


def write_report(
    folder: Path, recordings: int = 0, progress: Callable[[int, int], None] = lambda done, total: None
) -> Path:
    """Write the report of an experiment into its folder, over an earlier one.

    Nothing half-written is ever left under the final names. An unfinished experiment gets a report that says
    so.

    Args:
        folder: of the experiment.
        recordings: this many of the failed units are run again and recorded, in the order of the list.
        progress: called with recordings made and wanted.

    Returns:
        The path of report.html.

    Raises:
        InputError: it is no experiment's folder, or it cannot be written to.
    """
    from experiments.campaign.folder import read_experiment

    folder = Path(folder)
    spec, table = read_experiment(folder)
    report = report_content(spec, table, folder)
    try:
        if recordings:
            add_recordings(report, spec, folder, recordings, progress)
        return write_files(report, folder)
    except OSError as error:
        raise unwritable(folder, error) from error


def write_files(report: dict[str, Any], folder: Path) -> Path:
    """Draw the plots and write page, figures and plots; returns the path of the page."""
    plots = draw_plots(report, folder)
    page = report_html(report, plots)
    # Replaced as a whole, so that no plot of an earlier report stays.
    with new_directory(folder / PLOTS, replaces="*") as place:
        for plot in plots.values():
            (place / f"{plot.name}.svg").write_bytes(plot.svg)
            (place / f"{plot.name}.png").write_bytes(plot.png)
    for name, text in ((FIGURES, to_json(report, indent=1) + "\n"), (PAGE, page)):
        write_file(folder / name, partial(Path.write_text, data=text, encoding="utf-8"))
    return folder / PAGE
