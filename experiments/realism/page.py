"""The page of a comparison of footage: plots and figures, no picture of a frame."""

import base64
from functools import partial
from pathlib import Path
from typing import Any

from dslab.experiments.pages import render_page
from dslab.experiments.realism.plots import draw_measure, draw_scale
from dslab.experiments.report.plots.draw import Image, Plot, rendered
from dslab.experiments.report.plots.style import NARROW_IN, WIDE_IN, settings

_TEMPLATES = Path(__file__).with_name("templates")
"""Folder of the page's template and style."""
GROUPS = {
    "matches": "Matches and observations",
    "map": "The map",
    "images": "Images",
}
"""Groups of measures in the order of the page."""
FIGURES = {
    "frames": "frames",
    "tracked_share": "tracked, share",
    "maps": "maps",
    "breakages": "breakages declared",
    "camera_refined": "corrections of the lens",
    "path_m": "path, m",
    "keyframes": "keyframes",
    "keyframes_per_s": "keyframes per second",
    "keyframes_per_m": "keyframes per metre",
    "residual_over_1_sigma": "residuals over 1 sigma, share",
    "residual_over_2_sigma": "residuals over 2 sigma, share",
    "live_residual_over_2.45_sigma": "live residuals over 2.45 sigma, share",
    "live_residual_over_5_sigma": "live residuals over 5 sigma, share",
    "scale_first_over_last": "scale, first over last quarter",
    "ate_m": "ATE, m",
}
"""Figures of a sequence and their labels."""


def footage_html(content: dict[str, Any]) -> str:
    """Write the HTML text: self-contained, without a script.

    Args:
        content: from ``footage_content``.
    """
    with settings():
        plots = {
            m["name"]: _plot(m["name"], m["label"], partial(draw_measure, m)) for m in content["measures"]
        }
        if draw_scale(content["sequences"], WIDE_IN) is not None:
            draw = partial(draw_scale, content["sequences"])
            plots["scale"] = _plot("scale", "Scale along the true path", draw)
    return render_page(
        _TEMPLATES,
        {"data_uri": _data_uri, "figure": _figure},
        content=content,
        plots=plots,
        groups=GROUPS,
        figures=FIGURES,
    )


def _plot(name: str, label: str, draw: Any) -> Plot:
    return rendered(name, f"Distribution over sequences: {label}.", draw(WIDE_IN), draw(NARROW_IN))


def _data_uri(image: Image) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(image.svg).decode()


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
