"""Figures of plain RANSAC with more and more samples: does the winner come nearer to the true pose?

The telling pairs are those whose winner has at least as many inliers as the true pose and yet another
direction: no further sample can mend them, as RANSAC's own score prefers the wrong pose.
"""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing

from dslab.experiments.claims.two_view import TwoViewSpec
from dslab.experiments.claims.world_medians import draw_over, over_worlds, shown
from dslab.experiments.report.plots.style import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    legend_above,
    legend_mark,
    panels,
    percent_axis,
    plain_ticks,
)
from dslab.experiments.statistics.world_intervals import median_interval, share_interval

OFF_DEG = (5.0, 10.0)
"""A direction further off is wrong."""
_SURE = 0.99
_SHIFT = 1.12
_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY)


def figures(spec: TwoViewSpec, table: pd.DataFrame) -> dict[str, Any]:
    """Errors, claims and telling pairs by scene, gap and number of samples; change from few to many."""
    table = table.dropna(subset=["samples"])
    groups = [
        (scene, gap, table[(table["scene"] == scene) & (table["gap"] == gap)])
        for scene in spec.cells
        for gap in spec.gaps
    ]
    by_samples = [
        {"scene": scene, "gap": gap, "samples": samples, **_of(rows[rows["samples"] == samples])}
        for scene, gap, rows in groups
        if len(rows)
        for samples in spec.iterations
    ]
    changes = [
        {"scene": scene, "gap": gap, **_change(spec, rows)} for scene, gap, rows in groups if len(rows)
    ]
    return {"by_samples": by_samples, "changes": changes, "answer": [_shown(spec, by_samples, changes)]}


def _of(rows: pd.DataFrame) -> dict[str, Any]:
    worlds = int(rows["world"].nunique())
    shares = rows.assign(
        inlier_share=rows["inliers"] / rows["matches"],
        sure=(rows["confidence"] >= _SURE).astype(float),
        **{f"off_{off:g}": (rows["direction_deg"] > off).astype(float) for off in OFF_DEG},
        **{f"telling_{off:g}": is_telling(rows, off).astype(float) for off in OFF_DEG},
    )
    medians = ("direction_deg", "rotation_deg", "depth", "inlier_share", "confidence")
    named = [f"{what}_{off:g}" for what in ("off", "telling") for off in OFF_DEG]
    return {
        "worlds": worlds,
        "pairs": len(rows),
        "baseline_m": float(rows["baseline_m"].median()),
        "parallax_deg": float(rows["parallax_deg"].median()),
        **{name: over_worlds(shares, name) for name in medians},
        **{
            name: vars(share_interval(shares.groupby("world")[name].mean().to_numpy()))
            for name in ["sure", *named]
        },
    }


def is_telling(rows: pd.DataFrame, off_deg: float) -> Any:
    """(N,) true where the winner has at least the inliers of the true pose and is off by more."""
    return (rows["inliers"] >= rows["inliers_true_pose"]) & (rows["direction_deg"] > off_deg)


def _change(spec: TwoViewSpec, rows: pd.DataFrame) -> dict[str, Any]:
    """Error with most samples over that with fewest, of the same pairs: the median over worlds."""
    few, many = (
        rows[rows["samples"] == samples].set_index(["world", "first"])["direction_deg"]
        for samples in (spec.iterations[0], spec.iterations[-1])
    )
    by_world = np.log(many / few).groupby("world").median().dropna().to_numpy()
    worlds = {"worlds": len(by_world)}
    if not len(by_world):
        return {"ratio": None, **worlds}
    found = median_interval(by_world)
    return {"ratio": {name: float(np.exp(value)) for name, value in vars(found).items()}, **worlds}


def _shown(
    spec: TwoViewSpec, by_samples: list[dict[str, Any]], changes: list[dict[str, Any]]
) -> list[dict[str, str]]:
    """The table that is printed: a row per scene and gap."""
    few, many = spec.iterations[0], spec.iterations[-1]
    cells = {(row["scene"], row["gap"], row["samples"]): row for row in by_samples}
    rows = []
    for change in changes:
        first, last = (cells[change["scene"], change["gap"], samples] for samples in (few, many))
        telling = last[f"telling_{OFF_DEG[0]:g}"]
        rows.append(
            {
                "scene": change["scene"],
                "baseline\nm": f"{last['baseline_m']:.2f}",
                "worlds": str(last["worlds"]),
                f"{few}:\ndeg": shown(first["direction_deg"], ends=False),
                f"{many}:\ndeg": shown(last["direction_deg"], ends=False),
                "ratio": shown(change["ratio"]),
                f"{few}:\nclaims": shown(first["confidence"], ends=False),
                f"off > {OFF_DEG[0]:g} deg\nwith the inliers\nof the truth": _percent(telling),
            }
        )
    return rows


def _percent(share: dict[str, Any]) -> str:
    value, low, high = (f"{100 * share[name]:.0f}" for name in ("value", "low", "high"))
    return f"{value} % ({low} to {high})"


def draw(spec: TwoViewSpec, found: dict[str, Any], width_in: float) -> Drawing:
    """Draw a column per scene: error of direction, and the share of telling pairs, over samples by gap."""
    scenes = list(spec.cells)
    figure, axes = panels(2 * len(scenes), len(scenes), width_in, 2.5, 0.5, sharex=True)
    rows = {(row["scene"], row["gap"], row["samples"]): row for row in found["by_samples"]}
    telling = f"telling_{OFF_DEG[0]:g}"
    for number, scene in enumerate(scenes):
        for place, name in ((axes[number], "direction_deg"), (axes[number + len(scenes)], telling)):
            for shift, (gap, colour) in enumerate(zip(spec.gaps, _COLOURS, strict=False)):
                at = [(n, rows.get((scene, gap, n))) for n in spec.iterations]
                # Beside each other, so that no interval hides another.
                points = [(n * _SHIFT**shift, row[name]) for n, row in at if row]
                draw_over(place, points, colour)
            place.set(xscale="log", xlabel="samples" if name == telling else "")
            place.tick_params(labelsize=8)
        axes[number].set_yscale("log")
        plain_ticks(axes[number].yaxis)
        axes[number].set_title(f"{scene}: error (deg)", fontsize=9)
        axes[number + len(scenes)].set_ylim(-0.03, 1.03)
        percent_axis(axes[number + len(scenes)].yaxis)
        axes[number + len(scenes)].set_title(f"off by > {OFF_DEG[0]:g} deg,\ntrue inliers", fontsize=9)
    baselines = {
        gap: np.median([row["baseline_m"] for row in found["by_samples"] if row["gap"] == gap])
        for gap in spec.gaps
    }
    marks = [
        legend_mark(colour, f"{baselines[gap]:.2f} m apart")
        for gap, colour in zip(spec.gaps, _COLOURS, strict=False)
    ]
    legend_above(figure, marks, len(marks), width_in)
    return figure
