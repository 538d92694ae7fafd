"""Layout of a run for display: every map aligned to the truth, up axis, extent."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dslab.experiments.evaluation.alignment import IDENTITY, Similarity, Undefined, align_poses
from dslab.experiments.evaluation.metrics import Truth
from dslab.experiments.runs.execution import RunRecord
from dslab.slam.core.results import MapTrajectory


@dataclass(frozen=True)
class Scene:
    """Drawable geometry of a run.

    Attributes:
        T_world_cam: (N, 4, 4) float64 true poses, NaN where unknown; None without truth.
        final: final paths in the world per map id, of the maps that can be aligned.
        up: (3,) unit vector, the mean upward direction of the camera, to the nearest axis.
        centre, extent: of all paths drawn, metres or map units.
    """

    T_world_cam: np.ndarray | None
    final: dict[int, MapTrajectory]
    up: np.ndarray
    centre: np.ndarray
    extent: float


def lay_out(record: RunRecord) -> Scene:
    """Align the maps of a run to the world; without truth each stays in its own frame."""
    final = {}
    for trajectory in record.trajectories:
        alignment = _placement(record, trajectory)
        if isinstance(alignment, Similarity):
            poses = alignment.poses(trajectory.T_map_cam)
            final[trajectory.map_id] = replace(trajectory, T_map_cam=poses)
    truth = record.sequence.T_world_cam
    known = [] if truth is None else [truth[np.isfinite(truth).all(axis=(1, 2))]]
    poses = np.concatenate([np.empty((0, 4, 4)), *known, *(t.T_map_cam for t in final.values())])
    positions = poses[:, :3, 3] if len(poses) else np.zeros((1, 3))
    low, high = positions.min(axis=0), positions.max(axis=0)
    return Scene(truth, final, _up(poses), (low + high) / 2, max(float((high - low).max()), 1e-3))


def together(scenes: Sequence[Scene]) -> Scene:
    """The common scene of several runs over one sequence: its truth and their extent, without maps."""
    low = np.min([s.centre - s.extent / 2 for s in scenes], axis=0)
    high = np.max([s.centre + s.extent / 2 for s in scenes], axis=0)
    first = scenes[0]
    return Scene(first.T_world_cam, {}, first.up, (low + high) / 2, float((high - low).max()))


def _placement(record: RunRecord, trajectory: MapTrajectory) -> Similarity | Undefined:
    if record.sequence.T_world_cam is None:
        return IDENTITY
    pairs = Truth.of(record.sequence).pairs(trajectory)
    return align_poses(pairs.T_map_cam, pairs.T_world_cam)


def _up(T_world_cam: np.ndarray) -> np.ndarray:
    """Mean up direction, to the nearest axis: the camera's -y axis, as image rows run downward."""
    if not len(T_world_cam):
        return np.array([0.0, -1.0, 0.0])
    mean = -T_world_cam[:, :3, 1].mean(axis=0)
    up = np.zeros(3)
    axis = int(np.abs(mean).argmax())
    up[axis] = np.sign(mean[axis])
    return up
