"""All plots of a report as files in memory."""

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
    """One plot.

    Attributes:
        name: of its files, without ending.
        alt: what it shows, for those who do not see it.
        svg, png: the files.
        width_px, height_px: of the SVG at its natural size.
    """

    name: str
    alt: str
    svg: bytes
    png: bytes
    width_px: int
    height_px: int


def draw_plots(report: dict[str, Any], folder: Path) -> dict[str, Plot]:
    """Every plot for which there are figures, by name.

    Args:
        report: as `report_content` makes it.
        folder: of the experiment, where trajectories may lie.
    """
    cells = len(report["analysis"]["cells"])
    drawings: Mapping[str, tuple[str, Callable[[], Figure | None]]] = {
        "calibration": (
            f"Predicted against measured share of dual failures, {len(report['calibration'])} marks, as in "
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
            "Per trial, the frames that base and Dual-SLAM tracked, lost, bridged.",
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
    """Cell and index of the units that the report names."""
    named = [*report["failures"], *({"cell": c["cell"], **u} for c in report["timeline"] for u in c["units"])]
    return {unit["unit_id"]: f"{unit['cell']} · {unit['index']}" for unit in named}


def rendered(name: str, alt: str, figure: Figure) -> Plot:
    """A figure as its two files; within `settings`."""
    files = {}
    for form, metadata in (("svg", {"Date": None, "Creator": None}), ("png", {"Software": None})):
        file = io.BytesIO()
        figure.savefig(file, format=form, dpi=_PNG_DPI, metadata=metadata)
        files[form] = file.getvalue()
    width_in, height_in = figure.get_size_inches()
    return Plot(name, alt, files["svg"], files["png"], round(96 * width_in), round(96 * height_in))
