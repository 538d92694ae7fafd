"""How much of its way a system knows where it is: one figure for accuracy and completeness together."""

import numpy as np

from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.metrics import PosePairs

LEAST, MOST = 0.001, 0.1
"""Position errors, over the length of the true path, from which a share of the path is credited in part."""


def step_errors(pairs: PosePairs, T_world_cam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors along the whole true path.

    Args:
        pairs: poses of the main map, beside the truth.
        T_world_cam: (N, 4, 4) true poses of all frames, metres, NaN where unknown.

    Returns:
        Length of each step between consecutive frames with truth, over that of the path, and the larger
        position error of its two ends after Sim(3) alignment over all poses, over that of the path; infinite
        where one has no pose. Empty if the true path does not move.
    """
    known = np.flatnonzero(np.isfinite(T_world_cam).all(axis=(1, 2)))
    lengths_m = np.linalg.norm(np.diff(T_world_cam[known, :3, 3], axis=0), axis=1)
    path_m = float(lengths_m.sum())
    if not path_m > 0:
        return np.zeros(0), np.zeros(0)
    errors_m = np.full(len(T_world_cam), np.inf)
    found = metrics.ate(pairs) if len(pairs) else Undefined("no pose")
    if not isinstance(found, Undefined):
        errors_m[pairs.frames] = found.errors_m
    own = errors_m[known]
    return lengths_m / path_m, np.maximum(own[:-1], own[1:]) / path_m


def share_within(shares: np.ndarray, errors: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Share of the true path on which the error is at most each threshold (t,), from :func:`step_errors`."""
    # Shares that make up the whole may sum to a little more than 1.
    return np.array([min(1.0, float(shares[errors <= threshold].sum())) for threshold in thresholds])


def robustness(pairs: PosePairs, T_world_cam: np.ndarray) -> float | None:
    """Area under the share of the true path within an error threshold, from 0 to 1.

    The mean of :func:`share_within` over thresholds from LEAST to MOST of the path length, uniform in their
    logarithm. A part of the path without a pose is within no threshold: getting lost early is not rewarded,
    as by an ATE of the few poses that are left. A system that is off by LEAST everywhere has 1, one that is
    off by MOST or has posed nothing 0.

    Args:
        pairs, T_world_cam: as of :func:`step_errors`.

    Returns:
        The area; None if the true path does not move.

    Source: ours; systems are ranked by such an area in the ETH3D SLAM benchmark (Schöps, Sattler, Pollefeys,
        "BAD SLAM", CVPR 2019), over datasets instead of along a path and with errors in metres.
    """
    shares, errors = step_errors(pairs, T_world_cam)
    if not len(shares):
        return None
    with np.errstate(divide="ignore"):
        credit = np.log(MOST / errors) / np.log(MOST / LEAST)
    return min(1.0, float((shares * np.clip(credit, 0.0, 1.0)).sum()))
