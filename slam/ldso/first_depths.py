"""First depths by intensities alone: poses of several frames and inverse depths of the first one's points.

A frame can be aligned with the first view only if the depths there are known, and these only if the motion
is. So both are sought together. While frames come, each is aligned with the first view as if that were a
plane of inverse depth one. Once they have moved far enough, some of them are adjusted as a window is, from
coarse images to fine ones: with a plane of any slant first, then with points of their own depths. The mean
inverse depth stays one, which fixes the scale. Each inverse depth is drawn to the mean of its neighbours',
which says something where an image says nothing, and little elsewhere.

What a plane shows has two explanations, as a homography has two decompositions. Depths begin from both. If
both are in view, nothing begins until one of them explains the images better by more than ``_DECIDES``.

Source: derived here. The decomposition is that of Malis, Vargas, "Deeper Understanding of the Homography
Decomposition for Vision-Based Control", 2007, by OpenCV.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial import cKDTree

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.direct._alignment_kernels import PATTERN, sample_patterns
from dslab.slam.direct.pyramid import ImagePyramid
from dslab.slam.direct.rays import LEAST_NOISE
from dslab.slam.direct.selection import select
from dslab.slam.ldso.adjustment import DepthPrior, adjust
from dslab.slam.ldso.config import DsoConfig
from dslab.slam.ldso.model import WindowModel, model_of
from dslab.slam.ldso.motion import SHARED
from dslab.slam.ldso.plane import adjust_plane
from dslab.slam.ldso.points import Active
from dslab.slam.ldso.tracking import PhotometricTracker, TrackingReference
from dslab.slam.ldso.window import Keyframe, Window, bound_of

_LEAST_POINTS = 150
_MOST_POINTS = 1000
_FIRST_FLOW = (
    0.015  # root mean square shift by the translation, of the image's width, before depths are tried
)
_MORE_FLOW = 1.2  # of the last try's
_VIEWS = 6  # besides the first
_NEIGHBOURS = 6
_SMOOTH = 0.1  # standard deviation of an inverse depth from its neighbours' mean, of the mean inverse depth
_STEPS = 12  # on a level, in a round
_TOLERANCE = 1e-5  # turn and shift differ by little at first
_ROUNDS = 3  # of the neighbours' means on a level
_KNOWN = 0.1  # of the direction of the motion, rad, and of the median inverse depth, of itself
_FLOOR = 1e-9  # of an eigenvalue of scaled information; scale is free
_DECIDES = 0.1  # share of the cost: interpolation alone makes a wrong motion cheaper by three hundredths
_LEAST_ALIKE = 0.6  # share of the points
_LEAST_LIKENESS = 0.5
_ALIKE = 0.05  # difference of two normals that are one


@dataclass(frozen=True)
class FirstDepths:
    """Two views and the depths of the first one's points.

    Attributes:
        first, second: indices of the frames.
        T_second_first: (4, 4) motion; mean inverse depth is the unit of lengths.
        uv, inverse_depth: (N, 2) pixels of the first frame, and (N,).
    """

    first: int
    second: int
    T_second_first: np.ndarray
    uv: np.ndarray
    inverse_depth: np.ndarray


@dataclass(frozen=True)
class _View:
    frame: int
    pyramid: ImagePyramid
    T: np.ndarray
    affine: np.ndarray


@dataclass(frozen=True)
class _Guess:
    """Motions (K, 4, 4), brightness (K, 2) of the views and inverse depths (N,) of the points."""

    T: np.ndarray
    affine: np.ndarray
    inverse_depth: np.ndarray


class IntensityStart:
    """Seeks first depths.

    Args:
        camera: of the images.
        intrinsics: (L, 4) of the levels of their pyramids.
        config: settings.
    """

    def __init__(self, camera: PinholeCamera, intrinsics: np.ndarray, config: DsoConfig) -> None:
        self._camera, self._intrinsics, self._config = camera, intrinsics, config
        self._tracker = PhotometricTracker(config.photometric, config.tracking)
        self.reset()

    def reset(self) -> None:
        """Forget the first view."""
        self._reference: TrackingReference | None = None
        self._views: list[_View] = []
        self._wanted_flow = _FIRST_FLOW * self._camera.width_px

    def offer(self, frame: int, pyramid: ImagePyramid) -> FirstDepths | None:
        """Try to find depths with this frame as the last one."""
        if self._reference is None:
            self._begin(frame, pyramid)
            return None
        last = self._views[-1]
        before = self._views[-2] if len(self._views) > 1 else last
        ahead = last.T @ np.linalg.inv(before.T) @ last.T
        tracked = self._tracker.track(self._reference, pyramid, [ahead, last.T], last.affine, 3.0)
        if tracked is None or tracked.visible < 0.5 or tracked.likeness < _LEAST_LIKENESS:
            self.reset()
            self._begin(frame, pyramid)
            return None
        self._views.append(_View(frame, pyramid, tracked.T_frame_ref, tracked.affine))
        if len(self._views) > 4 * _VIEWS:  # every other one, the last two excepted
            self._views[1:-2] = self._views[2:-2:2]
        if tracked.flow_px[0] < self._wanted_flow:
            return None
        found = self._sought()
        self._wanted_flow = _MORE_FLOW * tracked.flow_px[0]
        return found

    def _begin(self, frame: int, pyramid: ImagePyramid) -> None:
        selected = select(pyramid, replace(self._config.selection, points=_MOST_POINTS))
        if len(selected.xy) < _LEAST_POINTS:
            return
        self._uv = selected.xy.astype(float)
        ones = np.ones(len(self._uv))
        self._reference = TrackingReference(pyramid, self._intrinsics, self._uv, ones, ones)
        self._views = [_View(frame, pyramid, np.eye(4), np.zeros(2))]
        k = min(_NEIGHBOURS + 1, len(self._uv))
        self._neighbours = cKDTree(self._uv).query(self._uv, k=k)[1][:, 1:]

    def _sought(self) -> FirstDepths | None:
        """Depths by the views so far; None if they are not known, or another motion explains as much."""
        n = len(self._views) - 1
        rows = np.unique(np.linspace(1, n, min(_VIEWS, n)).astype(int))
        views = [self._views[0], *(self._views[i] for i in rows)]
        T, affine = np.stack([v.T for v in views]), np.stack([v.affine for v in views])
        start = self._on_plane(views, _Guess(T, affine, np.ones(len(self._uv))))
        twin = self._twin(start)
        ways = [self._adjusted(views, way) for way in (start, twin) if way is not None]
        known = sorted((way for way in ways if way is not None), key=lambda way: way[1])
        if not known or (len(known) > 1 and known[1][1] < (1.0 + _DECIDES) * known[0][1]):
            return None
        guess = known[0][0]
        return FirstDepths(views[0].frame, views[-1].frame, guess.T[-1], self._uv, guess.inverse_depth)

    def _on_plane(self, views: list[_View], guess: _Guess) -> _Guess:
        """Poses and the plane by which all views are explained best, over the levels."""
        rays = self._rays
        for level in range(len(self._intrinsics) - 1, -1, -1):
            window = self._window(views, guess, level)
            plane = np.linalg.lstsq(rays, guess.inverse_depth, rcond=None)[0]
            window.outlier[:] = _bound(window, self._config)
            adjust_plane(window, plane, self._config.photometric.huber)
            guess = _normalised(window)
        return guess

    @property
    def _rays(self) -> np.ndarray:
        fx, fy, cx, cy = self._intrinsics[0]
        return np.column_stack([(self._uv - [cx, cy]) / [fx, fy], np.ones(len(self._uv))])

    def _adjusted(self, views: list[_View], guess: _Guess) -> tuple[_Guess, float] | None:
        """Poses and depths over the levels, with their cost on the finest one; None if not known."""
        noise, photometric = LEAST_NOISE, self._config.photometric
        for level in range(len(self._intrinsics) - 1, -1, -1):
            for _ in range(_ROUNDS):
                window = self._window(views, guess, level)
                window.outlier[:] = _bound(window, self._config)
                mean = guess.inverse_depth[self._neighbours].mean(axis=1)
                prior = DepthPrior((noise / _SMOOTH) ** 2, mean)
                noise = max(LEAST_NOISE, adjust(window, photometric, _STEPS, prior, _TOLERANCE).error)
                guess = _normalised(window)
        window = self._window(views, guess, 0)
        window.outlier[:] = _bound(window, self._config)
        p = window.active
        model = model_of(window, p, p.seen >= 0, photometric.huber)
        alike = (model.seen == 1).any(axis=1)
        if alike.mean() < _LEAST_ALIKE or not np.isfinite(guess.inverse_depth).all():
            return None
        if _unknown(window, model, guess.inverse_depth, noise) > _KNOWN:
            return None
        return guess, model.cost

    def _window(self, views: list[_View], guess: _Guess, level: int) -> Window:
        """The views on one level, with the points of the first."""
        height, width = views[0].pyramid.levels[level].shape[:2]
        camera = PinholeCamera(width, height, *self._intrinsics[level], self._camera.fps)
        size = replace(self._config.window, most=_VIEWS)
        window = Window(camera, self._intrinsics[level:], size)
        for view, T, affine in zip(views, guess.T, guess.affine, strict=True):
            image = ImagePyramid(view.pyramid.levels[level:])
            window.add(Keyframe(view.frame, 0.0, T.copy()), image, affine)
        n = len(self._uv)
        uv = np.ascontiguousarray((self._uv + 0.5) * 0.5**level - 0.5)
        intensity, weight = np.empty((n, len(PATTERN))), np.empty((n, len(PATTERN)))
        scale = self._config.photometric.gradient_scale
        sample_patterns(views[0].pyramid.levels[level], uv, PATTERN, scale, intensity, weight)
        host = np.full(n, window.slots[0], np.int64)
        seen = np.where(_targets(window, n), np.int8(1), np.int8(-1))
        window.active = Active(
            host, uv, intensity, weight, np.zeros(n, np.int32), guess.inverse_depth.copy(), np.ones(n), seen,
            np.zeros(n, np.int64),
        )  # fmt: skip
        return window

    def _twin(self, guess: _Guess) -> _Guess | None:
        """The other motion and plane by which a plane's views look the same; None if it is not in view."""
        rays = self._rays
        plane = np.linalg.lstsq(rays, guess.inverse_depth, rcond=None)[0]
        others = _decomposed(guess.T[-1], plane, rays)
        far = [np.linalg.norm(n / np.linalg.norm(n) - plane / np.linalg.norm(plane)) for _, n in others]
        if not far or max(far) < _ALIKE:
            return None
        normal = others[int(np.argmax(far))][1]
        motions = [np.eye(4)]
        for T in guess.T[1:]:
            ways = _decomposed(T, plane, rays)
            if not ways:
                return None
            motions.append(min(ways, key=lambda way: float(np.linalg.norm(way[1] - normal)))[0])
        d = np.maximum(rays @ normal, 1e-3)
        scale = d.mean()
        stacked = np.stack(motions)
        stacked[:, :3, 3] *= scale
        return _Guess(stacked, guess.affine, d / scale)


