"""Two trajectories of the same frames: the similarity between them, and whether it can be believed.

Orientations alone give the rotation, as a straight path leaves it open: the median of the single ones by
Weiszfeld's algorithm. Positions give the rest, by weights that make it a median too; the scale is Horn's
symmetric one, which neither side's noise biases.

A similarity is believed if its halves are: the frames are cut where half of the motion lies behind, and each
half has a similarity of its own. They agree in scale and rotation, and what is left of the positions is small
against the motion, within what a seam may be off by. Trajectories that drift, that differ in scale from place
to place, or that only turn, do not.

Source: Hartley, Aftab, Trumpf, "L1 rotation averaging using the Weiszfeld algorithm", 2011; Horn,
"Closed-form solution of absolute orientation using unit quaternions", 1987, Sec. 2.D.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.slam.core.settings import setting, settings
from dslab.slam.optimization.sim3 import moved, sim3_decompose, sim3_matrix

_ROUNDS = 20
_LEAST_ANGLE = 1e-4  # rad; nearer ones count alike
_LEAST_SHARE = 0.1  # of the median residual; smaller ones count alike
_LEAST_HALF = 5
"""Poses of a half: five tell a scale that agrees from one that happens to."""


@settings
class SeamConfig:
    """How far two halves may differ: what a seam may be off by (:class:`experiments.evaluation.audit`)."""

    scale_share: float = setting(0.1, "difference of the halves' scales, of one of them", gt=0)
    rotation_deg: float = setting(5.0, "difference of the halves' rotations", gt=0)
    position_share: float = setting(0.05, "root mean square position left, of the motion", gt=0)
    window: int = setting(40, "most frames that are aligned, those nearest to the gap", ge=10)


@dataclass(frozen=True, eq=False)
class Aligned:
    """A similarity between two trajectories.

    Attributes:
        S_b_a: (4, 4) similarity from the one's map to the other's.
        poses: number of common frames.
        refused: why it is not believed: ``too_short``, ``scale``, ``rotation``, ``residual``; empty if it is.
    """

    S_b_a: np.ndarray
    poses: int
    refused: str


def align(T_a: np.ndarray, T_b: np.ndarray, config: SeamConfig) -> Aligned:
    """Align poses (N, 4, 4), camera to map a, of the same frames with poses, camera to map b."""
    if len(T_a) < 2 * _LEAST_HALF:
        return Aligned(np.eye(4), len(T_a), "too_short")
    S = similarity(T_a, T_b)
    walked = np.cumsum(np.linalg.norm(np.diff(T_b[:, :3, 3], axis=0), axis=1))
    cut = int(np.searchsorted(walked, 0.5 * walked[-1])) + 1
    cut = min(max(cut, _LEAST_HALF), len(T_a) - _LEAST_HALF)
    halves = [sim3_decompose(similarity(T_a[rows], T_b[rows])) for rows in (slice(cut), slice(cut, None))]
    (s_1, R_1, _), (s_2, R_2, _) = halves
    turned = np.rad2deg(Rotation.from_matrix(R_1 @ R_2.T).magnitude())
    spread = T_b[:, :3, 3] - T_b[:, :3, 3].mean(axis=0)
    motion = np.sqrt(12.0 * np.mean((spread**2).sum(axis=1)))  # length of a straight path of that spread
    left = np.sqrt(np.mean(residuals(S, T_a, T_b) ** 2))
    refused = ""
    if not left < config.position_share * motion:
        refused = "residual"
    elif not abs(np.log(s_1 / s_2)) < np.log1p(config.scale_share):
        refused = "scale"
    elif not turned < config.rotation_deg:
        refused = "rotation"
    return Aligned(S, len(T_a), refused)


def similarity(T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray:
    """(4, 4) robust similarity from map a to map b of poses (N, 4, 4) of the same frames."""
    R = _median(T_b[:, :3, :3] @ np.swapaxes(T_a[:, :3, :3], 1, 2))
    a, b = T_a[:, :3, 3] @ R.T, T_b[:, :3, 3]
    weight, s, t = np.ones(len(a)), 1.0, np.zeros(3)
    for _ in range(_ROUNDS):
        share = weight / weight.sum()
        centre_a, centre_b = share @ a, share @ b
        spread_a, spread_b = (share @ ((x - c) ** 2).sum(axis=1) for x, c in ((a, centre_a), (b, centre_b)))
        s = np.sqrt(max(spread_b, 1e-24) / max(spread_a, 1e-24))
        t = centre_b - s * centre_a
        left = np.linalg.norm(b - s * a - t, axis=1)
        weight = 1.0 / np.maximum(left, _LEAST_SHARE * np.median(left) + 1e-12)
    return sim3_matrix(float(s), R, t)


def residuals(S_b_a: np.ndarray, T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray:
    """(N,) distances of positions in b from those of a, moved there."""
    return np.linalg.norm(T_b[:, :3, 3] - moved(S_b_a, T_a)[:, :3, 3], axis=1)


def _median(R: np.ndarray) -> np.ndarray:
    """(3, 3) median of rotations (N, 3, 3) by angle."""
    found = Rotation.from_matrix(R).mean()
    for _ in range(_ROUNDS):
        off = (Rotation.from_matrix(R) * found.inv()).as_rotvec()
        weight = 1.0 / np.maximum(np.linalg.norm(off, axis=1), _LEAST_ANGLE)
        found = Rotation.from_rotvec(weight @ off / weight.sum()) * found
    return found.as_matrix()
