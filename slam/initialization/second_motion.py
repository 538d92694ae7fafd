"""The second motion that explains a map's first two views, judged by the frames that follow.

Two views of a plane leave two motions that explain the matches nearly equally well. Which of them does so a
little better depends on errors that matches have in common, such as those of a rolling shutter or the lens.
Later views tell: they do not fit points made under the wrong motion.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dslab.slam.core.frame import Frame
from dslab.slam.core.geometry import ViewGeometry
from dslab.slam.core.settings import setting, settings
from dslab.slam.initialization.two_view import lead_sigmas
from dslab.slam.optimization._triangulation import triangulate
from dslab.slam.optimization.bundle_adjustment import bundle_adjust
from dslab.slam.optimization.pose import CHI2_2DOF, optimize_pose

_HUBER_DELTA = float(np.sqrt(CHI2_2DOF))
_MAX_CHI2 = 4.0 * CHI2_2DOF
"""Most that one observation counts against a motion: that of a clear outlier."""

_FAR = 1e3
"""Depth in baselines of points that a motion puts behind infinity: there they fit best."""

_SAME_DEG = 5.0
_ITERATIONS = 20
_MAX_NOISE = 2.0


@settings
class SecondMotionConfig:
    """How the second motion of a start is judged."""

    max_views: int = setting(20, "views after which the second motion is forgotten; 0: at once")
    every_s: float = setting(0.1, "least time between two of these views")
    min_points: int = setting(30, "points of the start in a view, below which it is forgotten")
    min_lead_sigmas: float = setting(3.5, "lead over the first motion with which it is right")
    sure_lead_sigmas: float = setting(10.0, "lead of the first motion with which the second is forgotten")


@dataclass
class _View:
    """Observations of the start's points: their rows (n,), pixels (n, 2) and information (n,), 1/px²."""

    points: np.ndarray
    pixels: np.ndarray
    inv_sigma2: np.ndarray


@dataclass
class _Hypothesis:
    """Cameras (C, 4, 4) and points (N, 3) as they are under a motion; frame of the first camera."""

    T_cam_map: np.ndarray
    points: np.ndarray


class SecondMotion:
    """Two motions between the first views of a map, judged by the same observations.

    Under each, the start's points are triangulated from the first two views, later views are placed on them,
    and all is bundle-adjusted. Costs are compared point by point, as the errors of one point's observations
    depend on each other. The observations are those of the tracker, which follows the map's own motion: they
    favour it, if anything.

    Args:
        view: of the camera.
        first, second: the first two frames, with the points of the map.
        T_2_1: (4, 4) first to second camera, as the map has it.
        T_2_1_rival: (4, 4) the same by the second motion, any scale.
        config: settings.

    Attributes:
        verdict: the motion that is right, empty while both may be; the first one too if nothing can be told.
        lead_sigmas: standard deviations by which the map's motion explains the views better.
    """

    def __init__(
        self,
        view: ViewGeometry,
        first: Frame,
        second: Frame,
        T_2_1: np.ndarray,
        T_2_1_rival: np.ndarray,
        config: SecondMotionConfig,
    ) -> None:
        self.verdict: Literal["", "first", "second"] = ""
        self.lead_sigmas = 0.0
        self._config = config
        self._view = view
        self._ids = np.intersect1d(first.point[first.point >= 0], second.point)  # rows in the map
        self._views = [self._seen(first), self._seen(second)]
        self._last_s = second.features.stamp_s
        self._hypotheses = [self._under(T) for T in (T_2_1, T_2_1_rival)]

    def note(self, frame: Frame) -> None:
        """Judge both motions by a tracked frame too, if it is time for another view.

        Args:
            frame: with the points of the map that it shows.
        """
        if self.verdict or frame.features.stamp_s < self._last_s + self._config.every_s - 1e-6:
            return
        self._last_s = frame.features.stamp_s
        seen = self._seen(frame)
        if len(seen.points) < self._config.min_points:
            self.verdict = "first"
            return
        self._views.append(seen)
        own, others = (self._costs(hypothesis) for hypothesis in self._hypotheses)
        self.lead_sigmas = lead_sigmas(others - own, self._config.min_lead_sigmas)
        self._decide()

    def _decide(self) -> None:
        config, lead = self._config, self.lead_sigmas
        if lead <= -config.min_lead_sigmas:
            self.verdict = "second"
        elif lead >= config.sure_lead_sigmas or len(self._views) >= config.max_views + 2 or self._are_same():
            self.verdict = "first"

    def _are_same(self) -> bool:
        """Return True if bundle adjustment has led both to the same motion."""
        a, b = (h.T_cam_map[1, :3, 3] / np.linalg.norm(h.T_cam_map[1, :3, 3]) for h in self._hypotheses)
        return bool(a @ b > np.cos(np.deg2rad(_SAME_DEG)))

    def _seen(self, frame: Frame) -> _View:
        keypoints = np.flatnonzero((frame.point >= 0) & np.isin(frame.point, self._ids))
        f = frame.features
        return _View(
            np.searchsorted(self._ids, frame.point[keypoints]),
            f.xy[keypoints],
            self._view.inv_sigma2[f.octave[keypoints]],
        )

    def _under(self, T_2_1: np.ndarray) -> _Hypothesis:
        """Cameras and points of the first two views under a motion between them."""
        v = self._view
        poses = np.array([np.eye(4), T_2_1])
        rays = np.empty((2, len(self._ids), 2))
        for k, seen in enumerate(self._views):
            rays[k, seen.points] = (seen.pixels - (v.cx, v.cy)) / (v.fx, v.fy)
        points = np.array([triangulate(*poses, *a, *b) for a, b in zip(*rays, strict=True)]).reshape(-1, 3)
        nowhere = np.isnan(points[:, 0])
        depth = _FAR * np.linalg.norm(T_2_1[:3, 3])
        points[nowhere] = depth * np.column_stack([rays[0], np.ones(len(points))])[nowhere]
        return _Hypothesis(poses, points)

    def _costs(self, h: _Hypothesis) -> np.ndarray:
        """Place the newest view, adjust all; cost of each point (N,) in units of the variance."""
        v, newest = self._view, self._views[-1]
        placed = optimize_pose(
            h.T_cam_map[-1], h.points[newest.points], newest.pixels, newest.inv_sigma2,
            v.fx, v.fy, v.cx, v.cy, _MAX_NOISE,
        )  # fmt: skip
        poses = np.concatenate([h.T_cam_map, placed.T_cam_map[None]])
        cameras = np.repeat(np.arange(len(poses)), [len(seen.points) for seen in self._views])
        rows = np.concatenate([seen.points for seen in self._views])
        adjusted = bundle_adjust(
            poses, np.arange(len(poses)) == 0, h.points, cameras, rows,
            np.concatenate([seen.pixels for seen in self._views]),
            np.concatenate([seen.inv_sigma2 for seen in self._views]),
            v.fx, v.fy, v.cx, v.cy, _ITERATIONS, _HUBER_DELTA,
        )  # fmt: skip
        h.T_cam_map, h.points = adjusted.T_cam_map, adjusted.points
        return np.bincount(rows, np.minimum(adjusted.chi2, _MAX_CHI2), minlength=len(h.points))
