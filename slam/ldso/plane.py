"""A window whose points all lie on one plane: its three unknowns are adjusted with the poses."""

import numpy as np

from dslab.slam.ldso.model import WindowModel, model_of
from dslab.slam.ldso.window import PARAMETERS, Window
from dslab.slam.optimization.least_squares import minimise

_DAMPING, _STEPS, _TOLERANCE = 1e-3, 20, 1e-4
_FLOOR = 1e-9  # of the information, where scale and what no image shows are free
_LEAST = 1e-3  # inverse depth of a point that the plane has behind the camera


def adjust_plane(window: Window, plane: np.ndarray, huber: float) -> np.ndarray:
    """Adjust poses, brightness and the plane on which the points of the first keyframe lie.

    Args:
        window: its poses, brightness and inverse depths are changed; its first keyframe stays.
        plane: (3,) to begin with; a pixel of ray r has the inverse depth r · plane.
        huber: residual beyond which it counts linearly, of 255.

    Returns:
        (3,) the plane; its scale is that of the poses.
    """
    problem = _Problem(window, plane, huber)
    minimise.py_func(
        _Problem.linearise, _Problem.propose, _Problem.accept, problem, problem.model.cost, _STEPS, _DAMPING,
        _TOLERANCE,
    )  # fmt: skip
    problem.restore()
    return problem.plane


class _Problem:
    """The plane's problem of least squares.

    Attributes:
        plane: (3,) its state, with the window's poses.
        model: of the residuals there.
    """

    def __init__(self, window: Window, plane: np.ndarray, huber: float) -> None:
        fx, fy, cx, cy = window.intrinsics[0]
        uv = window.active.uv
        self._rays = np.column_stack([(uv - [cx, cy]) / [fx, fy], np.ones(len(uv))])
        self._window, self._huber, self._taken = window, huber, window.active.seen >= 0
        others = sorted(window.slots[1:])
        self._rows = np.concatenate([np.arange(PARAMETERS * s, PARAMETERS * (s + 1)) for s in others])
        self.plane = np.asarray(plane, float)
        self.model = self._at(self.plane)
        self._trial = self.model, self.plane

    def _at(self, plane: np.ndarray) -> WindowModel:
        points = self._window.active
        points.inverse_depth = np.maximum(self._rays @ plane, _LEAST)
        return model_of(self._window, points, self._taken, self._huber)

    def linearise(self) -> None:
        """Take Jacobians where the window is."""
        for slot in self._window.slots:
            self._window.settle(slot)
        self.model = self._at(self.plane)

    def propose(self, damping: float) -> tuple[float, float]:
        """Move the window by a damped step; its cost there, and the gain that the model predicts."""
        model, rows, rays = self.model, self._rows, self._rays
        n = len(rows)
        H, g = np.empty((n + 3, n + 3)), np.concatenate([model.b[rows], rays.T @ model.gradient])
        H[:n, :n] = model.H[np.ix_(rows, rows)]
        H[n:, :n] = rays.T @ model.cross[:, rows]
        H[:n, n:] = H[n:, :n].T
        H[n:, n:] = rays.T @ (model.information[:, None] * rays)
        scale = 1.0 / np.sqrt(np.maximum(H.diagonal(), 1e-12))
        A = H * scale * scale[:, None]
        A[np.diag_indices_from(A)] += damping + _FLOOR
        x = -scale * np.linalg.solve(A, scale * g)
        step = np.zeros((self._window.size, PARAMETERS))
        step.ravel()[rows] = x[:n]
        self._window.move_to(step)
        plane = self.plane + x[n:]
        there = self._at(plane)
        self._trial = there, plane
        return there.cost, float(x @ (damping * H.diagonal() * x - g))

    def accept(self) -> bool:
        """Stay there."""
        self.model, self.plane = self._trial
        for slot in self._window.slots:
            self._window.settle(slot)
        return False

    def restore(self) -> None:
        """Move the window to the best state."""
        self._window.move_to(np.zeros_like(self._window.delta))
        self._at(self.plane)
