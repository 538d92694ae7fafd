"""Self-calibration: residual lens distortion, estimated from a map and taken out of it."""

from dataclasses import dataclass

import numpy as np

from slam.core.camera import Residual, distort_residual, undistort_residual
from slam.core.geometry import ViewGeometry
from slam.map.adjustment import MapAdjustment, apply_adjustment
from slam.map.map import Map
from slam.mapping._local_problem import local_problem
from slam.optimization.lens import LensEstimate, estimate_lens


@dataclass(frozen=True)
class SelfCalibrationConfig:
    """Settings of self-calibration.

    Attributes:
        at_keyframes: numbers of keyframes of the first map at which the lens is estimated; none: never. The
            estimate adjusts the whole map, which takes drift out of it too: once the lens is known to be
            off, each one is applied.
        min_significance: least significance of the first change that is applied: chi-square with 4 degrees
            of freedom, 18.5 by chance once in a thousand. Those after it need none.
        min_shift_px: least root mean square shift of the keypoints by the first change.
        max_share: largest shift of a point over the distance of the image's corner from the centre; a larger
            one is no residual of a calibration, and is not applied.
        usual_shift_px: root mean square shift of the keypoints by which calibrations are usually off. On a
            straight way a change of the lens looks much like a drift of scale: without this, the estimate
            may be several times too large there.
    """

    at_keyframes: tuple[int, ...] = (20, 25, 30, 40, 50, 60, 75, 95, 120, 150, 190, 240, 300, 370, 460)
    min_significance: float = 18.5
    min_shift_px: float = 0.2
    max_share: float = 0.05
    usual_shift_px: float = 2.0


@dataclass(frozen=True)
class Refinement:
    """A change of the lens, and a map adjusted to it.

    Attributes:
        before, residual: the coefficients before and after.
        adjustment: of the map.
        significance: of the change.
        shift_px: root mean square shift of the map's observations.
    """

    before: Residual
    residual: Residual
    adjustment: MapAdjustment
    significance: float
    shift_px: float

    def apply(self, map_: Map) -> None:
        """Take the change out of a map's keypoints, and adjust it.

        Args:
            map_: the one that was adjusted, which may have grown since.
        """
        a, end = map_.arrays, map_.arrays.kf_start[map_.n_keyframes]
        a.kp_xy[:end] = _retaken(a.kp_xy[:end], self.before, self.residual, map_.view)
        apply_adjustment(map_, self.adjustment)


class SelfCalibration:
    """Decides when the lens is estimated, and whether an estimate is applied.

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

    def refine(self, map_: Map, residual: Residual) -> Refinement | None:
        """Estimate the lens from a map, which is left as it is.

        Args:
            map_: must not be changed meanwhile.
            residual: the coefficients so far.

        Returns:
            The change if it is to be applied, else None.
        """
        a, view = map_.arrays, map_.view
        free = ~a.kf_bad[: map_.n_keyframes]
        cameras, points, obs_camera, obs_point, obs_keypoint = local_problem(
            a, map_.n_keyframes, map_.n_points, free, 0
        )
        intrinsics = view.intrinsics
        xy = a.kp_xy[obs_keypoint]
        found = estimate_lens(
            a.kf_T_cam_map[cameras], np.arange(len(cameras)) == 0, a.pt_xyz[points], obs_camera, obs_point,
            distort_residual(xy, residual, intrinsics), view.inv_sigma2[a.kp_octave[obs_keypoint]],
            intrinsics, residual, usual_shift_px=self.config.usual_shift_px,
        )  # fmt: skip
        if not self._is_residual(found, map_):
            return None
        shift = _retaken(xy, residual, found.residual, view) - xy
        shift_px = float(np.sqrt((shift**2).sum(axis=1).mean()))
        if not self._is_worth_it(found, shift_px, first=not any(residual)):
            return None
        none = np.empty((0, 2), np.int64), np.empty(0, np.int32)
        adjustment = MapAdjustment(cameras, found.T_cam_map, points, found.points, *none)
        return Refinement(residual, found.residual, adjustment, found.significance, shift_px)

    def _is_worth_it(self, found: LensEstimate, shift_px: float, first: bool) -> bool:
        significant = found.significance >= self.config.min_significance
        return not first or (significant and shift_px >= self.config.min_shift_px)

    def _is_residual(self, found: LensEstimate, map_: Map) -> bool:
        """Return True if the distortion is small all over the image, corners included."""
        view = map_.view
        x, y = np.meshgrid(np.linspace(view.x_min, view.x_max, 21), np.linspace(view.y_min, view.y_max, 21))
        xy = np.column_stack([x.ravel(), y.ravel()])
        shift = np.linalg.norm(distort_residual(xy, found.residual, view.intrinsics) - xy, axis=1)
        corner = np.linalg.norm(xy - view.intrinsics[2:], axis=1).max()
        return bool(shift.max() <= self.config.max_share * corner)


def _retaken(xy: np.ndarray, before: Residual, after: Residual, view: ViewGeometry) -> np.ndarray:
    """(N, 2) pixels undistorted with one residual, as another one undistorts them."""
    return undistort_residual(distort_residual(xy, before, view.intrinsics), after, view.intrinsics)
