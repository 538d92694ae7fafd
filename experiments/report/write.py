"""Files of a report: report.html, report.json, plots/, and recordings on request."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from dslab.experiments.eq1.boundary_plan import is_search
from dslab.experiments.report.content import report_content
from dslab.experiments.report.page import report_html
from dslab.experiments.report.plots.draw import draw_plots
from dslab.experiments.report.recordings import add_recordings
from dslab.experiments.runs.files import plain, to_json
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given, read_json
from dslab.sim.io.folders import new_directory, unwritable, write_file

PAGE, FIGURES, PLOTS = "report.html", "report.json", "plots"
_WRITTEN_BY = ("versions", "report_commit")
_ROUNDING = 1e-9
"""Far above what sums of float64 lose, far below what a page shows."""


def write_report(
    folder: Path, recordings: int = 0, progress: Callable[[int, int], None] = lambda done, total: None
) -> Path:
    """Write the report of an experiment into its folder, replacing an earlier one.

    No partial file is left under a final name. The report of an unfinished experiment says that units are
    missing.

    Args:
        folder: folder of the experiment.
        recordings: number of failed units to replay and record, in the order of the list.
        progress: called with the numbers of recordings done and requested.

    Returns:
        The path of report.html.

    Raises:
        InputError: the folder holds no experiment or a boundary search, or is not writable.
    """
    from dslab.experiments.campaign.folder import read_experiment

    folder = Path(folder)
    spec, table = read_experiment(folder)
    if is_search(spec):
        problem = "is a boundary search, whose outcomes chose its doses: shares over them mean nothing"
        raise InputError(str(folder), problem, "see boundary.json and boundary.png")
    report = report_content(spec, table, folder)
    try:
        if recordings:
            add_recordings(report, spec, folder, recordings, progress)
        return write_files(report, folder)
    except OSError as error:
        raise unwritable(folder, error) from error


def write_files(report: dict[str, Any], folder: Path) -> Path:
    """Draw the plots, write page, figures and plots, and return the path of the page."""
    plots = draw_plots(report, folder)
    page = report_html(report, plots)
    # Replaced as a whole, so that no plot of an earlier report stays.
    with new_directory(folder / PLOTS, replaces="*") as place:
        for plot in plots.values():
            plot.write(place)
    texts = {PAGE: page}
    if not says_the_same(folder / FIGURES, report):
        texts[FIGURES] = to_json(report, indent=1) + "\n"
    for name, text in texts.items():
        write_file(folder / name, partial(Path.write_text, data=text, encoding="utf-8"))
    return folder / PAGE


def says_the_same(path: Path, report: dict[str, Any]) -> bool:
    """True if a file holds the figures of a report but for rounding and the code that wrote it.

    Published figures are then left as they are: another processor rounds the last digits otherwise.
    """
    try:
        return is_given(path) and _same(read_json(path, dict), plain(report))
    except InputError:
        return False


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        names = {*one, *other} - {*_WRITTEN_BY}
        return all(name in one and name in other and _same(one[name], other[name]) for name in names)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=_ROUNDING, abs_tol=_ROUNDING)
    return type(one) is type(other) and one == other
