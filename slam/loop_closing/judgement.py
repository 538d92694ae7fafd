"""Judgement of a corrected copy of a map: do its own observations still fit?"""

import math
from dataclasses import dataclass

import numpy as np

from dslab.slam.core.settings import setting, settings
from dslab.slam.loop_closing.correction import Loop
from dslab.slam.map import _map_kernels as kernels
from dslab.slam.map.adjustment import MapAdjustment
from dslab.slam.map.map import Map
from dslab.slam.optimization import _ba_kernels as ba
from dslab.slam.optimization.pose import CHI2_2DOF


@settings
class JudgementConfig:
    """What a correction must not do."""

    max_stretched: float = setting(
        0.08, "largest share of observations that the correction alone makes misfit", le=1
    )
    max_lost: float = setting(0.03, "largest share of observations that global adjustment makes misfit", le=1)
    max_rise: float = setting(1.5, "largest factor on the squared error of those that fit", le=math.inf)
    min_ties: float = setting(0.4, "least share of the loop's matches that fit after it", le=1)


@dataclass(frozen=True)
class Judgement:
    """How a map fits after a correction.

    Attributes:
        lost: share of the observations that fitted before and no longer do.
        rise: factor on the mean squared error of those that still fit.
        ties: share of the loop's matches that fit.
    """

    lost: float
    rise: float
    ties: float

    def fault(self, config: JudgementConfig, adjusted: bool) -> str:
        """What speaks against the correction, before or after global adjustment; empty if nothing does."""
        if not adjusted:
            return "map_is_stretched" if self.lost > config.max_stretched else ""
        if self.lost > config.max_lost or self.rise > config.max_rise:
            return "map_does_not_fit"
        return "matches_do_not_fit" if self.ties < config.min_ties else ""


def judge(before: Map, corrected: Map, loop: Loop, adjustment: MapAdjustment | None = None) -> Judgement:
    """Compare a map with its corrected copy.

    Args:
        before: the map without the correction.
        corrected: its corrected copy, not adjusted; its keypoints have the same rows.
        loop: the loop that was corrected.
        adjustment: global adjustment of the copy, if it is to be judged.
    """
    a = corrected.arrays
    n = int(before.arrays.kf_start[before.n_keyframes])
    own = np.flatnonzero(before.arrays.kp_point[:n] >= 0)
    own = own[(a.kp_point[own] >= 0) & ~before.arrays.kf_bad[before.arrays.kp_keyframe[own]]]
    T, xyz = a.kf_T_cam_map[: corrected.n_keyframes].copy(), a.pt_xyz[: corrected.n_points].copy()
    if adjustment is not None:
        T[adjustment.keyframes], xyz[adjustment.points] = adjustment.T_cam_map, adjustment.xyz
    chi2_before = _chi2(before, before.arrays.kf_T_cam_map, before.arrays.pt_xyz, own)
    chi2_after = _chi2(corrected, T, xyz, own)
    fitted = chi2_before <= CHI2_2DOF
    fits = fitted & (chi2_after <= CHI2_2DOF)
    ties = _ties(before, corrected, loop, T, xyz)
    if not fits.any():
        return Judgement(1.0, np.inf, ties)
    rise = chi2_after[fits].mean() / max(chi2_before[fits].mean(), 1e-9)
    return Judgement(float(1 - fits.sum() / fitted.sum()), float(rise), ties)


def _ties(before: Map, corrected: Map, loop: Loop, T_cam_map: np.ndarray, xyz: np.ndarray) -> float:
    """Share of the loop's matches that are observations of the corrected copy, and fit; 0 without any."""
    if not len(loop.points):
        return 0.0
    a, points = corrected.arrays, loop.points.copy()
    kernels.resolve_points(a, points)
    rows = before.keypoints(loop.keyframe).start + loop.rows
    tied = rows[(points >= 0) & (a.kp_point[rows] == points)]
    return float((_chi2(corrected, T_cam_map, xyz, tied) <= CHI2_2DOF).sum() / len(rows))


def _chi2(m: Map, T_cam_map: np.ndarray, xyz: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(n,) squared errors of the observations in these rows of keypoints, in units of the variance."""
    a, view = m.arrays, m.view
    chi2, _ = ba.errors(
        T_cam_map, xyz, a.kp_keyframe[rows], a.kp_point[rows], a.kp_xy[rows],
        view.inv_sigma2[a.kp_octave[rows]], view.intrinsics,
    )  # fmt: skip
    return chi2
