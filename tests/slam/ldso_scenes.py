"""A textured, curved wall seen by a camera, with exact depths, and windows of keyframes that see it."""

import cv2
import numpy as np

from slam.core.camera import PinholeCamera
from slam.direct.pyramid import Rectifier
from slam.ldso.config import DsoConfig, ImmatureConfig, WindowConfig
from slam.ldso.points import Active, Immature
from slam.ldso.window import Keyframe, Window
from slam.optimization._se3 import retract

WIDTH, HEIGHT = 320, 240
CAMERA = PinholeCamera(WIDTH, HEIGHT, 250.0, 250.0, 159.5, 119.5, 30.0)
RECTIFIER = Rectifier(CAMERA)
INTRINSICS = RECTIFIER.intrinsics
CONFIG = DsoConfig()
_NOISE = np.random.default_rng(1).normal(size=(1400, 1400)).astype(np.float32)
_TEXTURE = cv2.GaussianBlur(_NOISE, (0, 0), 5.0)
_TEXTURE = 120 + 40 * _TEXTURE / _TEXTURE.std()


def motion(twist):
    T = np.eye(4)
    retract(np.eye(4), np.asarray(twist, float), T)
    return T


def wall(x, y):
    """Depth of the wall at a place of it."""
    return 2.0 + 0.25 * np.sin(2.0 * x) + 0.2 * np.cos(1.5 * y) + 0.2 * x


def depth_of(T_cam_map):
    """(H, W) exact depth, and (H, W, 2) place on the wall."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    rays = np.stack([(x - CAMERA.cx) / CAMERA.fx, (y - CAMERA.cy) / CAMERA.fy, np.ones_like(x)], axis=-1)
    R, centre = T_cam_map[:3, :3].T, -T_cam_map[:3, :3].T @ T_cam_map[:3, 3]
    d = rays @ R.T
    depth = np.full((HEIGHT, WIDTH), 2.0)
    for _ in range(60):
        at = centre + depth[..., None] * d
        depth -= 0.7 * (at[..., 2] - wall(at[..., 0], at[..., 1])) / d[..., 2]
    return depth, (centre + depth[..., None] * d)[..., :2]


def view(T_cam_map, gain=1.0, offset=0.0):
    """Image of the wall, and its depth."""
    depth, at = depth_of(T_cam_map)
    place = (300 * at + 700).astype(np.float32)
    image = cv2.remap(_TEXTURE, place[..., 0], place[..., 1], cv2.INTER_CUBIC, None, cv2.BORDER_REFLECT)
    return np.clip(gain * image + offset, 0, 255).astype(np.uint8), depth


POSES = [
    motion(twist)
    for twist in (
        [0, 0, 0, 0, 0, 0],
        [0.1, 0.02, 0.02, 0.01, -0.02, 0.01],
        [0.2, -0.05, 0.05, -0.01, -0.03, 0.0],
        [0.25, 0.1, -0.05, 0.02, -0.06, 0.02],
    )
]


def window_of(poses=POSES, points=300, seed=0):
    """Window whose poses and depths are exact; its points are of all keyframes."""
    window = Window(CAMERA, INTRINSICS, WindowConfig())
    depths = []
    for number, T in enumerate(poses):
        image, depth = view(T)
        window.add(Keyframe(number, number / 10, T), RECTIFIER.pyramid(image), np.zeros(2))
        depths.append(depth)
    rng = np.random.default_rng(seed)
    for slot in window.slots:
        found = Immature.selected(window.pyramids[slot], slot, ImmatureConfig(), CONFIG.photometric)
        found = found.of(np.sort(rng.choice(len(found), points // len(poses), replace=False)))
        xy = found.uv.astype(int)
        n = len(found)
        seen = np.ones((n, window.size), np.int8)
        seen[:, slot] = -1
        seen[:, ~window.live] = -1
        more = Active(
            found.host, found.uv, found.intensity, found.weight, found.scale,
            1 / depths[slot][xy[:, 1], xy[:, 0]], np.ones(n), seen, np.ones(n, int),
        )  # fmt: skip
        window.active = window.active.with_more(more)
    return window


def smooth_level():
    """(H, W, 3) that bilinear interpolation and central differences reproduce exactly."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    level = np.empty((HEIGHT, WIDTH, 3), np.float32)
    level[..., 0] = 20 + 0.3 * x + 0.4 * y + 0.002 * x * y
    level[..., 1], level[..., 2] = 0.3 + 0.002 * y, 0.4 + 0.002 * x
    return level
