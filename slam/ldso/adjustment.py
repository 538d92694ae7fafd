"""Photometric bundle adjustment of a window.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 2.3.
Where it says less, damping and the bounds of outliers follow the authors' public code.
"""

from dataclasses import dataclass

import numpy as np

from dslab.slam.ldso.config import PhotometricConfig
from dslab.slam.ldso.model import WindowModel, model_of
from dslab.slam.ldso.window import PARAMETERS, Window

_DAMPING = 1e-4
_LEAST_DAMPING = 1e-5
_MOST_DAMPING = 1e5
_STILL_PX = 0.01  # a smaller step of all keyframes is none
_LEAST_GAIN = 1e-3  # share of the cost; a step that gains less is the last one
_PATTERN = 8


@dataclass(frozen=True)
class Adjusted:
    """Outcome of an adjustment.

    Attributes:
        before, after: cost of the residuals with that of the priors.
        steps: Gauss-Newton steps that were taken.
        error: root of the mean cost of a pixel in residuals that look alike, of 255.
    """

    before: float
    after: float
    steps: int
    error: float


def adjust(window: Window, photometric: PhotometricConfig, iterations: int | None = None) -> Adjusted:
    """Adjust poses, brightness and inverse depths; residuals that do not look alike at the end are removed.

    Args:
        window: changed.
        photometric: settings.
        iterations: most steps; those of the window's settings by default.
    """
    points, huber = window.active, photometric.huber
    taken = points.seen >= 0
    model = model_of(window, points, taken, huber)
    cost = before = model.cost + _prior_cost(window, photometric)
    damping, steps = _DAMPING, 0
    for _ in range(window.config.iterations if iterations is None else iterations):
        step = _step(window, model, photometric, damping)
        delta, depths = window.delta.copy(), points.inverse_depth.copy()
        window.move_to(delta + step.reshape(-1, PARAMETERS))
        moved = depths + model.depth_steps(step, damping)
        points.inverse_depth = np.where(moved > 0, moved, 0.5 * depths)
        there = model_of(window, points, taken, huber)
        cost_there = there.cost + _prior_cost(window, photometric)
        gain = cost - cost_there
        if gain > 0:
            model, cost, steps = there, cost_there, steps + 1
            damping = max(0.25 * damping, _LEAST_DAMPING)
        else:
            window.move_to(delta)
            points.inverse_depth = depths
            damping = min(100.0 * damping, _MOST_DAMPING)
        if _is_still(window, step) or 0 < gain < _LEAST_GAIN * cost:
            break
    _bound_outliers(window, model)
    alike = model.seen == 1
    points.seen = np.where(alike, model.seen, np.int8(-1))
    points.observed = np.maximum(points.observed, alike.sum(axis=1))
    points.information = model.information
    for slot in window.slots:
        if not window.prior_H[_rows(slot)].any():
            window.settle(slot)
    error = float(np.sqrt(model.energy[alike].sum() / max(1, _PATTERN * alike.sum())))
    return Adjusted(before, cost, steps, error)


def _step(window: Window, model: WindowModel, photometric: PhotometricConfig, damping: float) -> np.ndarray:
    """(8 S,) step of the keyframes; none along what no residual determines."""
    H, b = model.H + window.prior_H, model.b + window.prior_b + window.prior_H @ window.delta.ravel()
    information, pull = affine_prior(window, photometric)
    H[np.diag_indices_from(H)] += information
    b = b + pull
    off_H, off_b = model.eliminated(damping)
    damped = H + np.diag(damping * H.diagonal())
    rows = np.concatenate([np.arange(8 * s, 8 * s + 8) for s in sorted(window.slots)])
    A, g = (damped - off_H)[np.ix_(rows, rows)], (b - off_b)[rows]
    scale = 1.0 / np.sqrt(np.maximum(H.diagonal()[rows], 1e-12))
    A = A * scale * scale[:, None]
    A[np.diag_indices_from(A)] += 1e-10
    x = -scale * np.linalg.solve(A, scale * g)
    step = np.zeros(len(b))
    step[rows] = x
    free = gauge(window)
    return step - free @ (free.T @ step)


def gauge(window: Window) -> np.ndarray:
    """(8 S, 7) orthonormal directions that no image determines: place, orientation and scale of it all."""
    directions = np.zeros((window.size, PARAMETERS, 7))
    for s in window.slots:
        R, t = window.T_cam_map[s, :3, :3], window.T_cam_map[s, :3, 3]
        directions[s, :3, :3] = R
        directions[s, 3:6, 3:6] = R
        directions[s, :3, 3:6] = np.cross(t[None, :], R.T).T
        directions[s, :3, 6] = t
    return np.linalg.qr(directions.reshape(-1, 7))[0]


def affine_prior(window: Window, photometric: PhotometricConfig) -> tuple[np.ndarray, np.ndarray]:
    """Information (8 S,) on the brightness of keyframes, and its pull, half the gradient of the cost."""
    information = np.zeros((window.size, PARAMETERS))
    information[window.slots, 6:] = photometric.affine_prior
    pull = information.copy()
    pull[:, 6:] *= window.affine - window.expected
    return information.ravel(), pull.ravel()


def _prior_cost(window: Window, photometric: PhotometricConfig) -> float:
    delta = window.delta.ravel()
    _, pull = affine_prior(window, photometric)
    unexpected = window.affine - window.expected
    brightness = float(pull.reshape(-1, PARAMETERS)[:, 6:].ravel() @ unexpected.ravel())
    return float(delta @ window.prior_H @ delta + 2.0 * window.prior_b @ delta) + brightness


def _bound_outliers(window: Window, model: WindowModel) -> None:
    """Bound the residuals of the newest keyframe by what most of them are."""
    config, slot = window.config, window.newest
    energy = model.energy[model.seen[:, slot] >= 0, slot]
    if not len(energy):
        return
    usual = config.outlier_factor * np.sqrt(np.quantile(energy, config.outlier_quantile) / _PATTERN)
    window.outlier[slot] = _PATTERN * (0.5 * (usual + config.outlier_usual)) ** 2


def _is_still(window: Window, step: np.ndarray) -> bool:
    """True if a step moves no keyframe visibly."""
    by_slot = np.abs(step.reshape(-1, PARAMETERS)[window.slots])
    fx = window.intrinsics[0][0]
    usual = float(np.median(window.active.inverse_depth)) if len(window.active) else 1.0
    return bool(by_slot[:, :3].max() * usual * fx < _STILL_PX and by_slot[:, 3:6].max() * fx < _STILL_PX)


def _rows(slot: int) -> slice:
    return slice(PARAMETERS * slot, PARAMETERS * (slot + 1))
