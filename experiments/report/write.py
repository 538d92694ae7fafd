"""Writes a report: report.html, report.json, plots/, and recordings where they are asked for."""

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
        raise _unwritable(folder, error) from error


def write_files(report: dict[str, Any], folder: Path) -> Path:
    """Draw the plots and write page, figures and plots; returns the path of the page."""
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
    """A new folder of plots in the place of the old one, so that none of an earlier report stays."""
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
