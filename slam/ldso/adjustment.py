"""Photometric bundle adjustment of a window.

Images determine neither where a window lies nor how large it is. Where nothing is held, what is known worst
moves most and drags the rest along: in blur a tenth of the scale within a second. So the oldest keyframes
hold, which most images have placed.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 2.3. Ours: what is held.
The driver of least squares is the lab's one.
"""

from dataclasses import dataclass, replace

import numpy as np

from dslab.slam.ldso.config import PhotometricConfig
from dslab.slam.ldso.model import WindowModel, model_of
from dslab.slam.ldso.window import PARAMETERS, Window, bound_of
from dslab.slam.optimization.least_squares import minimise

_DAMPING = 1e-4
_STILL_PX = 0.01  # a smaller step of all keyframes is none
_PATTERN = 8
_OLDER = 10.0  # squares of steps of a keyframe count so many times those of the next one


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


@dataclass(frozen=True)
class DepthPrior:
    """Where inverse depths are expected.

    Attributes:
        information: on each, in units of the residuals' variance.
        mean: (N,) of them.
    """

    information: float
    mean: np.ndarray


def adjust(
    window: Window,
    photometric: PhotometricConfig,
    iterations: int | None = None,
    depth_prior: DepthPrior | None = None,
    tolerance: float = 1e-3,
) -> Adjusted:
    """Adjust poses, brightness and inverse depths; residuals that do not look alike at the end are removed.

    Args:
        window: changed.
        photometric: settings.
        iterations: most steps; those of the window's settings by default.
        depth_prior: where inverse depths are expected, if anywhere.
        tolerance: share of the cost; a step that gains less is the last one.
    """
    points = window.active
    problem = _Problem(window, photometric, depth_prior)
    before = problem.cost
    cost, steps = minimise.py_func(
        _Problem.linearise, _Problem.propose, _Problem.accept, problem, before,
        window.config.iterations if iterations is None else iterations, _DAMPING, tolerance,
    )  # fmt: skip
    problem.restore()
    model, newest = problem.model, window.newest
    energy = model.energy[model.seen[:, newest] >= 0, newest]
    if len(energy):
        window.outlier[newest] = bound_of(energy, points, photometric.huber)
    alike = model.seen == 1
    points.seen = np.where(alike, model.seen, np.int8(-1))
    points.observed = np.maximum(points.observed, alike.sum(axis=1))
    points.information = model.information
    for slot in window.slots:
        if not window.prior_H[_rows(slot)].any():
            window.settle(slot)
    error = float(np.sqrt(model.energy[alike].sum() / max(1, _PATTERN * alike.sum())))
    return Adjusted(before, cost, steps, error)


class _Problem:
    """A window as a problem of least squares: its state is the step from the first estimates, and depths.

    Attributes:
        cost: of the residuals and the priors.
        model: of the residuals.
    """

    def __init__(
        self, window: Window, photometric: PhotometricConfig, depth_prior: DepthPrior | None
    ) -> None:
        self._window, self._photometric, self._depth_prior = window, photometric, depth_prior
        self._taken = window.active.seen >= 0
        self._delta, self._depths = window.delta.copy(), window.active.inverse_depth
        self.cost, self.model = self._at()
        self._still = False
        self._trial = self.model, self._delta, self._depths

    def _at(self) -> tuple[float, WindowModel]:
        """Cost and model where the window is."""
        window = self._window
        model = model_of(window, window.active, self._taken, self._photometric.huber)
        cost, prior = model.cost + _prior_cost(window, self._photometric), self._depth_prior
        if prior is not None:
            off = window.active.inverse_depth - prior.mean
            cost += prior.information * float(off @ off)
            model = replace(
                model,
                information=model.information + prior.information,
                gradient=model.gradient + prior.information * off,
            )
        return cost, model

    def linearise(self) -> None:
        """Nothing: each cost comes with its model."""

    def propose(self, damping: float) -> tuple[float, float]:
        """Move the window by a damped step; its cost there, and the gain that the model predicts."""
        window, model = self._window, self.model
        step, predicted = _step(window, model, self._photometric, damping)
        window.move_to(self._delta + step.reshape(-1, PARAMETERS))
        along = model.depth_steps(step, damping)
        predicted += float(along @ (damping * model.information * along - model.gradient))
        moved = self._depths + along
        window.active.inverse_depth = np.where(moved > 0, moved, 0.5 * self._depths)
        cost, there = self._at()
        self._still = _is_still(window, step)
        self._trial = there, window.delta.copy(), window.active.inverse_depth
        return cost, predicted

    def accept(self) -> bool:
        """Stay there; true if that was hardly a step."""
        self.model, self._delta, self._depths = self._trial
        return self._still

    def restore(self) -> None:
        """Move the window to the best state."""
        self._window.move_to(self._delta)
        self._window.active.inverse_depth = self._depths


def _step(
    window: Window, model: WindowModel, photometric: PhotometricConfig, damping: float
) -> tuple[np.ndarray, float]:
    """(8 S,) step of the keyframes, the oldest held, and their part of the gain."""
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
    step = np.zeros(len(b))
    step[rows] = -scale * np.linalg.solve(A, scale * g)
    step = held(window, step)
    return step, float(step @ (damping * H.diagonal() * step - b))


def held(window: Window, step: np.ndarray) -> np.ndarray:
    """A step (8 S,) moved along what no image determines, until the oldest keyframes move least."""
    free = np.linalg.qr(gauge(window))[0]
    weight = np.zeros((window.size, PARAMETERS))
    weight[window.slots] = (_OLDER ** -np.arange(len(window)))[:, None]
    weighed = free * weight.reshape(-1, 1)
    return step - free @ np.linalg.solve(weighed.T @ free, weighed.T @ step)


def gauge(window: Window) -> np.ndarray:
    """(8 S, 7) directions that no image determines: orientation, place and scale of it all."""
    directions = np.zeros((window.size, PARAMETERS, 7))
    for s in window.slots:
        R, t = window.T_cam_map[s, :3, :3], window.T_cam_map[s, :3, 3]
        directions[s, :3, :3] = R
        directions[s, 3:6, 3:6] = R
        directions[s, :3, 3:6] = np.cross(t[None, :], R.T).T
        directions[s, :3, 6] = t
    return directions.reshape(-1, 7)


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


def _is_still(window: Window, step: np.ndarray) -> bool:
    """True if a step moves no keyframe visibly."""
    by_slot = np.abs(step.reshape(-1, PARAMETERS)[window.slots])
    fx = window.intrinsics[0][0]
    usual = float(np.median(window.active.inverse_depth)) if len(window.active) else 1.0
    return bool(by_slot[:, :3].max() * usual * fx < _STILL_PX and by_slot[:, 3:6].max() * fx < _STILL_PX)


def _rows(slot: int) -> slice:
    return slice(PARAMETERS * slot, PARAMETERS * (slot + 1))
