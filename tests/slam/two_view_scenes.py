"""Points before two cameras, and how far a motion is from the true one."""

import numpy as np

from dslab.slam.optimization._se3 import so3_exp

K = np.array([[500.0, 0, 320], [0, 505, 240], [0, 0, 1]])


def rigid(translation, rotation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = so3_exp(*map(float, rotation)), translation
    return T


def project(T, points):
    q = points @ T[:3, :3].T + T[:3, 3]
    return q[:, :2] / q[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2]


def scene(kind, seed=0, n=300, outliers=0.3, baseline=0.4, noise=0.5):
    """T_2_1, points in camera 1, pixels of both, the first ``outliers`` share of them wrong."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3) * [1, 1, 0.05 if kind == "wall" else 0.3]
    T = rigid(baseline * direction / np.linalg.norm(direction), rng.normal(0, 0.04, 3))
    if kind == "rotation":
        T[:3, 3] = 0.0
    rays = np.column_stack([rng.uniform([60, 60], [580, 420], (n, 2)), np.ones(n)]) @ np.linalg.inv(K).T
    depth = {
        "plane": 4.0 / (rays @ [0.5, -0.3, 1.0]),
        "wall": 4.0 / (rays @ [0.5, -0.3, 1.0]),
        "corner": np.where(rays[:, 0] > 0, 4.0 / (rays @ [0.5, -0.3, 1.0]), 5.0 / (rays @ [-0.3, 0.2, 1.0])),
    }.get(kind, rng.uniform(2, 8, n))
    points = rays * depth[:, None]
    pixels = [project(np.eye(4), points), project(T, points)]
    pixels = [p + rng.normal(0, noise, p.shape) for p in pixels]
    wrong = int(outliers * n)
    pixels[1][:wrong] = rng.uniform([0, 0], [640, 480], (wrong, 2))
    return T, points, pixels[0], pixels[1], wrong


def rotation_error_deg(T, other):
    return np.degrees(np.linalg.norm(T[:3, :3] @ other[:3, :3].T - np.eye(3)) / np.sqrt(2))


def direction_error_deg(a, b):
    return np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)))
