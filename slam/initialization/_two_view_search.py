"""Search for all relative poses that explain the matches of two views."""

import numpy as np

from dslab.slam.initialization._two_view_refinement import TUKEY, RefinedMotion, refined, tangent

_SAMPLE = 200
"""Most matches used by the search."""

_DIRECTIONS = 16
_AROUND = 8
_SAME_DEG = 2.0
_MOST = 10
"""Minima that are refined to convergence; all others explain far less."""

_MIN_SCALE = 1.0 / np.sqrt(12.0)
"""Least estimated noise as a share of the nominal, which is one pixel of the pyramid level.

Keypoints have integer pixels, and rounding alone causes this noise. Equally rounded keypoints may seem to
agree better: a small rotation then looks like a sideways motion, which keeps the keypoints' rows.
"""


def search_motions(
    starts: list[np.ndarray], rays_1: np.ndarray, rays_2: np.ndarray, sigma: np.ndarray
) -> tuple[list[RefinedMotion], float]:
    """Find the distinct minima of the robust cost, best first.

    Over a short baseline a rotation looks much like a sideways motion and the cost has several minima. The
    search starts from the given motions and, with the rotation of the best of these, from directions all
    around.

    Args:
        starts: (4, 4) motions camera 1 to camera 2, at least one.
        rays_1, rays_2: (N, 2) normalised keypoints.
        sigma: (N,) their nominal noise, normalised units.

    Returns:
        The minima, their errors in units of the estimated noise, and the estimated over the nominal noise.
    """
    every = slice(None, None, -(-len(sigma) // _SAMPLE))
    sample = tuple(np.ascontiguousarray(a[every]) for a in (rays_1, rays_2, sigma))
    rough = [refined(T, *sample, widest=2.0, iterations=10) for T in starts]
    T_best = min(rough, key=lambda m: m.cost).T_2_1
    for direction in _directions(_DIRECTIONS):
        T = T_best.copy()
        T[:3, 3] = direction
        turned = refined(T, *sample, widest=8.0, iterations=5, turn_only=True)
        rough.append(refined(turned.T_2_1, *sample, widest=4.0, iterations=15))
    minima = distinct([refined(m.T_2_1, rays_1, rays_2, sigma) for m in distinct(rough)[:_MOST]])
    scale = _noise(minima[0])
    return distinct([refined(m.T_2_1, rays_1, rays_2, sigma * scale, widest=2.0) for m in minima]), scale


def motions_around(
    motion: RefinedMotion, angle_deg: float, rays_1: np.ndarray, rays_2: np.ndarray, sigma: np.ndarray
) -> list[RefinedMotion]:
    """Find the best motions with a direction at a given angle from a motion's.

    The directions include the worst determined ones.

    Args:
        motion: the minimum to start from.
        angle_deg: the angle between the directions.
        rays_1, rays_2, sigma: as for :func:`refined`.
    """
    t = motion.T_2_1[:3, 3].copy()
    u, v = tangent(t)
    weakest = np.linalg.eigh(np.linalg.inv(motion.information)[3:, 3:])[1][:, 1]
    first = np.arctan2(weakest[1], weakest[0])
    angle = np.deg2rad(angle_deg)
    found = []
    for way in first + np.linspace(0.0, 2.0 * np.pi, _AROUND, endpoint=False):
        T = motion.T_2_1.copy()
        T[:3, 3] = np.cos(angle) * t + np.sin(angle) * (np.cos(way) * u + np.sin(way) * v)
        found.append(refined(T, rays_1, rays_2, sigma, widest=4.0, turn_only=True))
    return found


def distinct(motions: list[RefinedMotion]) -> list[RefinedMotion]:
    """Remove duplicates, keeping the best of each; lowest cost first."""
    motions = sorted(motions, key=lambda m: m.cost)
    directions = np.array([m.T_2_1[:3, 3] for m in motions])
    turns = np.array([m.T_2_1[:3, :3].ravel() for m in motions])
    cosines = np.minimum(directions @ directions.T, 0.5 * (turns @ turns.T - 1.0))
    same = cosines > np.cos(np.deg2rad(_SAME_DEG))
    kept: list[int] = []
    for k in range(len(motions)):
        if not same[k, kept].any():
            kept.append(k)
    return [motions[k] for k in kept]


def _noise(motion: RefinedMotion) -> float:
    """Robust standard deviation of the distances to the epipolar lines among the inliers."""
    off = np.abs(motion.errors[motion.costs < TUKEY**2 / 3.0, 0])
    return max(1.4826 * float(np.median(off)), _MIN_SCALE) if len(off) else 1.0


def _directions(n: int) -> np.ndarray:
    """(n, 3) unit vectors distributed over the sphere on a spiral."""
    k = np.arange(n) + 0.5
    polar, azimuth = np.arccos(1.0 - 2.0 * k / n), np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
