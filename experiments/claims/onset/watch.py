"""A map as it grows, seen from outside, and each of its steps held against exact depth and pose."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dslab.experiments.eq1.conditioning import angle_deg
from dslab.experiments.evaluation.alignment import Undefined, align_poses, rotation_angle_deg
from dslab.experiments.evaluation.audit import BOUNDS, lacks_for_alignment
from dslab.experiments.evaluation.metrics import PosePairs, Truth
from dslab.experiments.evaluation.summary import is_tracked
from dslab.experiments.runs.execution import SlamSystem, without_features
from dslab.sim.sensors.camera import Intrinsics
from dslab.slam.core.results import MapTrajectory, TrackingResult

BACK = (1, 2, 4, 8, 16)
"""Keyframes back from the newest one to which its pose is compared."""
LOCAL_S = 2.0
"""Length of the path over which a map's local scale is taken: the last seconds, or the first."""
_LEAST_BASELINE_M = 1e-6
_LEAST_POINTS = 10  # that make a median
DepthAt = Callable[[int], np.ndarray]
"""Exact depth (H, W) of a frame, metres along the optical axis, 0 for no surface."""


@dataclass(frozen=True)
class MapStep:
    """A map just after it has grown by a keyframe's points.

    Attributes:
        frame: at which it grew.
        map_id: of the map.
        points_map: (n, 3) float64 the points that are new, map frame.
        path: its frames' poses as they lie now.
        keyframes: its keyframes' poses as they lie now.
    """

    frame: int
    map_id: int
    points_map: np.ndarray
    path: MapTrajectory
    keyframes: MapTrajectory


class MapWatch:
    """Observer of a run: its results, and every step of its maps.

    Attributes:
        results: one per frame.
        steps: in order.
    """

    def __init__(self) -> None:
        self.results: list[TrackingResult] = []
        self.steps: list[MapStep] = []
        self._map_id, self._points = -1, 0

    def frame(self, image: np.ndarray, result: TrackingResult, system: SlamSystem) -> None:
        """Look at the map after a frame."""
        self.results.append(without_features(result))
        if not is_tracked(result) or result.map_id not in system.maps():
            return
        map_ = system.map(result.map_id)
        if result.map_id != self._map_id:
            self._map_id, self._points = result.map_id, 0
        if map_.n_points <= self._points:
            return
        new = np.arange(self._points, map_.n_points)
        self._points = map_.n_points
        kept = new[~map_.arrays.pt_bad[new]]
        path, keyframes = (
            next(path for path in paths if path.map_id == result.map_id)
            for paths in (system.trajectories(), system.keyframe_trajectories())
        )
        points = map_.arrays.pt_xyz[kept].copy()
        self.steps.append(MapStep(result.frame, result.map_id, points, path, keyframes))


def motion_errors(
    T_map_a: np.ndarray, T_map_b: np.ndarray, T_world_a: np.ndarray, T_world_b: np.ndarray, scale: float
) -> dict[str, float | None]:
    """Error of the pose of camera b relative to camera a.

    Args:
        T_map_a, T_map_b: (4, 4) estimated poses, camera to map.
        T_world_a, T_world_b: (4, 4) true poses, metres.
        scale: metres per unit of the map.

    Returns:
        ``baseline_m``, the true one; ``offset_m``, distance of b from where it truly is, seen from a;
        ``direction_deg`` and ``rotation_deg``. The direction is None without a baseline.
    """
    found, true = np.linalg.inv(T_map_a) @ T_map_b, np.linalg.inv(T_world_a) @ T_world_b
    moved, baseline = scale * found[:3, 3], true[:3, 3]
    is_wide = min(np.linalg.norm(moved), np.linalg.norm(baseline)) > _LEAST_BASELINE_M
    turned = (true[:3, :3].T @ found[:3, :3])[None]
    return {
        "baseline_m": float(np.linalg.norm(baseline)),
        "offset_m": float(np.linalg.norm(moved - baseline)),
        "direction_deg": angle_deg(moved, baseline) if is_wide else None,
        "rotation_deg": float(rotation_angle_deg(turned)[0]),
    }


