"""What a correction does to a map's own observations."""

import numpy as np

from dslab.slam.map.map import Map
from dslab.slam.optimization import _ba_kernels as ba
from dslab.slam.optimization.pose import CHI2_2DOF


def torn(before: Map, corrected: Map) -> float:
    """Share of the observations that fit in a map and no longer do in its corrected copy.

    Args:
        before: the map without the correction.
        corrected: its corrected copy, not adjusted; its keypoints have the same rows.
    """
    a = corrected.arrays
    n = int(before.arrays.kf_start[before.n_keyframes])
    own = np.flatnonzero(before.arrays.kp_point[:n] >= 0)
    own = own[(a.kp_point[own] >= 0) & ~before.arrays.kf_bad[before.arrays.kp_keyframe[own]]]
    fitted = own[_fits(before, own)]
    return float(1 - _fits(corrected, fitted).mean()) if len(fitted) else 1.0


def _fits(m: Map, rows: np.ndarray) -> np.ndarray:
    """(n,) bool, whether the observations in these rows of keypoints do."""
    a, view = m.arrays, m.view
    chi2, _ = ba.errors(
        a.kf_T_cam_map, a.pt_xyz, a.kp_keyframe[rows], a.kp_point[rows], a.kp_xy[rows],
        view.inv_sigma2[a.kp_octave[rows]], view.intrinsics,
    )  # fmt: skip
    return np.asarray(chi2 <= CHI2_2DOF)
