"""Window of keyframes: their images, poses, brightness, points, and what is left of those that went.

Source: Engel, Koltun, Cremers, "Direct Sparse Odometry", 2018, Sec. 2.3 and 3.1.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import FrameFeatures
from dslab.slam.direct.pyramid import ImagePyramid
from dslab.slam.ldso.brightness import relative_of_all
from dslab.slam.ldso.config import WindowConfig
from dslab.slam.ldso.points import Active, Immature
from dslab.slam.optimization._se3 import retract

PARAMETERS = 8  # of a keyframe: translation, rotation, a, b
_FIRST_OUTLIER = 8.0  # residual, of 255, beyond which the first keyframe's patterns are outliers


@dataclass(eq=False)
class Keyframe:
    """A keyframe of a map, kept with its points when it has left the window.

    Attributes:
        frame: index of its frame.
        stamp_s: time of it.
        T_cam_map: (4, 4) map to camera.
        uv, inverse_depth: (N, 2) pixels and (N,) inverse depths of its points that have left the window.
        corners: features of its corners; None without loops.
        image: (H, W) uint8 as taken, while it is in the window.
        exposure: logarithm of its exposure over that of the first image; 0 where exposures are not known.
    """

    frame: int
    stamp_s: float
    T_cam_map: np.ndarray
    uv: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    inverse_depth: np.ndarray = field(default_factory=lambda: np.empty(0))
    corners: FrameFeatures | None = None
    image: np.ndarray | None = None
    exposure: float = 0.0

    def keep(self, points: Active) -> None:
        """Keep points of it that leave the window."""
        self.uv = np.concatenate([self.uv, points.uv])
        self.inverse_depth = np.concatenate([self.inverse_depth, points.inverse_depth])

    def map_points(self, intrinsics: np.ndarray) -> np.ndarray:
        """(N, 3) its points that have left the window, in the map."""
        fx, fy, cx, cy = intrinsics
        rays = np.column_stack([(self.uv - [cx, cy]) / [fx, fy], np.ones(len(self.uv))])
        R, t = self.T_cam_map[:3, :3], self.T_cam_map[:3, 3]
        return (rays / self.inverse_depth[:, None] - t) @ R


class Window:
    """Keyframes that are adjusted together, each in a slot.

    Args:
        camera: of the images.
        intrinsics: (L, 4) of the levels of a pyramid.
        config: settings.

    Attributes:
        slots: (n,) slots in use, in order of time.
        keyframes, pyramids: theirs, by slot.
        images: (S, H, W, 3) float32 finest levels of the keyframes, by slot.
        T_cam_map: (S, 4, 4) poses; T_first those at which Jacobians are taken.
        affine: (S, 2) brightness; affine_first likewise.
        expected: (S, 2) brightness by the exposures.
        delta: (S, 8) step from the first estimates.
        outlier: (S,) cost of a pattern beyond which it is not that surface.
        active, immature: points.
        gone: (S,) number of points of each keyframe that were active and left.
        prior_H, prior_b: (8 S, 8 S) and (8 S,) what marginalised keyframes and points say, about the first
            estimates.
    """

    def __init__(self, camera: PinholeCamera, intrinsics: np.ndarray, config: WindowConfig) -> None:
        size = config.most + 1
        self.config = config
        self.intrinsics = intrinsics
        self.slots: list[int] = []
        self.keyframes: dict[int, Keyframe] = {}
        self.pyramids: dict[int, ImagePyramid] = {}
        self.images = np.full((size, camera.height_px, camera.width_px, 3), np.nan, np.float32)
        self.T_cam_map = np.tile(np.eye(4), (size, 1, 1))
        self.T_first = self.T_cam_map.copy()
        self.affine, self.affine_first = np.zeros((size, 2)), np.zeros((size, 2))
        self.expected = np.zeros((size, 2))
        self.delta = np.zeros((size, PARAMETERS))
        self.outlier = np.zeros(size)
        self.gone = np.zeros(size, int)
        self.active = Active.none(size)
        self.immature = Immature.none()
        self.prior_H = np.zeros((PARAMETERS * size, PARAMETERS * size))
        self.prior_b = np.zeros(PARAMETERS * size)

    def __len__(self) -> int:
        return len(self.slots)

    @property
    def newest(self) -> int:
        """Slot of the newest keyframe."""
        return self.slots[-1]

    @property
    def live(self) -> np.ndarray:
        """(S,) bool slots in use."""
        live = np.zeros(len(self.images), bool)
        live[self.slots] = True
        return live

    @property
    def size(self) -> int:
        """Number of slots."""
        return len(self.images)

    def add(
        self, keyframe: Keyframe, pyramid: ImagePyramid, affine: np.ndarray, outlier: float | None = None
    ) -> int:
        """Add a keyframe; its slot. All active points get a residual in it."""
        slot = next(s for s in range(self.size) if s not in self.slots)
        self.slots.append(slot)
        self.keyframes[slot] = keyframe
        self.see(slot, pyramid)
        self.T_cam_map[slot] = self.T_first[slot] = keyframe.T_cam_map
        self.affine[slot] = self.affine_first[slot] = affine
        self.expected[slot, 0] = keyframe.exposure
        self.delta[slot], self.gone[slot] = 0.0, 0
        self.outlier[slot] = 8 * _FIRST_OUTLIER**2 if outlier is None else outlier
        self.active.seen[:, slot] = 1
        return slot

    def remove(self, slot: int) -> None:
        """Remove a keyframe without points."""
        self.slots.remove(slot)
        self.keyframes[slot].image = None
        del self.keyframes[slot], self.pyramids[slot]
        self.active.seen[:, slot] = -1
        self.immature = self.immature.of(self.immature.host != slot)

    def motions(self, first: bool = False) -> np.ndarray:
        """(S, S, 4, 4) motions, host to target at [host, target]."""
        T = self.T_first if first else self.T_cam_map
        inverse = np.linalg.inv(T)
        return np.ascontiguousarray(np.einsum("tij,hjk->htik", T, inverse))

    def brightness(self) -> np.ndarray:
        """(S, S, 2) brightness of target relative to host at [host, target]."""
        return relative_of_all(self.affine)

    def move_to(self, delta: np.ndarray) -> None:
        """Set poses and brightness to a step (S, 8) from the first estimates."""
        self.delta[:] = delta
        for s in self.slots:
            retract(self.T_first[s], np.ascontiguousarray(delta[s, :6]), self.T_cam_map[s])
            self.affine[s] = self.affine_first[s] + delta[s, 6:]
            self.keyframes[s].T_cam_map = self.T_cam_map[s].copy()

    def settle(self, slot: int) -> None:
        """Make the present estimate of a keyframe its first one, of which nothing marginalised depends."""
        self.T_first[slot], self.affine_first[slot] = self.T_cam_map[slot], self.affine[slot]
        self.delta[slot] = 0.0

    def see(self, slot: int, pyramid: ImagePyramid) -> None:
        """Replace the image of a keyframe."""
        self.pyramids[slot], self.images[slot] = pyramid, pyramid.levels[0]

    def forget_prior(self) -> None:
        """Forget what marginalised keyframes and points say."""
        self.prior_H[:], self.prior_b[:] = 0.0, 0.0
        for slot in self.slots:
            self.settle(slot)

    @contextmanager
    def at_present(self) -> Iterator[None]:
        """Take Jacobians at the present estimate meanwhile."""
        first = self.T_first.copy(), self.affine_first.copy()
        self.T_first[:], self.affine_first[:] = self.T_cam_map, self.affine
        try:
            yield
        finally:
            self.T_first[:], self.affine_first[:] = first

    def keep_points(self, rows: np.ndarray) -> None:
        """Keep active points (mask) with their keyframes."""
        for slot in self.slots:
            self.keyframes[slot].keep(self.active.of(rows & (self.active.host == slot)))

    def drop_points(self, rows: np.ndarray) -> None:
        """Drop active points (mask)."""
        np.add.at(self.gone, self.active.host[rows], 1)
        self.active = self.active.of(~rows)

    def map_points(self) -> np.ndarray:
        """(N, 3) active points in the map."""
        points = self.active
        fx, fy, cx, cy = self.intrinsics[0]
        rays = np.column_stack([(points.uv - [cx, cy]) / [fx, fy], np.ones(len(points))])
        T = np.linalg.inv(self.T_cam_map)[points.host]
        return np.einsum("nij,nj->ni", T[:, :3, :3], rays / points.inverse_depth[:, None]) + T[:, :3, 3]

    def seen_from(self, slot: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Active points as a keyframe sees them, those that do not look alike there left out.

        Returns:
            (N, 2) pixels, (N,) inverse depths, (N,) information on these.
        """
        p = self.active
        rows = ((p.seen[:, slot] == 1) | (p.host == slot)) & (p.inverse_depth > 0)
        fx, fy, cx, cy = self.intrinsics[0]
        T = (self.T_cam_map[slot] @ np.linalg.inv(self.T_cam_map))[p.host[rows]]
        rays = np.column_stack([(p.uv[rows] - [cx, cy]) / [fx, fy], np.ones(int(rows.sum()))])
        d = p.inverse_depth[rows]
        X = np.einsum("nij,nj->ni", T[:, :3, :3], rays) + T[:, :3, 3] * d[:, None]
        ahead = X[:, 2] > 1e-6
        X, d = X[ahead], d[ahead]
        uv = X[:, :2] / X[:, 2:] * [fx, fy] + [cx, cy]
        return uv, d / X[:, 2], p.information[rows][ahead]


def bound_of(energy: np.ndarray, points: Active, huber: float) -> float:
    """Cost of a pattern beyond which it more likely shows another surface than its own.

    The cost of normal residuals is on average e₀ on their own surface, and e₁ between unlike patterns. The
    log-odds of the two, log(e₁ / e₀) - E (1 / e₀ - 1 / e₁) per pixel, are nought at the bound, whatever the
    number of independent pixels. It lies between e₀ and e₁, so that loose bounds do not loosen further.

    Args:
        energy: (N,) costs of the patterns of one keyframe; e₀ is their median.
        points: of which each is unlike another far from it in the list.
        huber: residual beyond which it counts linearly.
    """
    off = np.abs(points.intensity - np.roll(points.intensity, len(points) // 2, axis=0))
    costs = np.where(off <= huber, off * off, huber * (2.0 * off - huber))
    own, other = float(np.median(energy)), float(np.median((points.weight * costs).sum(axis=1)))
    if not 0.0 < own < other:
        return other
    return float(np.log(other / own) / (1.0 / own - 1.0 / other))