@dataclass(frozen=True)
class StepJudge:
    """The truth by which the steps of a map are judged.

    Attributes:
        truth: the true path.
        camera: a pinhole camera that sees what the frames see.
        depth_at: exact depth through it.
    """

    truth: Truth
    camera: Intrinsics
    depth_at: DepthAt

    def figures(self, step: MapStep) -> dict[str, Any]:
        """Figures of a step.

        Returns:
            ``points``, the number of new ones that the newest keyframe sees; ``depth_error``, median of
            their relative depth errors without sign, ``depth_bias`` with it, in the map's local scale, which
            is ``metres_per_unit``; ``scale_ratio``, size of the map's last seconds over that of its first;
            ``unfit``, no scale makes the true path of the last seconds, though the camera moved; per number k
            of keyframes back those of :func:`motion_errors` with k at the end, and ``walked{k}_m``, the true
            path between the two. None where undetermined.
        """
        path = self.truth.pairs(step.path)
        times_s = self.truth.stamps_s[path.frames]
        local, unfit = _scale(path.where(times_s > times_s[-1] - LOCAL_S))
        first, _ = _scale(path.where(times_s < times_s[0] + LOCAL_S))
        row: dict[str, Any] = {"frame": step.frame, "metres_per_unit": local, "unfit": int(unfit)}
        row["scale_ratio"] = first / local if first and local else None
        row |= {"points": 0, "depth_error": None, "depth_bias": None}
        keyframes = self.truth.pairs(step.keyframes)
        if local:
            row |= self._depths(step, keyframes, local)
        walked_m = self.truth.walked_m()
        newest = len(keyframes) - 1
        for back in BACK:
            names = ("baseline", "offset", "direction", "rotation")
            errors: dict[str, Any] = {}
            if local and back <= newest:
                a, b = newest - back, newest
                found, true = keyframes.T_map_cam, keyframes.T_world_cam
                errors = motion_errors(found[a], found[b], true[a], true[b], local)
                errors["walked_m"] = float(np.ptp(walked_m[keyframes.frames[[a, b]]]))
            for name in (*names, "walked"):
                unit = "deg" if name in ("direction", "rotation") else "m"
                row[f"{name}{back}_{unit}"] = errors.get(f"{name}_{unit}")
        return row

    def _depths(self, step: MapStep, keyframes: PosePairs, scale: float) -> dict[str, Any]:
        """Depths of the new points in the newest keyframe against the exact ones."""
        T_cam_map = np.linalg.inv(keyframes.T_map_cam[-1])
        seen = step.points_map @ T_cam_map[:3, :3].T + T_cam_map[:3, 3]
        seen = seen[seen[:, 2] > 0]
        c = self.camera
        columns = np.rint(c.fx * seen[:, 0] / seen[:, 2] + c.cx)
        lines = np.rint(c.fy * seen[:, 1] / seen[:, 2] + c.cy)
        inside = (columns >= 0) & (columns < c.width_px) & (lines >= 0) & (lines < c.height_px)
        depth_m = self.depth_at(int(keyframes.frames[-1]))
        exact_m = depth_m[lines[inside].astype(int), columns[inside].astype(int)]
        error = scale * seen[inside, 2][exact_m > 0] / exact_m[exact_m > 0] - 1
        if len(error) < _LEAST_POINTS:
            return {"points": len(error)}
        medians = float(np.median(np.abs(error))), float(np.median(error))
        return {"points": len(error), "depth_error": medians[0], "depth_bias": medians[1]}


def live_errors(
    results: list[TrackingResult], steps: list[MapStep], scales: list[float | None], truth: Truth
) -> dict[str, list[float | None]]:
    """Errors of the live pose of every frame relative to the last keyframe before it.

    Args:
        results: one per frame.
        steps: of the map, in order.
        scales: metres per unit after each step.
        truth: the true path.

    Returns:
        The figures of :func:`motion_errors`, a value per frame; None without a pose, keyframe or scale.
    """
    series: dict[str, list[float | None]] = {
        name: [None] * len(results) for name in ("baseline_m", "offset_m", "direction_deg", "rotation_deg")
    }
    ends = [step.frame for step in steps[1:]] + [len(results) - 1]
    for step, scale, end in zip(steps, scales, ends, strict=True):
        last = int(step.keyframes.frames[-1])
        for result in results[step.frame + 1 : end + 1]:
            if scale is None or result.T_map_cam is None or result.map_id != step.map_id:
                continue
            true = truth.T_world_cam[[last, result.frame]]
            errors = motion_errors(step.keyframes.T_map_cam[-1], result.T_map_cam, *true, scale)
            for name, value in errors.items():
                series[name][result.frame] = value
    return series


def _scale(path: PosePairs) -> tuple[float | None, bool]:
    """Metres per unit of a piece of path, None if it is open; and whether the poses do not fit the truth."""
    if lacks_for_alignment(path, BOUNDS):
        return None, False
    alignment = align_poses(path.T_map_cam, path.T_world_cam)
    return (None, True) if isinstance(alignment, Undefined) else (alignment.scale, False)
