"""Rays of two cameras with common points, and the errors of a motion by definition."""

import numpy as np

from dslab.slam.initialization._two_view_errors import motion_errors
from dslab.slam.initialization._two_view_refinement import TUKEY
from dslab.slam.optimization._se3 import so3_exp

FOCAL = 500.0


def unit(v):
    return np.asarray(v, float) / np.linalg.norm(v)


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(unit(a) @ unit(b), -1, 1)))


def rigid(direction, turn):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = so3_exp(*map(float, turn)), unit(direction)
    return T


def views(seed, n=200, noise_px=0.0, direction=None, depth=(5, 20), outliers=0.0):
    """T_2_1, rays of both views and the noise, for points at a depth in baselines."""
    rng = np.random.default_rng(seed)
    T = rigid(rng.normal(size=3) if direction is None else direction, rng.normal(0, 0.05, 3))
    rays_1 = rng.uniform(-0.5, 0.5, (n, 2))
    points = np.column_stack([rays_1, np.ones(n)]) * rng.uniform(*depth, n)[:, None]
    moved_points = points @ T[:3, :3].T + T[:3, 3]
    rays_2 = moved_points[:, :2] / moved_points[:, 2:]
    rays = [r + noise_px / FOCAL * rng.normal(size=r.shape) for r in (rays_1, rays_2)]
    wrong = int(outliers * n)
    rays[1][:wrong] = rng.uniform(-0.5, 0.5, (wrong, 2))
    return T, rays[0], rays[1], np.full(n, max(noise_px, 0.1) / FOCAL)


def matches_of(rays_1, rays_2, sigma):
    """Matches as the kernels take them."""
    return np.ascontiguousarray(np.column_stack([rays_1, rays_2, sigma]).T)


def errors_of(T, rays_1, rays_2, sigma):
    out = np.empty((2, len(sigma)))
    R, t = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
    motion_errors(R, t, matches_of(rays_1, rays_2, sigma), out)
    return out


def errors_reference(T, rays_1, rays_2, sigma):
    """The errors match by match, from the essential matrix and the vanishing point of the ray."""
    R, t = T[:3, :3], T[:3, 3]
    E = np.cross(np.eye(3), t) @ R
    off, behind = [], []
    for p, q, s in zip(rays_1, rays_2, sigma, strict=True):
        h1, h2 = np.append(p, 1.0), np.append(q, 1.0)
        gradient2 = ((E @ h1)[:2] ** 2).sum() + ((E.T @ h2)[:2] ** 2).sum() + s**2 * (E[:2, :2] ** 2).sum()
        off.append(h2 @ E @ h1 / np.sqrt(gradient2) / s)
        ray = R @ h1
        if ray[2] <= 0:
            behind.append(-1 / s)
            continue
        infinity = ray / ray[2]
        end = h2 if t[2] >= 0 else infinity
        nearer = t[:2] - end[:2] * t[2]
        length = np.sqrt(2 * (nearer @ nearer + s**2 * (E[:2, :2] ** 2).sum()))
        behind.append(min(0.0, (h2 - infinity)[:2] @ nearer / length / s))
    return np.array(off), np.array(behind)


def loss(off, behind):
    """Tukey's loss, scaled to equal the square for small errors."""
    e2 = (off**2 + behind**2) / TUKEY**2
    return TUKEY**2 / 3 * np.where(e2 < 1, 1 - (1 - np.minimum(e2, 1)) ** 3, 1.0)
