"""Problems of bundle adjustment, with their truth."""

from dataclasses import dataclass, replace

import numpy as np

from dslab.slam.optimization._se3 import retract, so3_exp
from dslab.slam.optimization.pose import CHI2_2DOF

INTRINSICS = (500.0, 510.0, 320.0, 240.0)
DELTA = float(np.sqrt(CHI2_2DOF))


def rigid(translation, rotation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = so3_exp(*map(float, rotation)), translation
    return T


@dataclass
class Problem:
    T: np.ndarray
    fixed: np.ndarray
    points: np.ndarray
    camera: np.ndarray
    point: np.ndarray
    pixels: np.ndarray
    inv_sigma2: np.ndarray

    def arguments(self):
        return (
            self.T, self.fixed, self.points, self.camera, self.point, self.pixels, self.inv_sigma2,
            *INTRINSICS,
        )  # fmt: skip

    def reprojection(self, T, points):
        q = np.einsum("mij,mj->mi", T[self.camera, :3, :3], points[self.point]) + T[self.camera, :3, 3]
        return q[:, :2] / q[:, 2:] * INTRINSICS[:2] + INTRINSICS[2:]

    def whitened(self, T, points):
        return (self.reprojection(T, points) - self.pixels) * np.sqrt(self.inv_sigma2)[:, None]


def scene(seed=0, cameras=5, n_fixed=2, n_points=40, noise=1.0, spread=0.03):
    """The truth, and the same observations with poses and points moved off it."""
    rng = np.random.default_rng(seed)
    T = np.stack([
        rigid([-0.4 * k, *rng.normal(0, 0.05, 2)], rng.normal(0, 0.04, 3)) for k in range(cameras)
    ])  # fmt: skip
    points = rng.uniform([-2, -2, 4], [3, 2, 9], (n_points, 3))
    camera, point = np.divmod(np.arange(cameras * n_points), n_points)
    seen = rng.random(len(camera)) < 0.8
    seen[: 2 * n_points] = True  # every point is seen twice
    order = rng.permutation(np.flatnonzero(seen))
    camera, point = camera[order].astype(np.int32), point[order].astype(np.int32)
    sigma2 = 1.2 ** (2.0 * rng.integers(0, 8, len(order)))
    truth = Problem(
        T, np.arange(cameras) < n_fixed, points, camera, point, np.zeros((len(order), 2)), 1 / sigma2
    )
    truth.pixels = truth.reprojection(T, points)
    truth.pixels += noise * rng.normal(size=truth.pixels.shape) * np.sqrt(sigma2)[:, None]
    moved = T.copy()
    for k in range(n_fixed, cameras):
        moved[k] = rigid(rng.normal(0, spread, 3), rng.normal(0, spread / 3, 3)) @ T[k]
    return truth, replace(truth, T=moved, points=points + rng.normal(0, 2 * spread, points.shape))


def huber(residuals, delta):
    chi2 = (residuals**2).sum(axis=1)
    if delta <= 0:
        return residuals
    rho = np.where(chi2 > delta**2, 2 * delta * np.sqrt(chi2) - delta**2, chi2)
    return residuals * np.sqrt(rho / np.maximum(chi2, 1e-300))[:, None]


def moved(problem, step):
    """Poses and points after a step of the free cameras (twists), then of the points."""
    T, free = problem.T.copy(), np.flatnonzero(~problem.fixed)
    for k, twist in zip(free, step[: 6 * len(free)].reshape(-1, 6), strict=True):
        retract(problem.T[k], np.ascontiguousarray(twist), T[k])
    return T, problem.points + step[6 * len(free) :].reshape(-1, 3)


def n_parameters(problem):
    return 6 * int((~problem.fixed).sum()) + 3 * len(problem.points)
