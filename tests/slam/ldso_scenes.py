"""A textured, curved wall seen by a camera, with exact depths, and windows of keyframes that see it."""

import cv2
import numpy as np

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.direct.pyramid import Rectifier
from dslab.slam.direct.selection import select
from dslab.slam.ldso.config import DsoConfig, WindowConfig
from dslab.slam.ldso.points import Active, Immature
from dslab.slam.ldso.window import Keyframe, Window
from dslab.slam.optimization._se3 import retract

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


def depth_of(T_cam_map, surface=wall):
    """(H, W) exact depth, and (H, W, 2) place on a surface, by its depth at places."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    rays = np.stack([(x - CAMERA.cx) / CAMERA.fx, (y - CAMERA.cy) / CAMERA.fy, np.ones_like(x)], axis=-1)
    R, centre = T_cam_map[:3, :3].T, -T_cam_map[:3, :3].T @ T_cam_map[:3, 3]
    d = rays @ R.T
    depth = np.full((HEIGHT, WIDTH), 2.0)
    for _ in range(60):
        at = centre + depth[..., None] * d
        depth -= 0.7 * (at[..., 2] - surface(at[..., 0], at[..., 1])) / d[..., 2]
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


def selected(pyramid, host):
    """Selected pixels of a keyframe, of unknown depth."""
    found = select(pyramid, CONFIG.selection)
    return Immature.at(pyramid, host, found.xy.astype(float), found.scale, 0.5, CONFIG.photometric)


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
        found = selected(window.pyramids[slot], slot)
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


def round_room(angles, seed=0, radius=3.0, track=1.5, height=1.3):
    """Frames of a camera that goes round in a round room and looks outward; walls, floor, ceiling differ.

    Yields:
        image (H, W) uint8, T_world_cam (4, 4).
    """
    rng = np.random.default_rng(seed)
    textures = [cv2.GaussianBlur(rng.normal(size=(900, 2300)).astype(np.float32), (0, 0), 4) for _ in "wfc"]
    textures = [120 + 40 * t / t.std() for t in textures]
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    rays = np.stack([(x - CAMERA.cx) / CAMERA.fx, (y - CAMERA.cy) / CAMERA.fy, np.ones_like(x)], axis=-1)
    for a in angles:
        T = np.eye(4)
        T[:3, :3] = np.array([[np.sin(a), 0, np.cos(a)], [-np.cos(a), 0, np.sin(a)], [0, -1, 0]])
        T[:3, 3] = track * np.cos(a), track * np.sin(a), 0.1 * np.sin(3 * a)
        d, c = rays @ T[:3, :3].T, T[:3, 3]
        A, B = (d[..., :2] ** 2).sum(-1), d[..., :2] @ c[:2]
        wall = (-B + np.sqrt(B * B + A * (radius**2 - c[:2] @ c[:2]))) / A
        flat = (np.where(d[..., 2] > 0, height, -height) - c[2]) / np.where(d[..., 2] == 0, 1e-9, d[..., 2])
        at = c + np.minimum(wall, flat)[..., None] * d
        around = np.arctan2(at[..., 1], at[..., 0]) * 2290 / (2 * np.pi) + 1145
        image = _shown(textures[0], around, at[..., 2] * 300 + 450)
        for texture, part in ((textures[1], d[..., 2] > 0), (textures[2], d[..., 2] <= 0)):
            level = _shown(texture, at[..., 0] * 140 + 450, at[..., 1] * 140 + 450)
            image = np.where((flat < wall) & part, level, image)
        yield np.clip(image + rng.normal(0, 1.0, image.shape), 0, 255).astype(np.uint8), T


def _shown(texture, x, y):
    return cv2.remap(
        texture, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR, None, cv2.BORDER_WRAP
    )


def position_error(path, centres):
    """Root mean squared error over the length of the path, after alignment."""
    found, true = path.T_map_cam[:, :3, 3], centres[path.frames]
    a, b = found - found.mean(0), true - true.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = (s * sign.diagonal()).sum() / (a**2).sum()
    error = b - scale * a @ (u @ sign @ vt).T
    return np.sqrt((error**2).sum(1).mean()) / np.linalg.norm(np.diff(true, axis=0), axis=1).sum()
