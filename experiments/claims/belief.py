"""What a system believes of its poses, windows and matches, held against exact depth and pose.

A unit is one world in one condition, run by one system. Live poses are compared relative to their reference
keyframe, at the scale that the map has just then: what the map as a whole has drifted by is not their doing.
A point's true place is that of the keypoint by which it was first seen. A keypoint truly shows it if it lies
where that place is seen and looks like it.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, Literal

import cv2
import numpy as np
from pydantic import Field, field_validator

from dslab.experiments.claims.spec import SYSTEMS_WITH_POINTS, ClaimSpec, Row, SystemsWithPoints, Unit
from dslab.experiments.claims.two_view import depth_at
from dslab.experiments.eq1.trial import frames_of
from dslab.experiments.evaluation.alignment import Undefined, align_poses
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.runs.execution import SlamSystem, slam_camera
from dslab.experiments.runs.slam_settings import factory_of, parse_slam_settings
from dslab.sim.depth_thumbnails import depth_renderer
from dslab.sim.frame_plan import ideal_camera, taking_intrinsics
from dslab.sim.sequence import Sequence
from dslab.slam.association._kernels import spread_of_pixel
from dslab.slam.core._frame_kernels import motion_between
from dslab.slam.core.frame import Frame
from dslab.slam.core.results import RelativePose
from dslab.slam.map.map import Map
from dslab.slam.optimization.student import CHI2_99
from dslab.slam.tracking.local_map import local_map

AXES = ("x", "y", "z", "roll", "pitch", "yaw")
"""Of a twist: position in metres, then rotation in rad, in the frame's camera."""
CHI2_95 = 12.592
"""Of six dimensions."""
LOCAL_S = 2.0
"""Length of the path over which a map's local scale is taken: the last seconds."""
_LEAST_KEYFRAMES = 4
_NEAR_PX = 1.5
"""Distance of a keypoint of level 0 from a point's true place within which it shows it."""
_WRONG_PX = 3.0
"""Likewise, beyond which it does not."""
_LIKE_BITS = 60
"""Largest distance of descriptors of one point, chosen by hand."""
_MOST_POINTS = 400
"""Points of a frame whose true matches are looked for."""


class BeliefSpec(ClaimSpec):
    """The spec of an experiment on what systems believe."""

    kind: Literal["belief"]  # pyright: ignore[reportIncompatibleVariableOverride]
    systems: SystemsWithPoints = SYSTEMS_WITH_POINTS
    settings: dict[str, Any] = Field(
        default_factory=dict, description="of the systems, as in a settings file of `dslab run`"
    )
    every: int = Field(4, ge=1, description="frames from one that is looked at to the next")

    @field_validator("settings")
    @classmethod
    def _check_settings(cls, settings: dict[str, Any]) -> dict[str, Any]:
        parse_slam_settings(settings, (), lambda at: ".".join(map(str, ("settings", *at))))
        return settings


def units(spec: BeliefSpec) -> list[Unit]:
    """World by world, every condition with every system; a world has one seed of SLAM."""
    return [
        {
            "world": world,
            "condition": condition,
            "base": cell.base,
            "system": system,
            "seed": spec.seed("belief", cell.base, world),
        }
        for world in range(spec.worlds)
        for condition, cell in spec.cells.items()
        for system in spec.systems
    ]


def measure(spec: BeliefSpec, unit: Unit) -> list[Row]:
    """One row: see :meth:`Belief.row`."""
    cv2.setNumThreads(1)
    scenario = spec.scenario(unit["condition"], unit["world"])
    sequence = frames_of(scenario, 0)
    settings = parse_slam_settings(spec.settings, (), str)
    camera = ideal_camera(taking_intrinsics(scenario.camera))
    with depth_renderer(scenario, camera) as depth_of:
        T_world_cam = Truth.of(sequence).T_world_cam
        belief = Belief(sequence, cache(lambda frame: depth_of(T_world_cam[frame])))
        system = factory_of(settings)(unit["system"], slam_camera(sequence.camera), unit["seed"])
        for index, stamp_s in enumerate(sequence.stamps_s):
            result = system.process(sequence.frames[index], float(stamp_s))
            if index % spec.every == 0 and result.relative is not None:
                belief.note(index, result.relative, system)
        system.finish()
    return [belief.row()]


