"""Plots of a report as files in memory."""

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from dslab.experiments.report.conditions import describe_label
from dslab.experiments.report.plots.chain import draw_chain
from dslab.experiments.report.plots.conditioning import draw_conditioning
from dslab.experiments.report.plots.directions import draw_directions
from dslab.experiments.report.plots.doses import draw_doses
from dslab.experiments.report.plots.formulas import draw_formulas
from dslab.experiments.report.plots.paths import draw_paths
from dslab.experiments.report.plots.repeats import draw_repeats
from dslab.experiments.report.plots.style import NARROW_IN, WIDE_IN, settings
from dslab.experiments.report.plots.systems import draw_systems
from dslab.experiments.report.plots.trials import draw_end_errors, draw_timeline
from dslab.experiments.report.recordings import read_paths
from dslab.sim.io.folders import write_file

_PNG_DPI = 110


@dataclass(frozen=True)
class Image:
    """A drawing of a plot: an SVG and its natural size."""

    svg: bytes
    width_px: int
    height_px: int

    @property
    def data_uri(self) -> str:
        """For a page that stands alone."""
        return "data:image/svg+xml;base64," + base64.b64encode(self.svg).decode("ascii")


@dataclass(frozen=True)
class Plot:
    """One plot as files.

    Attributes:
        name: file name without suffix.
        alt: text alternative.
        wide, narrow: drawings for a page, and for a telephone's.
        png: the wide drawing as PNG.
    """

    name: str
    alt: str
    wide: Image
    narrow: Image
    png: bytes

    def write(self, folder: Path) -> Path:
        """Write the wide drawing as SVG and PNG; returns the path of the PNG.

        Raises:
            InputError: the files cannot be written.
        """
        for form, content in (("svg", self.wide.svg), ("png", self.png)):
            write_file(folder / f"{self.name}.{form}", partial(Path.write_bytes, data=content))
        return folder / f"{self.name}.png"


def draw_plots(report: dict[str, Any], folder: Path) -> dict[str, Plot]:
    """Draw every plot that has figures; returns plots by name."""
    paths = read_paths(folder)
    drawings: dict[str, tuple[str, Callable[[float], Figure | None]]] = {
        f"chain_{kind}": (
            f"Steps from Eq. 1 to the measured failures under {describe_label(kind)}, as ratios.",
            partial(draw_chain, report, kind),
        )
        for kind in dict.fromkeys(cell["kind"] for cell in report["analysis"]["cells"])
    }
    drawings |= {
        "repeats": (
            "Sequences by their runs that break and that a thread fails to cross, a grid per condition.",
            partial(draw_repeats, report),
        ),
        "formulas": (
            "Mean prediction of each formula minus the mean failures, per condition.",
            partial(draw_formulas, report),
        ),
        "directions": (
            "Shares in which the base fails forward and each thread of Algorithm 1 backward, with intervals.",
            partial(draw_directions, report),
        ),
        "doses": (
            "Shares of breakages, failures of threads and dual failures against the dose, with intervals.",
            partial(draw_doses, report),
        ),
        "systems": (
            "Shares of breakages and of failed missions of every system against the dose, with intervals.",
            partial(draw_systems, report),
        ),
        "conditioning": (
            "Error of rotation and of direction against baseline, medians per gap as in the table below.",
            partial(draw_conditioning, report),
        ),
        "timeline": (
            "Per trial, the frames that base and Dual-SLAM tracked, lost or recovered.",
            partial(draw_timeline, report),
        ),
        "paths": (
            "Estimated paths of base and Dual-SLAM over the true path, from above.",
            partial(draw_paths, paths, _unit_names(report)),
        ),
        "end_errors": (
            "Error of the last pose of every trial as colours, base beside Dual-SLAM.",
            partial(draw_end_errors, report),
        ),
    }
    with settings():
        made = {name: (alt, draw(WIDE_IN), draw(NARROW_IN)) for name, (alt, draw) in drawings.items()}
        return {
            name: rendered(name, alt, wide, narrow)
            for name, (alt, wide, narrow) in made.items()
            if wide is not None and narrow is not None
        }


def _unit_names(report: dict[str, Any]) -> dict[str, str]:
    """Condition and index of each unit in the report, by unit id."""
    named = [*report["failures"], *({"cell": c["cell"], **u} for c in report["timeline"] for u in c["units"])]
    names = {condition["cell"]: condition["name"] for condition in report["conditions"]}
    return {unit["unit_id"]: f"{names[unit['cell']]}, trial {unit['index']}" for unit in named}


def rendered(name: str, alt: str, wide: Figure, narrow: Figure | None = None) -> Plot:
    """Save the figures of a plot, or one figure for both; call within `settings`."""
    png = _saved(wide, "png", {"Software": None})
    drawn = _image(wide)
    return Plot(name, alt, drawn, drawn if narrow is None else _image(narrow), png)


def _image(figure: Figure) -> Image:
    width_in, height_in = figure.get_size_inches()
    svg = _saved(figure, "svg", {"Date": None, "Creator": None})
    return Image(svg, round(96 * width_in), round(96 * height_in))


def _saved(figure: Figure, form: str, metadata: dict[str, None]) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format=form, dpi=_PNG_DPI, metadata=metadata)
    return file.getvalue()
