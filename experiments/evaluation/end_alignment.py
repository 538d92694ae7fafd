"""Alignment error between start and end: how far a path drifts where the truth is known at both ends only.

Source: Engel, Usenko and Cremers, "A photometrically calibrated benchmark for monocular visual odometry",
2016, Sec. IV: the path is aligned to its start and to its end, and the two are compared over all frames. The
rotation is that of the orientations here, as straight ends leave that of the positions open.
"""

import numpy as np

from dslab.experiments.evaluation.alignment import Similarity, Undefined, align_poses
from dslab.experiments.evaluation.metrics import rms
from dslab.slam.core.results import MapTrajectory

END_S = 10.0
"""Length of start and end, or a third of what is known if that is less."""


def end_alignment_error_m(
    path: MapTrajectory, stamps_s: np.ndarray, T_world_cam: np.ndarray
) -> float | Undefined:
    """RMS over all poses of their distance when aligned to the start and when aligned to the end, metres.

    Args:
        path: the main map's.
        stamps_s: (N,) times of all frames.
        T_world_cam: (N, 4, 4) true poses, NaN where unknown.

    Returns:
        The error; Undefined if the path does not reach both ends of the truth.
    """
    known = np.isfinite(T_world_cam).all(axis=(1, 2))
    if not known.any():
        return Undefined("no truth")
    first_s, last_s = stamps_s[known][[0, -1]]
    length_s = min(END_S, (last_s - first_s) / 3)
    times_s = stamps_s[path.frames]
    has_truth = known[path.frames]
    positions = []
    for name, inside in (("start", times_s <= first_s + length_s), ("end", times_s >= last_s - length_s)):
        chosen = inside & has_truth
        aligned = align_poses(path.T_map_cam[chosen], T_world_cam[path.frames[chosen]])
        if not isinstance(aligned, Similarity):
            return Undefined(f"at its {name}: {aligned.reason}")
        positions.append(aligned.points(path.T_map_cam[:, :3, 3]))
    return rms(np.linalg.norm(positions[0] - positions[1], axis=1))
