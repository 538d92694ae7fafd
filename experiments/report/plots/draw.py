"""Plots of a report as files in memory."""

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from experiments.report.paths_file import read_paths
from experiments.report.plots.calibration import draw_calibration
from experiments.report.plots.conditioning import draw_conditioning
from experiments.report.plots.dependence import draw_dependence
from experiments.report.plots.models import draw_dose_response, draw_heterogeneity
from experiments.report.plots.paths import draw_paths
from experiments.report.plots.style import settings
from experiments.report.plots.trials import draw_end_errors, draw_timeline

_PNG_DPI = 110


@dataclass(frozen=True)
class Plot:
    """One plot as files.

    Attributes:
        name: file name without suffix.
        alt: text alternative.
        svg, png: contents of the files.
        width_px, height_px: natural size of the SVG.
    """

    name: str
    alt: str
    svg: bytes
    png: bytes
    width_px: int
    height_px: int


def draw_plots(report: dict[str, Any], folder: Path) -> dict[str, Plot]:
    """Draw every plot that has figures; returns plots by name.

    Args:
        report: figures from `report_content`.
        folder: folder of the experiment, which may hold trajectories.
    """
    cells = len(report["analysis"]["cells"])
    drawings: Mapping[str, tuple[str, Callable[[], Figure | None]]] = {
        "calibration": (
            f"Predicted against measured share of dual failures, {len(report['calibration'])} points, as in "
            "the table of cells.",
            lambda: draw_calibration(report),
        ),
        "dependence": (
            f"Ratio of P(R given B) to P(R) with intervals for {cells} cells, as in the table below.",
            lambda: draw_dependence(report),
        ),
        "dose_response": (
            "Share of breakages and of failed crossings against severity, with the fits of the table below.",
            lambda: draw_dose_response(report),
        ),
        "heterogeneity": (
            "Pooled prediction, prediction within cells and measured share, as in the table below.",
            lambda: draw_heterogeneity(report),
        ),
        "conditioning": (
            "Error of rotation and of direction against baseline, medians per gap as in the table below.",
            lambda: draw_conditioning(report),
        ),
        "timeline": (
            "Per trial, the frames that base and Dual-SLAM tracked, lost or recovered.",
            lambda: draw_timeline(report),
        ),
        "paths": (
            "Estimated paths of base and Dual-SLAM over the true path, from above.",
            lambda: draw_paths(read_paths(folder), _unit_names(report)),
        ),
        "end_errors": (
            "Error of the last pose of every trial as colours, base beside Dual-SLAM.",
            lambda: draw_end_errors(report),
        ),
    }
    with settings():
        made = ((name, alt, draw()) for name, (alt, draw) in drawings.items())
        return {name: rendered(name, alt, figure) for name, alt, figure in made if figure is not None}


def _unit_names(report: dict[str, Any]) -> dict[str, str]:
    """Cell and index of each unit in the report, by unit id."""
    named = [*report["failures"], *({"cell": c["cell"], **u} for c in report["timeline"] for u in c["units"])]
    return {unit["unit_id"]: f"{unit['cell']} · {unit['index']}" for unit in named}


def rendered(name: str, alt: str, figure: Figure) -> Plot:
    """Save a figure in both formats; call within `settings`."""
    files = {}
    for form, metadata in (("svg", {"Date": None, "Creator": None}), ("png", {"Software": None})):
        file = io.BytesIO()
        figure.savefig(file, format=form, dpi=_PNG_DPI, metadata=metadata)
        files[form] = file.getvalue()
    width_in, height_in = figure.get_size_inches()
    return Plot(name, alt, files["svg"], files["png"], round(96 * width_in), round(96 * height_in))
