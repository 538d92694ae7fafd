"""Self-calibration: residual lens distortion and rolling shutter, estimated from a map and taken out."""

from dataclasses import dataclass, replace

import numpy as np

from dslab.slam.core.camera import PinholeCamera, distort_residual, undistort_residual
from dslab.slam.core.settings import Whole, setting, settings
from dslab.slam.map.adjustment import MapAdjustment, apply_adjustment
from dslab.slam.map.map import Map
from dslab.slam.mapping._local_problem import local_problem
from dslab.slam.optimization.lens import LensEstimate, estimate_lens


@settings
class SelfCalibrationConfig:
    """Settings of self-calibration."""

    at_keyframes: tuple[Whole, ...] = setting(
        (20, 25, 30, 40, 50, 60, 75, 95, 120, 150, 190, 240, 300, 370, 460),
        "sizes of the first map at which the lens is estimated; none: never",
    )
    min_significance: float = setting(
        18.5,
        "least significance of the first change: chi-square, 4 degrees of freedom (18.5: .1 % by chance)",
    )
    min_shift_px: float = setting(0.2, "least root mean square shift of the first change")
    min_readout_s: float = setting(0.005, "least read-out time with which the shutter is first known to roll")
    min_readout_significance: float = setting(
        100.0, "least significance of a rolling shutter; a global one reaches 60 on a drive, others hundreds"
    )
    max_share: float = setting(
        0.05, "largest shift of a point over the corner's distance from the centre", le=1
    )
    usual_shift_px: float = setting(
        2.0, "root mean square shift of usual calibrations: holds the lens on straight ways", gt=0
    )


@dataclass(frozen=True)
class Refinement:
    """A change of the camera, and a map adjusted to it.

    Attributes:
        camera: from now on.
        adjustment: of the map.
        significance: of the change.
        shift_px: root mean square shift of the map's observations.
    """

    camera: PinholeCamera
    adjustment: MapAdjustment
    significance: float
    shift_px: float

    def apply(self, map_: Map) -> None:
        """Take the change out of a map's keypoints, and adjust it.

        Args:
            map_: the one that was adjusted, which may have grown since.
        """
        for k in map_.keyframes():
            map_.take_features(k, map_.features(k).seen_by(self.camera))
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

    def refine(self, map_: Map, camera: PinholeCamera) -> Refinement | None:
        """Estimate lens and shutter from a map, which is left as it is.

        Args:
            map_: must not be changed meanwhile.
            camera: the one so far.

        Returns:
            The change if it is to be applied, else None.
        """
        a, view = map_.arrays, map_.view
        free = ~a.kf_bad[: map_.n_keyframes]
        cameras, points, obs_camera, obs_point, obs_keypoint = local_problem(
            a, map_.n_keyframes, map_.n_points, free, 0
        )
        intrinsics = view.intrinsics
        xy, rows = a.kp_xy[obs_keypoint], _row_shifts(map_, camera)[obs_keypoint]
        seen = distort_residual(xy + camera.readout_s * rows, camera.residual, intrinsics)

        def estimate(row_shifts: np.ndarray | None) -> LensEstimate:
            return estimate_lens(
                a.kf_T_cam_map[cameras], np.arange(len(cameras)) == 0, a.pt_xyz[points], obs_camera,
                obs_point, seen, view.inv_sigma2[a.kp_octave[obs_keypoint]], intrinsics, camera.residual,
                camera.readout_s, row_shifts, usual_shift_px=self.config.usual_shift_px,
            )  # fmt: skip

        found = estimate(rows)
        if not self._is_rolling(found, camera):
            found = estimate(None)
        refined = replace(camera, residual=found.residual, readout_s=found.readout_s)
        if not self._is_residual(found, map_):
            return None
        shift = undistort_residual(seen, found.residual, intrinsics) - found.readout_s * rows - xy
        shift_px = float(np.sqrt((shift**2).sum(axis=1).mean()))
        is_first = not any(camera.residual) and not camera.readout_s
        if not self._is_worth_it(found, shift_px, is_first):
            return None
        none = np.empty((0, 2), np.int64), np.empty(0, np.int32)
        adjustment = MapAdjustment(cameras, found.T_cam_map, points, found.points, *none)
        return Refinement(refined, adjustment, found.significance, shift_px)

    def _is_rolling(self, found: LensEstimate, camera: PinholeCamera) -> bool:
        """Return True if the shutter is known to roll, and reads an image before it takes the next one."""
        config = self.config
        is_significant = found.readout_significance >= config.min_readout_significance
        is_known = bool(camera.readout_s) or (is_significant and abs(found.readout_s) >= config.min_readout_s)
        return is_known and abs(found.readout_s) * camera.fps <= 1.0

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


def _row_shifts(map_: Map, camera: PinholeCamera) -> np.ndarray:
    """(n, 2) shift of each keypoint of the map per second of read-out time, 0 for culled keyframes."""
    a = map_.arrays
    shifts = np.zeros((a.kf_start[map_.n_keyframes], 2))
    for k in map_.keyframes():
        own, f = map_.keypoints(k), map_.features(k)
        shifts[own] = camera.row_shifts(f.xy_image, a.kp_xy[own], f.twist)
    return shifts
