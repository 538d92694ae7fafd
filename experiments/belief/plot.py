"""Reliability: how often hypotheses are right, over how likely they were held."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.special import expit, logit

from dslab.experiments.statistics.paper import clopper_pearson

_BINS = np.array([-np.inf, -9, -6, -4, -2, -1, 0, 1, 2, 4, 6, 9, np.inf])


def reliability(odds: np.ndarray, false: np.ndarray) -> list[tuple[float, float, float, float, int]]:
    """By bins of log-odds: mean belief, share that is right, its bounds of 95 %, number."""
    rows = []
    for low, high in pairwise(_BINS):
        own = (odds >= low) & (odds < high)
        n, right = int(own.sum()), int((own & ~false).sum())
        if n:
            found = clopper_pearson(right, n)
            rows.append((float(expit(odds[own]).mean()), right / n, found.low, found.high, n))
    return rows


def draw(odds: np.ndarray, false: np.ndarray, path: Path) -> None:
    """Draw the reliability plot as a PNG file, log-odds on both axes."""
    rows = np.array(reliability(odds, false))
    figure = Figure(figsize=(5.0, 4.6), layout="constrained")
    axes = figure.subplots()
    log = logit(np.clip(rows[:, :4], 1e-5, 1 - 1e-5))
    axes.plot([-12, 12], [-12, 12], color="0.7", linewidth=1)
    axes.errorbar(log[:, 0], log[:, 1], [log[:, 1] - log[:, 2], log[:, 3] - log[:, 1]], fmt="o", color="C0")
    for x, y, n in zip(log[:, 0], log[:, 1], rows[:, 4], strict=True):
        axes.annotate(f"{n:.0f}", (x, y), xytext=(-4, 0), textcoords="offset points", ha="right", fontsize=8)
    ticks = np.array([1e-4, 0.01, 0.1, 0.5, 0.9, 0.99, 0.9999])
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_ticks(logit(ticks), [f"{t:g}" for t in ticks])
    axes.set(xlabel="believed", ylabel="is so", xlim=(-12, 12), ylim=(-12, 12))
    figure.savefig(path, dpi=150)
