"""Self-calibration: residual lens distortion, estimated from the map and taken out of it."""

from dataclasses import dataclass

import numpy as np

from slam.core.camera import Residual, distort_residual, undistort_residual
from slam.map import _map_kernels as kernels
from slam.map.map import Map
from slam.mapping._local_problem import local_problem
from slam.optimization.lens import LensEstimate, estimate_lens


@dataclass(frozen=True)
class SelfCalibrationConfig:
    """Settings of self-calibration.

    Attributes:
        at_keyframes: numbers of keyframes of the first map at which the lens is estimated; none: never.
        min_significance: least significance of a change that is applied: chi-square with 2 degrees of
            freedom, 13.8 by chance once in a thousand.
        min_shift_px: least root mean square shift of the keypoints by a change that is applied.
        max_share: largest shift of a point at the image's corner over its distance from the centre; a larger
            one is no residual of a calibration, and is not applied.
    """

    at_keyframes: tuple[int, ...] = (20, 40, 80, 160)
    min_significance: float = 13.8
    min_shift_px: float = 0.2
    max_share: float = 0.05


@dataclass(frozen=True)
class Refinement:
    """A change of the lens that was applied to the map.

    Attributes:
        residual: the new coefficients.
        significance: of the change.
        shift_px: root mean square shift of the map's observations.
    """

    residual: Residual
    significance: float
    shift_px: float


class SelfCalibration:
    """Decides when the lens is estimated, and whether the estimate is applied.

    Args:
        config: settings.
    """

    def __init__(self, config: SelfCalibrationConfig) -> None:
        self.config = config
        self._pending = sorted(config.at_keyframes)

    def is_due(self, map_: Map) -> bool:
        """Return True, once for each of the numbers set, when the map has so many keyframes."""
        count = len(map_.keyframes())
        due = bool(self._pending) and count >= self._pending[0]
        while self._pending and count >= self._pending[0]:
            self._pending.pop(0)
        return due

    def calibrate(self, map_: Map, residual: Residual) -> Refinement | None:
        """Estimate the lens and take its change out of the map, or leave the map as it is.

        Args:
            map_: adjusted as a whole, its keypoints moved.
            residual: the coefficients so far.

        Returns:
            The change if it was applied, else None.
        """
        a, view = map_.arrays, map_.view
        free = ~a.kf_bad[: map_.n_keyframes]
        cameras, points, obs_camera, obs_point, obs_keypoint = local_problem(
            a, map_.n_keyframes, map_.n_points, free, 0
        )
        intrinsics = np.array([view.fx, view.fy, view.cx, view.cy])
        end = a.kf_start[map_.n_keyframes]
        seen = distort_residual(a.kp_xy[:end], residual, intrinsics)
        found = estimate_lens(
            a.kf_T_cam_map[cameras], np.arange(len(cameras)) == 0, a.pt_xyz[points], obs_camera, obs_point,
            seen[obs_keypoint], view.inv_sigma2[a.kp_octave[obs_keypoint]], intrinsics, residual,
        )  # fmt: skip
        if found.significance < self.config.min_significance or not self._is_residual(found, map_):
            return None
        xy = undistort_residual(seen, found.residual, intrinsics)
        shift = (xy - a.kp_xy[:end])[obs_keypoint]
        shift_px = float(np.sqrt((shift**2).sum(axis=1).mean()))
        if shift_px < self.config.min_shift_px:
            return None
        a.kp_xy[:end] = xy
        a.kf_T_cam_map[cameras], a.pt_xyz[points] = found.T_cam_map, found.points
        kernels.refresh_geometries(a, points, view.scale)
        return Refinement(found.residual, found.significance, shift_px)

    def _is_residual(self, found: LensEstimate, map_: Map) -> bool:
        """Return True if the distortion is small all over the image, corners included."""
        view = map_.view
        corner = np.hypot(
            max(view.x_max - view.cx, view.cx - view.x_min) / view.fx,
            max(view.y_max - view.cy, view.cy - view.y_min) / view.fy,
        )
        r2 = np.linspace(0.0, corner, 20) ** 2
        shares = np.abs(r2 * (found.residual[0] + r2 * found.residual[1]))
        return bool(np.all(shares <= self.config.max_share))
