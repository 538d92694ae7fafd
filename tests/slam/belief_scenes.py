"""Views as the model of beliefs has them, drawn from it."""

import numpy as np
from scipy.special import expit, logit

from dslab.slam.belief.model import Parameters, Sight

GIVEN = Parameters()
APART = 3.0  # of the keypoints that show a point, and of those that do not, in deviations


def seen(rng, alike, given=GIVEN, most_cells=14):
    """A view of a place in which the share ``alike`` of the cells is as the map has it."""
    cells = rng.integers(min(4, most_cells - 2), most_cells)
    cell = np.repeat(np.arange(cells), rng.integers(2, 12, cells))
    n = len(cell)
    visible = rng.integers(3, 40, n).astype(float)
    found = rng.binomial(visible.astype(int), rng.beta(6, 3, n)).astype(float)
    angle, zoom = rng.gamma(1.5, 0.05, n), rng.normal(0, 0.3, n)
    fall = (
        given.angle * angle
        + given.farther * np.sqrt(np.maximum(zoom, 0))
        + given.nearer * np.maximum(-zoom, 0)
    )
    usual = given.rate * logit((found + 1) / (visible + 2)) + given.offset - fall
    usual += (given.view + given.fall * fall) * rng.normal() + given.surface * rng.normal(size=cells)[cell]
    shows = (rng.random(n) < expit(usual)) & (rng.random(cells) < alike)[cell]
    x = rng.normal(APART * shows, 1.0)
    return Sight(
        np.arange(n), cell, np.exp(APART * x - APART**2 / 2), found, visible, angle, zoom, np.zeros(3)
    )