def _decomposed(T: np.ndarray, plane: np.ndarray, rays: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Motions and planes of the homography of a plane (inverse depths rays @ plane) that are in view."""
    H = T[:3, :3] + np.outer(T[:3, 3], plane)
    _, rotations, shifts, normals = cv2.decomposeHomographyMat(H, np.eye(3))
    out = []
    for R, t, n in zip(rotations, shifts, normals, strict=True):
        if ((rays @ n[:, 0]) > 0).mean() < 0.95:
            continue
        other = np.eye(4)
        other[:3, :3], other[:3, 3] = R, t[:, 0]
        out.append((other, n[:, 0]))
    return out


def _unknown(window: Window, model: WindowModel, inverse_depth: np.ndarray, noise: float) -> float:
    """How badly motion and depths are known: the larger of the deviation of the direction of the last motion,
    rad, and the median one of an inverse depth over itself.

    Each is of all unknowns together: what turns and shifts explain alike is not known.
    """
    information = model.information + (noise / _SMOOTH) ** 2
    smooth = replace(model, information=information)
    H = model.H - smooth.eliminated()[0]
    rows = np.concatenate([np.arange(8 * s, 8 * s + 8) for s in sorted(window.slots[1:])])
    scale = 1.0 / np.sqrt(np.maximum(H.diagonal()[rows], 1e-12))
    A = H[np.ix_(rows, rows)] * scale * scale[:, None]
    values, vectors = np.linalg.eigh(0.5 * (A + A.T))
    root = vectors / np.sqrt(np.maximum(values, _FLOOR)) * scale[:, None]
    variance = SHARED * noise**2
    last = root[8 * (len(window) - 2) : 8 * (len(window) - 2) + 3]
    t = window.T_cam_map[window.newest, :3, 3] - window.T_cam_map[window.slots[0], :3, 3]
    across = np.eye(3) - np.outer(t, t) / max(float(t @ t), 1e-24)
    direction = np.sqrt(variance * np.linalg.norm(across @ last, 2) ** 2 / max(float(t @ t), 1e-24))
    by_poses = (model.cross[:, rows] / information[:, None]) @ root
    depth = noise**2 / information + variance * (by_poses**2).sum(axis=1)
    return max(float(direction), float(np.median(np.sqrt(depth) / np.maximum(inverse_depth, 1e-6))))


def _targets(window: Window, n: int) -> np.ndarray:
    """(N, S) bool: residuals in all views but the first."""
    others = window.live.copy()
    others[window.slots[0]] = False
    return np.tile(others, (n, 1))


def _bound(window: Window, config: DsoConfig) -> float:
    """Cost of a pattern beyond which it is not that surface, by all patterns."""
    window.outlier[:] = np.inf
    p = window.active
    model = model_of(window, p, p.seen >= 0, config.photometric.huber)
    energy = model.energy[model.seen == 1]
    return bound_of(energy, p, config.photometric.huber) if len(energy) else 0.0


def _normalised(window: Window) -> _Guess:
    """What the window holds, relative to its first keyframe and with a mean inverse depth of one."""
    T = window.T_cam_map[window.slots] @ np.linalg.inv(window.T_cam_map[window.slots[0]])
    d = window.active.inverse_depth
    scale = float(d.mean())
    T[:, :3, 3] *= scale
    affine = window.affine[window.slots] - window.affine[window.slots[0]]
    return _Guess(T, affine, d / scale)