class Belief:
    """What a run believed, frame by frame, and what was true.

    Args:
        sequence: with its true path.
        depth_of: exact depth (H, W) of a frame, metres along the optical axis, 0 for no surface.
    """

    def __init__(self, sequence: Sequence, depth_of: Callable[[int], np.ndarray]) -> None:
        self._truth, self._camera = Truth.of(sequence), slam_camera(sequence.camera)
        self._depth_of = depth_of
        self._errors: list[np.ndarray] = []
        self._chi2: list[float] = []
        self._likelihood: list[float] = []
        self._inside: list[bool] = []
        self._wrong: list[bool] = []
        self._places: dict[tuple[int, int], np.ndarray | None] = {}

    def note(self, index: int, pose: RelativePose, system: SlamSystem) -> None:
        """Look at a frame that was just tracked."""
        tracker = system.tracker  # type: ignore[attr-defined]
        scale = self._scale(tracker.map, float(self._truth.stamps_s[index]))
        if scale is None or not np.isfinite(pose.covariance).all():
            return
        true = self._truth.T_world_cam
        expected = np.linalg.inv(true[index]) @ true[pose.frame]
        found = pose.T_cam_keyframe.copy()
        found[:3, 3] *= scale
        metres = np.array([scale] * 3 + [1.0] * 3)
        covariance = pose.covariance * np.outer(metres, metres)
        error = motion_between(np.ascontiguousarray(expected), np.ascontiguousarray(found))
        chi2 = float(error @ np.linalg.solve(covariance, error))
        self._errors.append(error)
        self._chi2.append(chi2)
        spread = np.linalg.slogdet(2.0 * np.pi * covariance)[1]
        self._likelihood.append(-0.5 * (chi2 + float(spread)))
        if tracker.last.features.index == index:
            self._look_at_matches(index, tracker.last, tracker.map)

    def row(self) -> Row:
        """Sums of the unit.

        Returns:
            ``poses`` that were compared; ``inside``, how many within the ellipsoid of 95 %; ``chi2``, mean
            square of the normalised errors over six; ``likelihood``, mean log of the density of the errors;
            ``square_{axis}``, mean square of the error along each of ``AXES``; ``sought``, true matches that
            were looked for, and ``in_window``, how many lay in their window of 99 %; ``taken``, matches whose
            truth is known, and ``wrong``, how many show another place. Without poses None.
        """
        n = len(self._errors)
        squares = np.mean(np.square(self._errors), axis=0) if n else [None] * len(AXES)
        return {
            "poses": n,
            "inside": int(np.sum(np.array(self._chi2) <= CHI2_95)),
            "chi2": float(np.mean(self._chi2)) / len(AXES) if n else None,
            "likelihood": float(np.mean(self._likelihood)) if n else None,
            **{
                f"square_{axis}": None if s is None else float(s)
                for axis, s in zip(AXES, squares, strict=True)
            },
            "sought": len(self._inside),
            "in_window": sum(self._inside),
            "taken": len(self._wrong),
            "wrong": sum(self._wrong),
        }

    def _scale(self, m: Map, now_s: float) -> float | None:
        """Metres per unit of the map, by its newest keyframes; None with too few."""
        frames = np.array([m.frame_index(k) for k in m.keyframes()])
        recent = self._truth.stamps_s[frames] > now_s - LOCAL_S
        if recent.sum() < _LEAST_KEYFRAMES:
            return None
        T_map_cam = [
            np.linalg.inv(m.T_cam_map(k)) for k, is_new in zip(m.keyframes(), recent, strict=True) if is_new
        ]
        aligned = align_poses(np.array(T_map_cam), self._truth.T_world_cam[frames[recent]])
        return None if isinstance(aligned, Undefined) else aligned.scale

    def _look_at_matches(self, index: int, frame: Frame, m: Map) -> None:
        """Are the true matches in their windows, and those that were taken true?"""
        if frame.sought is None:
            return
        a, view, features = m.arrays, m.view, frame.features
        _, points = local_map(m, frame.point, m.n_keyframes)
        points = points[:: max(1, len(points) // _MOST_POINTS)]
        known = [(int(p), place) for p in points for place in [self._place(m, int(p))] if place is not None]
        T_cam_world = np.linalg.inv(self._truth.T_world_cam[index])
        row_of = {int(p): row for row, p in enumerate(frame.point) if p >= 0}
        for p, place in known:
            x, y, z = T_cam_world[:3, :3] @ place + T_cam_world[:3, 3]
            if z <= 0:
                continue
            at = np.array([view.fx * x / z + view.cx, view.fy * y / z + view.cy])
            apart_px = np.linalg.norm(features.xy - at, axis=1) / view.scale[features.octave]
            bits = np.bitwise_count(features.descriptors ^ a.pt_descriptor[p]).sum(axis=1)
            if p in row_of:
                self._wrong.append(bool(apart_px[row_of[p]] > _WRONG_PX))
            shows = np.flatnonzero((apart_px <= _NEAR_PX) & (bits <= _LIKE_BITS))
            if len(shows):
                best = shows[np.argmin(bits[shows])]
                self._inside.append(_in_window(frame, m, p, features.xy[best], int(features.octave[best])))

    def _place(self, m: Map, p: int) -> np.ndarray | None:
        """(3,) where the point truly is, metres in the world; None where that is not known."""
        key = m.map_id, p
        if key not in self._places:
            self._places[key] = self._true_place(m, p)
        return self._places[key]

    def _true_place(self, m: Map, p: int) -> np.ndarray | None:
        a = m.arrays
        k = int(a.pt_first_keyframe[p])
        rows = np.flatnonzero(m.observed_points(k) == p)
        if a.kf_bad[k] or not len(rows):
            return None
        index, features = m.frame_index(k), m.features(k)
        depth_m = depth_at(self._depth_of(index), features.xy_image[rows[:1]])[0]
        if not np.isfinite(depth_m):
            return None
        camera = self._camera
        ray = (features.xy[rows[0]] - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        return (self._truth.T_world_cam[index] @ [*(ray * depth_m), depth_m, 1.0])[:3]


def _in_window(frame: Frame, m: Map, p: int, xy: np.ndarray, octave: int) -> bool:
    """Whether a keypoint lies in the window in which a point was sought."""
    assert frame.sought is not None
    a, view, (T, covariance) = m.arrays, m.view, frame.sought
    J = np.zeros((2, 6))
    u, v, z, uu, uv, vv = spread_of_pixel(view, T, a.pt_xyz[p], a.pt_covariance[p], m.noise2, covariance, J)
    if z <= 0:
        return False
    own = m.noise2 / view.inv_sigma2[octave]
    S = np.array([[uu + own, uv], [uv, vv + own]])
    error = xy - np.array([u, v])
    return bool(error @ np.linalg.solve(S, error) <= CHI2_99)
