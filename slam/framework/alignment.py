"""Two trajectories of the same frames: the similarity between them, and whether it can be believed.

Orientations alone give the rotation, as a straight path leaves it open: the median of the single ones by
Weiszfeld's algorithm. Positions give the rest, by weights that make it a median too; the scale is Horn's
symmetric one, which neither side's noise biases.

A similarity is believed if its quarters are: the frames are cut where each quarter of the motion lies behind,
and each has a similarity of its own. From the four scales follows how well theirs is known: the interval that
holds it in 95 of 100 cases (Student's t of three degrees of freedom) has to lie within what a seam may be off
by. So have the four rotations, and what is left of the positions against the motion. Trajectories that drift,
that differ in scale from place to place, or that only turn, do not. Two halves do not tell: their one
difference may be small by chance.

Where both maps have points, a frame sees those of either side in the same places, and the ratio of their
depths is the scale. It needs no motion, and hundreds of pairs tell it, where a quarter's positions are a few.

Source: Hartley, Aftab, Trumpf, "L1 rotation averaging using the Weiszfeld algorithm", 2011; Horn,
"Closed-form solution of absolute orientation using unit quaternions", 1987, Sec. 2.D.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.settings import setting, settings
from dslab.slam.optimization.sim3 import moved, sim3_decompose, sim3_matrix

_ROUNDS = 20
_LEAST_ANGLE = 1e-4  # rad; nearer ones count alike
_LEAST_SHARE = 0.1  # of the median residual; smaller ones count alike
_QUARTERS = 4
_LEAST_QUARTER = 5
"""Poses of a quarter: their positions have a spread in all directions."""
LEAST_POSES = _QUARTERS * _LEAST_QUARTER
"""Common poses without which nothing is aligned."""
_T_95 = 3.182  # Student's t, three degrees of freedom, both sides
_NEAR_PX = 2.0
_LEAST_PAIRS = 10
"""Points nearer than ``_NEAR_PX`` in a frame are a pair, and fewer pairs tell no scale."""
_BEHIND = np.log(1.5)  # a pair whose ratio is so much beyond the scale of the positions is of two walls


@settings
class SeamConfig:
    """What a seam may be off by (:class:`experiments.evaluation.audit`), and an alignment with it."""

    scale_share: float = setting(0.1, "half of the interval of the scale, by its quarters", gt=0)
    rotation_deg: float = setting(5.0, "rotation of a quarter against that of all", gt=0)
    position_share: float = setting(0.05, "root mean square position left, of the motion", gt=0)
    window: int = setting(40, "most frames that are aligned, those nearest to the gap", ge=LEAST_POSES)


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


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Points of two maps that a camera sees.

    Attributes:
        camera: of both.
        a, b: (M, 3) and (N, 3) points of either map.
    """

    camera: PinholeCamera
    a: np.ndarray
    b: np.ndarray

    def scale(self, T_a: np.ndarray, T_b: np.ndarray, about: float, within: float, span: float) -> float:
        """Logarithm of the scale from map a to map b, by the depths in one frame.

        Points behind a wall have other ratios: what counts is where they are densest.

        Args:
            T_a, T_b: (4, 4) poses of the frame in either map.
            about, within: logarithm of the scale as it is known, and what it may be off by.
            span: width over which ratios are counted.

        Returns:
            The median of the densest ones; nan if they are too few.
        """
        (rays_a, z_a), (rays_b, z_b) = self._seen(self.a, T_a), self._seen(self.b, T_b)
        if not len(z_a):
            return np.nan
        apart, nearest = KDTree(rays_a).query(rays_b, distance_upper_bound=_NEAR_PX / self.camera.fx)
        near = np.isfinite(apart)
        ratios = np.sort(np.log(z_b[near] / z_a[nearest[near]]))
        ratios = ratios[np.abs(ratios - about) < within]
        ends = np.searchsorted(ratios, ratios + span)
        counts = ends - np.arange(len(ratios))
        if not len(ratios) or counts.max() < _LEAST_PAIRS:
            return np.nan
        first = int(counts.argmax())
        return float(np.median(ratios[first : ends[first]]))

    def _seen(self, points: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, 2) rays of the points in view, at depth 1, and (N,) their depths."""
        x = (points - T[:3, 3]) @ T[:3, :3]
        x = x[x[:, 2] > 0]
        rays, c = x[:, :2] / x[:, 2:], self.camera
        inside = (np.abs(rays) < [c.width_px / 2 / c.fx, c.height_px / 2 / c.fy]).all(axis=1)
        return rays[inside], x[inside, 2]


def align(T_a: np.ndarray, T_b: np.ndarray, config: SeamConfig, points: SeenPoints | None = None) -> Aligned:
    """Align poses (N, 4, 4), camera to map a, of the same frames with poses, camera to map b."""
    if len(T_a) < LEAST_POSES:
        return Aligned(np.eye(4), len(T_a), "too_short")
    S = similarity(T_a, T_b)
    parts = [slice(i, j) for i, j in pairwise(_cuts(T_b[:, :3, 3]))]
    quarters = [sim3_decompose(similarity(T_a[rows], T_b[rows])) for rows in parts]
    scales, span = np.log([s for s, _, _ in quarters]), np.log1p(config.scale_share)
    off = _off(scales)
    if points is not None:
        known = float(np.log(sim3_decompose(S)[0])), max(off, _BEHIND), span
        middles = [(rows.start + rows.stop) // 2 for rows in parts]
        by_depth = np.array([points.scale(T_a[k], T_b[k], *known) for k in middles])
        if np.isfinite(by_depth).all():
            off, S = _off(by_depth), similarity(T_a, T_b, float(np.exp(by_depth.mean())))
    R = np.array([R for _, R, _ in quarters])
    turned = np.rad2deg(Rotation.from_matrix(R @ sim3_decompose(S)[1].T).magnitude())
    spread = T_b[:, :3, 3] - T_b[:, :3, 3].mean(axis=0)
    motion = np.sqrt(12.0 * np.mean((spread**2).sum(axis=1)))  # length of a straight path of that spread
    left = np.sqrt(np.mean(residuals(S, T_a, T_b) ** 2))
    refused = ""
    if not left < config.position_share * motion:
        refused = "residual"
    elif not off < span:
        refused = "scale"
    elif not turned.max() < config.rotation_deg:
        refused = "rotation"
    return Aligned(S, len(T_a), refused)


def _off(scales: np.ndarray) -> float:
    """Half of the interval of the mean, of logarithms (4,) of scales."""
    return float(_T_95 * np.std(scales, ddof=1) / np.sqrt(_QUARTERS))


def _cuts(p: np.ndarray) -> list[int]:
    """Rows at which each quarter of the motion of positions (N, 3) begins, and N."""
    walked, n = np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1)), len(p)
    cuts = [0]
    for k in range(1, _QUARTERS):
        at = int(np.searchsorted(walked, k / _QUARTERS * walked[-1])) + 1
        cuts.append(min(max(at, cuts[-1] + _LEAST_QUARTER), n - (_QUARTERS - k) * _LEAST_QUARTER))
    return [*cuts, n]


def similarity(T_a: np.ndarray, T_b: np.ndarray, scale: float | None = None) -> np.ndarray:
    """(4, 4) robust similarity from map a to map b of poses (N, 4, 4) of the same frames.

    Its scale is theirs if none is given.
    """
    R = _median(T_b[:, :3, :3] @ np.swapaxes(T_a[:, :3, :3], 1, 2))
    a, b = T_a[:, :3, 3] @ R.T, T_b[:, :3, 3]
    weight, s, t = np.ones(len(a)), 1.0, np.zeros(3)
    for _ in range(_ROUNDS):
        share = weight / weight.sum()
        centre_a, centre_b = share @ a, share @ b
        spread_a, spread_b = (share @ ((x - c) ** 2).sum(axis=1) for x, c in ((a, centre_a), (b, centre_b)))
        s = scale or np.sqrt(max(spread_b, 1e-24) / max(spread_a, 1e-24))
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
