"""Gauss-Newton model of the residuals of a window, by poses and brightness of its keyframes.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 2.3.
"""

from dataclasses import dataclass

import numpy as np

from dslab.slam.core.geometry import adjoint
from dslab.slam.direct._alignment_kernels import PATTERN
from dslab.slam.ldso._window_kernels import linearise_window, to_keyframes
from dslab.slam.ldso.points import Active
from dslab.slam.ldso.window import PARAMETERS, Window

LEAST_INFORMATION = 1e-6
_NO_SUMS = np.empty((0, 0, 9))


@dataclass(frozen=True)
class WindowModel:
    """Residuals at an estimate, and half of their cost as a quadratic form of a step from it.

    Attributes:
        cost: sum of the costs of all patterns.
        energy: (N, S) cost of each residual.
        seen: (N, S) int8: 1 where the point looks alike, 0 where it does not, -1 where it is not seen.
        information, gradient: (N,) on the inverse depths.
        cross: (N, 8 S) of inverse depths with the parameters of keyframes.
        H, b: (8 S, 8 S), (8 S,) of the keyframes, for fixed depths.
    """

    cost: float
    energy: np.ndarray
    seen: np.ndarray
    information: np.ndarray
    gradient: np.ndarray
    cross: np.ndarray
    H: np.ndarray
    b: np.ndarray

    def eliminated(self, damping: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """What the Schur complement over the inverse depths takes off ``H`` and ``b``."""
        known = self.information > LEAST_INFORMATION
        root = np.sqrt(self.information[known] * (1.0 + damping))
        scaled = self.cross[known]
        scaled /= root[:, None]
        # The product of a matrix with itself takes half the work.
        return scaled.T @ scaled, scaled.T @ (self.gradient[known] / root)

    def depth_steps(self, step: np.ndarray, damping: float = 0.0) -> np.ndarray:
        """(N,) steps of the inverse depths that belong to a step (8 S,) of the keyframes."""
        known = self.information > LEAST_INFORMATION
        information = np.where(known, self.information * (1.0 + damping), np.inf)
        return -(self.gradient + self.cross @ step) / information


def model_of(
    window: Window, points: Active, taken: np.ndarray, huber: float, sums: np.ndarray = _NO_SUMS
) -> WindowModel:
    """Model of points at the window's present estimate; Jacobians of the poses at the first ones.

    Args:
        window: the keyframes.
        points: N points, of the window or some of them.
        taken: (N, S) bool, the residuals that count.
        huber: residual beyond which it counts linearly, of 255.
        sums: (N, S, 9) zeros, which get the sums over the patterns as of ``linearise_window``.
    """
    n, size = len(points), window.size
    energy, seen = np.empty((n, size)), np.empty((n, size), np.int8)
    information, gradient, cross = np.empty(n), np.empty(n), np.empty((n, size, PARAMETERS))
    H, b = np.empty((size, size, PARAMETERS, PARAMETERS)), np.empty((size, size, PARAMETERS))
    total = np.empty((size, size))
    linearise_window(
        window.images, window.intrinsics[0], PATTERN, points.host, points.uv, points.inverse_depth,
        points.intensity, points.weight, taken, window.motions(), window.motions(first=True),
        window.brightness(), huber, window.outlier, energy, seen, information, gradient, cross, H, b, total,
        sums,
    )  # fmt: skip
    of_host, of_target = pair_derivatives(window)
    by_keyframe = np.empty_like(cross)
    to_keyframes(points.host, cross, of_host, of_target, by_keyframe)
    full_H, full_b = _assembled(H, b, of_host, of_target)
    return WindowModel(
        float(total.sum()),
        energy,
        seen,
        information,
        gradient,
        by_keyframe.reshape(n, PARAMETERS * size),
        full_H,
        full_b,
    )


def pair_derivatives(window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the parameters of pairs by those of host and target, (S, S, 8, 8) at [host, target].

    They are taken at the first estimates.
    """
    size = window.size
    T, affine = window.motions(first=True), window.affine_first
    of_host = np.zeros((size, size, PARAMETERS, PARAMETERS))
    of_target = np.tile(np.eye(PARAMETERS), (size, size, 1, 1))
    of_host[..., :6, :6] = -adjoint(T)
    gain = np.exp(affine[None, :, 0] - affine[:, None, 0])
    shift = gain * affine[:, None, 1]
    of_host[..., 6, 6], of_host[..., 7, 6], of_host[..., 7, 7] = -1.0, shift, -gain
    of_target[..., 7, 6] = -shift
    return of_host, of_target


def of_keyframes(pairs: np.ndarray, of_host: np.ndarray, of_target: np.ndarray) -> np.ndarray:
    """(8 S, K) sum of terms (S, S, 8, K) with parameters of pairs, as terms with those of keyframes."""
    by_host = np.einsum("htmn,htmk->hnk", of_host, pairs)
    by_target = np.einsum("htmn,htmk->tnk", of_target, pairs)
    return (by_host + by_target).reshape(-1, pairs.shape[-1])


def _assembled(
    H: np.ndarray, b: np.ndarray, of_host: np.ndarray, of_target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sum of the models of pairs as one of keyframes, (8 S, 8 S) and (8 S,)."""
    size = len(H)
    full = np.zeros((size, PARAMETERS, size, PARAMETERS))
    gradient = of_keyframes(b[..., None], of_host, of_target)
    A, B = np.swapaxes(of_host, -1, -2) @ H, np.swapaxes(of_target, -1, -2) @ H
    rows = np.arange(size)
    full[rows, :, rows] += (A @ of_host).sum(axis=1) + (B @ of_target).sum(axis=0)
    mixed = A @ of_target
    full += mixed.transpose(0, 2, 1, 3) + mixed.transpose(1, 3, 0, 2)
    return full.reshape(size * PARAMETERS, -1), gradient.reshape(-1)
