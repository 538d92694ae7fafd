"""Judgement of a corrected and adjusted copy of a map: do its own observations still fit?"""

from dataclasses import dataclass

import numpy as np

from slam.loop_closing.correction import Loop
from slam.loop_closing.global_adjustment import GlobalAdjustment
from slam.map import _map_kernels as kernels
from slam.map.map import Map
from slam.optimization import _ba_kernels as ba
from slam.optimization.pose import CHI2_2DOF


@dataclass(frozen=True)
class JudgementConfig:
    """What a correction must not do.

    Attributes:
        max_lost: largest share of the observations that fitted before the correction and no longer do after
            global adjustment.
        max_rise: largest factor on the mean squared error of the observations that still fit.
        min_ties: least share of the loop's matches that fit after it.
    """

    max_lost: float = 0.03
    max_rise: float = 1.3
    min_ties: float = 0.6


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

    def fault(self, config: JudgementConfig) -> str:
        """What speaks against the correction; empty if nothing does."""
        if self.ties < config.min_ties:
            return "matches_do_not_fit"
        if self.lost > config.max_lost or self.rise > config.max_rise:
            return "map_does_not_fit"
        return ""


def judge(before: Map, corrected: Map, adjustment: GlobalAdjustment, loop: Loop) -> Judgement:
    """Compare a map with its corrected copy after global adjustment.

    Args:
        before: the map without the correction.
        corrected: its corrected copy, not yet adjusted; its keypoints have the same rows.
        adjustment: of the copy.
        loop: the loop that was corrected.
    """
    a = corrected.arrays
    n = int(before.arrays.kf_start[before.n_keyframes])
    own = np.flatnonzero(before.arrays.kp_point[:n] >= 0)
    own = own[(a.kp_point[own] >= 0) & ~before.arrays.kf_bad[before.arrays.kp_keyframe[own]]]
    T, xyz = a.kf_T_cam_map[: corrected.n_keyframes].copy(), a.pt_xyz[: corrected.n_points].copy()
    T[adjustment.keyframes], xyz[adjustment.points] = adjustment.T_cam_map, adjustment.xyz
    chi2_before = _chi2(before, before.arrays.kf_T_cam_map, before.arrays.pt_xyz, own)
    chi2_after = _chi2(corrected, T, xyz, own)
    fitted = chi2_before <= CHI2_2DOF
    fits = fitted & (chi2_after <= CHI2_2DOF)
    points = loop.points.copy()
    kernels.resolve_points(a, points)
    rows = before.keypoints(loop.keyframe).start + loop.rows
    tied = (a.kp_point[rows] >= 0) & (a.kp_point[rows] == points)
    ties = np.zeros(len(rows), bool)
    ties[tied] = _chi2(corrected, T, xyz, rows[tied]) <= CHI2_2DOF
    tie_share = float(ties.mean()) if len(ties) else 0.0
    if not fits.any():
        return Judgement(1.0, np.inf, tie_share)
    return Judgement(
        float(1 - fits.sum() / fitted.sum()),
        float(chi2_after[fits].mean() / max(chi2_before[fits].mean(), 1e-9)),
        tie_share,
    )


def _chi2(m: Map, T_cam_map: np.ndarray, xyz: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(n,) squared errors of the observations in these rows of keypoints, in units of the variance."""
    a, view = m.arrays, m.view
    chi2, _ = ba.errors(
        T_cam_map, xyz, a.kp_keyframe[rows], a.kp_point[rows], a.kp_xy[rows],
        view.inv_sigma2[a.kp_octave[rows]], np.array([view.fx, view.fy, view.cx, view.cy]),
    )  # fmt: skip
    return chi2
