"""Figures of an experiment on what systems believe: shares by worlds, and likelihoods beside a constant's."""

from typing import TYPE_CHECKING, Any

import numpy as np

from dslab.experiments.claims.belief import AXES, BeliefSpec
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.world_intervals import difference_interval, share_interval

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure as Drawing

_SHARES = {"inside": "poses", "in_window": "sought", "wrong": "taken"}
_TITLES = {
    "inside": "poses inside the ellipsoid of 95 %",
    "in_window": "true matches inside windows of 99 %",
    "wrong": "matches taken that show another place",
}
_STATED = {"inside": 0.95, "in_window": 0.99}


def figures(spec: BeliefSpec, table: "pd.DataFrame") -> dict[str, Any]:
    """Per system and condition, worlds being the sample.

    ``inside``, ``in_window`` and ``wrong``: shares, the mean over worlds of each world's own. ``chi2``: mean
    of the squared normalised errors over six, 1 if the covariance is right. ``gain``: mean log-likelihood of
    the errors by the system's covariances, less that by one constant covariance, with the mean squares of
    the errors of the other worlds.
    """
    rows = [
        {"system": system, "condition": condition, **_group(own)}
        for system in spec.systems
        for condition in spec.cells
        for own in [table[(table.system == system) & (table.condition == condition) & (table.poses > 0)]]
        if own.world.nunique() > 1
    ]
    return {"rows": rows, "answer": [[_told(row) for row in rows]]}


def _group(own: "pd.DataFrame") -> dict[str, Any]:
    found: dict[str, Any] = {"worlds": int(own.world.nunique()), "poses": int(own.poses.sum())}
    for name, of in _SHARES.items():
        known = own[own[of] > 0]
        by_world = (known[name] / known[of]).groupby(known.world).mean().to_numpy()
        found[name] = vars(share_interval(by_world)) if len(by_world) else None
    found["chi2"] = float(own.chi2.mean())
    found["gain"] = vars(difference_interval(Figure.mean(_gains(own))))
    return found


def _gains(own: "pd.DataFrame") -> np.ndarray:
    """(W,) likelihoods over those of a normal whose variances are the other worlds' mean squares."""
    squares = own[[f"square_{axis}" for axis in AXES]].to_numpy(float)
    others = (squares.sum(axis=0) - squares) / (len(squares) - 1)
    constant = -0.5 * (squares / others + np.log(2 * np.pi * others)).sum(axis=1)
    return own.likelihood.to_numpy(float) - constant


def _told(row: dict[str, Any]) -> dict[str, Any]:
    def share(name: str) -> str:
        of = row[name]
        return "-" if of is None else f"{of['value']:.3f} [{of['low']:.3f}, {of['high']:.3f}]"

    gain = row["gain"]
    return {
        "system": row["system"],
        "condition": row["condition"],
        "worlds": row["worlds"],
        "inside 95 %": share("inside"),
        "chi2 / 6": f"{row['chi2']:.2f}",
        "log-likelihood over a constant": f"{gain['value']:.2f} [{gain['low']:.2f}, {gain['high']:.2f}]",
        "in window": share("in_window"),
        "wrong": share("wrong"),
    }


def draw(spec: BeliefSpec, found: dict[str, Any], width_in: float) -> "Drawing":
    """Draw a panel per share, a row per system and condition; the share that is stated is a line."""
    from dslab.experiments.report.plots.style import BLUE, GREY, panels, percent_axis, wrapped

    rows = found["rows"]
    figure, axes = panels(len(_SHARES), len(_SHARES), width_in, 0.8 + 0.3 * len(rows), 0.6, sharey=True)
    for name, own in zip(_SHARES, axes, strict=True):
        for place, row in enumerate(rows):
            of = row[name]
            if of is not None:
                own.plot([of["low"], of["high"]], [-place, -place], color=BLUE, linewidth=1)
                own.plot(of["value"], -place, "o", color=BLUE, markersize=4)
        if name in _STATED:
            own.axvline(_STATED[name], color=GREY, linewidth=0.8)
        own.set_title(wrapped(_TITLES[name], width_in / len(_SHARES)), fontsize=8)
        percent_axis(own.xaxis)
    axes[0].set_yticks(range(0, -len(rows), -1), [f"{row['system']}: {row['condition']}" for row in rows])
    return figure
