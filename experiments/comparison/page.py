"""From result folders to a folder with the comparison: its page and its figures."""

from functools import partial
from pathlib import Path
from typing import Any

from dslab.experiments.comparison.dose_response import DOSE_FIGURES, draw_dose_response
from dslab.experiments.comparison.figures import FIGURES, WRITTEN, comparison_content
from dslab.experiments.comparison.left_runs import find_runs
from dslab.experiments.comparison.plots import draw_errors, draw_paths, draw_stages, draw_within
from dslab.experiments.pages import render_page
from dslab.experiments.report.plots.draw import Plot, rendered
from dslab.experiments.report.plots.style import NARROW_IN, WIDE_IN, settings
from dslab.experiments.runs.files import plain, to_json
from dslab.experiments.statistics.spreads import ALIKE, Bounds
from dslab.sim.io.folders import check_free, new_directory

PAGE_FILE, FIGURES_FILE = "index.html", "comparison.json"
_TEMPLATES = Path(__file__).with_name("templates")


def compare_runs(folders: list[Path], out_dir: Path) -> dict[str, Any]:
    """Compare every run in result folders, and write page and figures.

    Args:
        folders: result folders, or folders that hold some at any depth.
        out_dir: absent or empty.

    Returns:
        The figures, as in ``comparison.json``.

    Raises:
        InputError: a folder holds no run, a run is not complete or has no truth, or ``out_dir`` is taken.
    """
    check_free(out_dir)
    content = comparison_content(find_runs(folders))
    with new_directory(out_dir) as folder:
        (folder / PAGE_FILE).write_text(comparison_html(content), encoding="utf-8")
        (folder / FIGURES_FILE).write_text(to_json(content, indent=1) + "\n", encoding="utf-8")
    return plain(content)


def comparison_html(content: dict[str, Any]) -> str:
    """Write the HTML text: self-contained, without a script."""
    with settings():
        series = [_dose_plot(one) for one in content["dose_series"]]
        plots = [_plots(sequence, content["thresholds"]) for sequence in content["sequences"]]
    tables = {"figures": FIGURES, "written": WRITTEN, "doses": DOSE_FIGURES}
    filters = {"spread": spread_text}
    return render_page(_TEMPLATES, filters, content=content, plots=plots, series=series, **tables)


def spread_text(spread: dict[str, Any], bounds: Bounds = "amount") -> str:
    """A mean and the ends of its interval, or that there is no spread; a dash without a mean."""
    mean, low, high = (figure_text(spread[end], bounds) for end in ("mean", "low", "high"))
    if spread["low"] is not None:
        return f"{mean} [{low}, {high}]"
    return f"{mean} (all alike)" if spread["reason"] == ALIKE else mean


def figure_text(value: float | None, bounds: Bounds) -> str:
    """A figure to three digits, a share or an event in percent; a dash for None."""
    if value is None:
        return "–"
    return f"{value:.3g}" if bounds == "amount" else f"{100 * value:.3g} %"


def _dose_plot(series: dict[str, Any]) -> Plot:
    drawn = (draw_dose_response(series["points"], series["axis"], width) for width in (WIDE_IN, NARROW_IN))
    return rendered("", f"Systems against {series['axis']}.", *drawn)


def _plots(sequence: dict[str, Any], thresholds: Any) -> dict[str, Plot]:
    drawn = {
        "paths": ("Paths over the truth", draw_paths),
        "errors": ("Position errors over time", draw_errors),
        "within": ("Shares of the path within an error", partial(draw_within, thresholds=thresholds)),
        "stages": ("CPU time of stages", draw_stages),
    }
    return {
        name: rendered(
            "", f"{label}, {sequence['name']}.", *(draw(sequence, w) for w in (WIDE_IN, NARROW_IN))
        )
        for name, (label, draw) in drawn.items()
    }
