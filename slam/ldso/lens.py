"""What a given calibration leaves of the lens, from the windows of direct sparse odometry.

Points of a window are seen in several keyframes, at different places of the image; where the lens is not as
it is said to be, no poses and depths explain all of them. Each window says how the four parameters of
``PinholeCamera.residual`` should change, with its poses, brightness and depths eliminated. Windows add up,
and how far they scatter says how sure their sum is.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, fdtrc

from dslab.slam.core.camera import PinholeCamera, Residual, distort_residual
from dslab.slam.ldso.adjustment import affine_prior, gauge
from dslab.slam.ldso.config import LensConfig, PhotometricConfig
from dslab.slam.ldso.model import LEAST_INFORMATION, WindowModel, model_of, of_keyframes, pair_derivatives
from dslab.slam.ldso.points import Active
from dslab.slam.ldso.window import PARAMETERS, Window

LENS = 4  # k1, k2, p1, p2
_GRID = 21
_LEAST_CONDITION = 1e-9


@dataclass(frozen=True)
class LensChange:
    """A change of the lens.

    Attributes:
        residual: from now on.
        shift_px: root mean square shift over the image.
        significance: chi-square with 4 degrees of freedom that is as rare by chance.
    """

    residual: Residual
    shift_px: float
    significance: float


class LensEstimator:
    """Adds up what the windows of a map say of the lens.

    Args:
        camera: as it is taken to be.
        config: settings.
    """

    def __init__(self, camera: PinholeCamera, config: LensConfig) -> None:
        self.config = config
        self._camera = camera
        self._keyframes = 0
        self._is_fresh = False
        self._H: list[np.ndarray] = []
        self._b: list[np.ndarray] = []

    def take(self, window: Window, photometric: PhotometricConfig) -> None:
        """Take an adjusted window into account, each few keyframes."""
        self._keyframes += 1
        if (
            self.config.every
            and self._keyframes % self.config.every == 0
            and len(window) >= window.config.fewest
        ):
            H, b = lens_information(window, photometric)
            values = np.linalg.eigvalsh(H) if np.isfinite(H).all() else np.zeros(LENS)
            if values[0] <= _LEAST_CONDITION * values[-1]:
                return  # it does not tell the parameters apart
            self._H.append(H)
            self._b.append(b)
            self._is_fresh = True

    def change(self, overlap: float) -> LensChange | None:
        """The change that is to be applied, if there is one; None until another window is taken.

        Args:
            overlap: number of windows that a keyframe is in, of those that were taken.
        """
        config, count = self.config, len(self._H)
        if count < config.least_windows or not self._is_fresh:
            return None
        self._is_fresh = False
        H = np.sum(self._H, axis=0)
        step = -np.linalg.solve(H, np.sum(self._b, axis=0))
        # Each window pulls away from the sum: by noise, if the lens is one and the same.
        pulls = [b + A @ step for A, b in zip(self._H, self._b, strict=True)]
        scatter = sum(p @ np.linalg.solve(A, p) for A, p in zip(self._H, pulls, strict=True))
        freedom = LENS * (count - 1) / overlap
        information = H * freedom / scatter
        significance = _as_chi_square(float(step @ information @ step), freedom)
        step = np.linalg.solve(information + self._prior(), information @ step)
        k1, k2, p1, p2 = (np.array(self._camera.residual) + step).tolist()
        residual = (k1, k2, p1, p2)
        shift = self._shifts() @ step
        shift_px = float(np.sqrt((shift**2).sum(axis=1).mean()))
        if significance < config.least_significance or shift_px < config.least_shift_px:
            return None
        return LensChange(residual, shift_px, significance) if self._is_residual(residual) else None

    def changed(self, camera: PinholeCamera) -> None:
        """Refer what was said to a camera with another residual."""
        step = np.array(camera.residual) - np.array(self._camera.residual)
        self._b = [b + A @ step for A, b in zip(self._H, self._b, strict=True)]
        self._camera = camera

    def _prior(self) -> np.ndarray:
        """(4, 4) information: residuals that shift pixels by a usual amount are what is to be expected."""
        shifts = self._shifts()
        return np.einsum("nim,nik->mk", shifts, shifts) / (len(shifts) * self.config.usual_shift_px**2)

    def _shifts(self) -> np.ndarray:
        """(N, 2, 4) shift of pixels all over the image by each parameter."""
        camera = self._camera
        rays = (_pixels(camera) - camera.intrinsics[2:]) / camera.intrinsics[:2]
        return displacements(rays) * camera.intrinsics[:2, None]

    def _is_residual(self, residual: Residual) -> bool:
        camera, xy = self._camera, _pixels(self._camera)
        shift = np.linalg.norm(distort_residual(xy, residual, camera.intrinsics) - xy, axis=1)
        corner = np.linalg.norm(xy - camera.intrinsics[2:], axis=1).max()
        return bool(shift.max() <= self.config.most_share * corner)


def _as_chi_square(squared: float, freedom: float) -> float:
    """What is as rare as a squared change in units of a covariance that was itself estimated.

    Args:
        squared: of all parameters.
        freedom: independent residuals that the covariance was estimated from.

    Returns:
        Chi-square with ``LENS`` degrees of freedom: of few windows, much less than ``squared``.
    """
    chance = fdtrc(LENS, freedom, squared / LENS)
    return float(chdtri(LENS, max(chance, np.finfo(float).tiny)))


def _pixels(camera: PinholeCamera) -> np.ndarray:
    """(N, 2) pixels all over the image."""
    x, y = np.meshgrid(
        np.linspace(0, camera.width_px - 1, _GRID), np.linspace(0, camera.height_px - 1, _GRID)
    )
    return np.column_stack([x.ravel(), y.ravel()])


def displacements(rays: np.ndarray) -> np.ndarray:
    """(..., 2, 4) derivatives of the displacement of image points (..., 2) by k1, k2, p1, p2."""
    x, y = rays[..., 0], rays[..., 1]
    r2 = x * x + y * y
    return np.stack(
        [
            np.stack([x * r2, x * r2 * r2, 2 * x * y, r2 + 2 * x * x], axis=-1),
            np.stack([y * r2, y * r2 * r2, r2 + 2 * y * y, 2 * x * y], axis=-1),
        ],
        axis=-2,
    )


@dataclass(frozen=True)
class LensModel:
    """Half of the cost of a window as a quadratic form of a change of the lens, beside the window's own.

    Attributes:
        window: model of poses, brightness and inverse depths, Jacobians at the present estimate.
        H, b: (4, 4), (4,) of the lens, all else fixed.
        with_depths: (N, 4) of the inverse depths with it.
        with_keyframes: (8 S, 4) of poses and brightness with it.
    """

    window: WindowModel
    H: np.ndarray
    b: np.ndarray
    with_depths: np.ndarray
    with_keyframes: np.ndarray


def lens_information(window: Window, photometric: PhotometricConfig) -> tuple[np.ndarray, np.ndarray]:
    """What an adjusted window says of the lens: (4, 4) and (4,) of the quadratic form of a change of it.

    Poses, brightness and inverse depths of the window are eliminated; what was marginalised is left out, as
    it rests on the lens as it was.
    """
    lens = lens_model(window, photometric)
    model, known = lens.window, lens.window.information > LEAST_INFORMATION
    scaled = lens.with_depths[known] / model.information[known, None]
    H, b = lens.H - lens.with_depths[known].T @ scaled, lens.b - scaled.T @ model.gradient[known]
    off_H, off_b = model.eliminated()
    strength, pull = affine_prior(window, photometric)
    A, a = model.H + np.diag(strength) - off_H, model.b + pull - off_b
    B = lens.with_keyframes - model.cross[known].T @ scaled
    rows = np.concatenate([np.arange(PARAMETERS * s, PARAMETERS * (s + 1)) for s in sorted(window.slots)])
    # A basis of all steps but those that no image determines.
    basis = np.linalg.qr(gauge(window)[rows], mode="complete")[0][:, 7:]
    A, B, a = basis.T @ A[np.ix_(rows, rows)] @ basis, basis.T @ B[rows], basis.T @ a[rows]
    scale = 1.0 / np.sqrt(np.maximum(A.diagonal(), 1e-12))
    A = A * scale * scale[:, None]
    A[np.diag_indices_from(A)] += 1e-10
    solved = scale[:, None] * np.linalg.solve(A, scale[:, None] * np.column_stack([B, a]))
    return H - B.T @ solved[:, :LENS], b - B.T @ solved[:, LENS]


def lens_model(window: Window, photometric: PhotometricConfig) -> LensModel:
    """Model of the residuals that look alike at the present estimate."""
    points = window.active
    sums = np.zeros((len(points), window.size, 9))
    with window.at_present():
        model = model_of(window, points, points.seen == 1, photometric.huber, sums)
        J, of_pair, of_depth = _derivatives(window, points)
        of_host, of_target = pair_derivatives(window)
    gxx, gxy, gyy, gxa, gya, gxb, gyb, gxr, gyr = np.moveaxis(sums, -1, 0)
    structure = np.stack([np.stack([gxx, gxy], -1), np.stack([gxy, gyy], -1)], -2)
    by_brightness = np.stack([np.stack([gxa, gxb], -1), np.stack([gya, gyb], -1)], -2)
    pulled = structure @ J  # (N, S, 2, 4)
    of_pairs = [np.swapaxes(of_pair, -1, -2) @ pulled, np.swapaxes(by_brightness, -1, -2) @ J]
    pairs = np.zeros((window.size, window.size, PARAMETERS, LENS))
    np.add.at(pairs, points.host, np.concatenate(of_pairs, axis=2))
    return LensModel(
        model,
        np.einsum("nsim,nsik->mk", J, pulled),
        np.einsum("nsim,nsi->m", J, np.stack([gxr, gyr], -1)),
        np.einsum("nsi,nsim->nm", of_depth, pulled),
        of_keyframes(pairs, of_host, of_target),
    )


def _derivatives(window: Window, points: Active) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives of the pixel of each point in each keyframe, (N, S, 2, ...).

    Returns:
        (N, S, 2, 4) by the lens, (N, S, 2, 6) by the motion host to keyframe, (N, S, 2) by inverse depth.
    """
    fx, fy, cx, cy = window.intrinsics[0]
    focal = np.array([fx, fy])
    T, d = window.motions()[points.host], points.inverse_depth[:, None]  # (N, S, 4, 4)
    ray = (points.uv - [cx, cy]) / focal
    R, t = T[..., :3, :3], T[..., :3, 3]
    X = R[..., :2] @ ray[:, None, :, None]
    X = X[..., 0] + R[..., 2] + t * d[..., None]
    z = np.where(X[..., 2] > 1e-6, X[..., 2], np.nan)[..., None]
    p = X[..., :2] / z
    of_ray = (R[..., :2, :2] - p[..., None] * R[..., 2:, :2]) / z[..., None]
    J = displacements(p) - of_ray @ displacements(ray)[:, None]
    x, y, near = p[..., 0], p[..., 1], d / z[..., 0]
    zero, one = np.zeros_like(x), np.ones_like(x)
    of_pair = np.stack(
        [
            np.stack([near * one, zero, -near * x, -x * y, 1 + x * x, -y], -1),
            np.stack([zero, near * one, -near * y, -(1 + y * y), x * y, x], -1),
        ],
        -2,
    )
    of_depth = (t[..., :2] - p * t[..., 2:]) / z
    # A point that is not seen in a keyframe has no residual there.
    return (
        np.nan_to_num(J * focal[:, None]),
        np.nan_to_num(of_pair * focal[:, None]),
        np.nan_to_num(of_depth * focal),
    )
