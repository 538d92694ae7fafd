"""Files of a report: report.html, report.json, plots/, and recordings on request."""

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import uuid4

from experiments.report.content import report_content
from experiments.report.page import report_html
from experiments.report.plots.draw import Plot, draw_plots
from experiments.report.recordings import add_recordings
from experiments.runs.files import to_json
from scenarios.errors import InputError

PAGE, FIGURES, PLOTS = "report.html", "report.json", "plots"


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
        InputError: the folder holds no experiment, or is not writable.
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
        raise _unwritable(folder, error) from error


def write_files(report: dict[str, Any], folder: Path) -> Path:
    """Draw the plots, write page, figures and plots, and return the path of the page."""
    plots = draw_plots(report, folder)
    page = report_html(report, plots)
    _put_plots(folder, plots)
    _put(folder / FIGURES, to_json(report, indent=1) + "\n")
    _put(folder / PAGE, page)
    return folder / PAGE


def _put(path: Path, text: str) -> None:
    partial = path.with_name(f".{path.name}.partial-{uuid4().hex[:8]}")
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _put_plots(folder: Path, plots: dict[str, Plot]) -> None:
    """Replace the folder of plots, so that no plot of an earlier report remains."""
    final = folder / PLOTS
    partial = folder / f".{PLOTS}.partial-{uuid4().hex[:8]}"
    old = partial.with_name(partial.name + "-old")
    try:
        partial.mkdir()
        for plot in plots.values():
            (partial / f"{plot.name}.svg").write_bytes(plot.svg)
            (partial / f"{plot.name}.png").write_bytes(plot.png)
        if final.exists():
            final.rename(old)
        partial.rename(final)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def _unwritable(folder: Path, error: OSError) -> InputError:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return InputError(str(folder), "the disk is full", "free some space or choose another disk")
    return InputError(str(folder), f"cannot be written ({error.strerror})", "make it writable")
