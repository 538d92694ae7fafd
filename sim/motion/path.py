"""Smooth paths along a route's polyline, within its free space."""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from dslab.sim.worlds.base import Route
from dslab.sim.worlds.geometry.route import arc_length

STEP_M = 0.05
# Shares of the clearance for cutting corners and for wandering sideways; the rest is for the sway.
CORNER_SHARE = 0.6
WANDER_SHARE = 0.25
_WANDER_SIGMA_M = 2.0
_SOFTENING_M = 0.25
_SLOPE_M = 0.3  # distance over which the ground's slope is measured


def smooth_path(
    route: Route,
    rng: np.random.Generator,
    wander_sigma_m: float = _WANDER_SIGMA_M,
    softening_m: float = _SOFTENING_M,
) -> np.ndarray:
    """Return the route with rounded corners and a seeded, smooth sideways wander.

    Args:
        route: polyline and clearance, metres.
        rng: stream of this path.
        wander_sigma_m: distance over which the wander changes.
        softening_m: distance over which the direction changes where arcs meet straights.

    Returns:
        (M, 2) float64 points about ``STEP_M`` apart in plan, within the route's clearance; (M, 3) with the
        height of the ground if the route has one, its slopes softened as the corners are. Of a closed route
        the first point is not repeated.
    """
    corners = np.asarray(route.centre_m, float)
    if route.height_m is not None:
        corners = np.column_stack([corners, route.height_m])
    if route.closed and np.allclose(corners[0], corners[-1]):
        corners = corners[:-1]
    line = _round_corners(corners, CORNER_SHARE * route.clearance_m, route.closed)
    line = _resample(line, route.closed)
    # Softens the jumps of curvature where arcs meet straights; moves the line by millimetres.
    line = _soften(line, route.closed, softening_m)
    mode = "wrap" if route.closed else "nearest"
    wander = gaussian_filter1d(rng.standard_normal(len(line)), wander_sigma_m / STEP_M, mode=mode)
    wander *= WANDER_SHARE * route.clearance_m / max(float(np.abs(wander).max()), 1e-12)
    line[:, :2] += wander[:, None] * _normals(line[:, :2], route.closed)
    return _resample(line, route.closed)


def ground(line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height of the ground along a line of ``smooth_path``, and its slope.

    Returns:
        (M,) metres and (M,) radians, positive upward in the direction of travel; zeros without height.
    """
    if line.shape[1] == 2:
        return np.zeros(len(line)), np.zeros(len(line))
    grade = np.gradient(line[:, 2], arc_length(line[:, :2]))
    return line[:, 2], gaussian_filter1d(np.arctan(grade), _SLOPE_M / STEP_M, mode="nearest")


def _round_corners(corners: np.ndarray, budget_m: float, closed: bool) -> np.ndarray:
    """Replace corners by arcs that cut them by at most ``budget_m``."""
    count = len(corners)
    pieces = [] if closed else [corners[:1]]
    for i in range(count) if closed else range(1, count - 1):
        pieces.append(_arc(corners[i - 1], corners[i], corners[(i + 1) % count], budget_m))
    return np.vstack(pieces if closed else [*pieces, corners[-1:]])


def _arc(before: np.ndarray, at: np.ndarray, after: np.ndarray, budget_m: float) -> np.ndarray:
    """(n, 2) or (n, 3) points of the arc in place of the corner ``at``; heights are linear."""
    into, out = (at - before)[:2], (after - at)[:2]
    into_m, out_m = np.linalg.norm(into), np.linalg.norm(out)
    into, out = into / into_m, out / out_m
    turn = np.arccos(np.clip(into @ out, -1, 1))
    if turn < 1e-3:
        return at[None]
    # An arc of radius r passes the corner at a distance of r (1 / cos(turn / 2) - 1).
    half = turn / 2
    radius = min(budget_m / (1 / np.cos(half) - 1), 0.5 * min(into_m, out_m) / np.tan(half))
    side = np.sign(into[0] * out[1] - into[1] * out[0])
    begin = at[:2] - radius * np.tan(half) * into
    centre = begin + side * radius * np.array([-into[1], into[0]])
    first = np.arctan2(*(begin - centre)[::-1])
    angles = first + side * np.linspace(0, turn, max(4, int(radius * turn / STEP_M)))
    plan = centre + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    if len(at) == 2:
        return plan
    share = radius * np.tan(half) / np.array([into_m, out_m])
    ends = at[2] + share * [before[2] - at[2], after[2] - at[2]]
    return np.column_stack([plan, np.linspace(ends[0], ends[1], len(plan))])


def _resample(line: np.ndarray, closed: bool) -> np.ndarray:
    points = np.vstack([line, line[:1]]) if closed else line
    along = arc_length(points[:, :2])
    count = max(8, round(along[-1] / STEP_M))
    at = np.linspace(0, along[-1], count, endpoint=not closed)
    return np.column_stack([np.interp(at, along, column) for column in points.T])


def _soften(line: np.ndarray, closed: bool, over_m: float) -> np.ndarray:
    sigma = over_m / STEP_M
    if closed:
        return gaussian_filter1d(line, sigma, axis=0, mode="wrap")
    # Smoothed about its chord, so that the ends hardly move.
    chord = np.linspace(line[0], line[-1], len(line))
    return chord + gaussian_filter1d(line - chord, sigma, axis=0, mode="nearest")


def _normals(line: np.ndarray, closed: bool) -> np.ndarray:
    step = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0) if closed else np.gradient(line, axis=0)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    return np.column_stack([-step[:, 1], step[:, 0]])
