"""Frame poses relative to their keyframes, so that they follow the map."""

from dataclasses import dataclass
from math import inf

import numpy as np

from dslab.slam.core.frame import Frame
from dslab.slam.core.results import MapTrajectory
from dslab.slam.core.snapshot import Immutable
from dslab.slam.map.map import Map


@dataclass(frozen=True)
class _Pose(Immutable):
    stamp_s: float
    keyframe: int
    T_cam_keyframe: np.ndarray


class FramePoses:
    """Poses of all tracked frames, per map."""

    def __init__(self) -> None:
        self._poses: dict[int, dict[int, _Pose]] = {}

    def add(self, map_id: int, frame: Frame) -> None:
        """Record a tracked frame, replacing an earlier record of the frame in the same map."""
        if not np.isfinite(frame.T_cam_reference).all():
            raise ValueError("the frame has no pose")
        self._poses.setdefault(map_id, {})[frame.features.index] = _Pose(
            frame.features.stamp_s, frame.reference_keyframe, frame.T_cam_reference.copy()
        )

    def drop(self, map_id: int) -> None:
        """Remove the frames of a map."""
        self._poses.pop(map_id, None)

    def take_back(self, map_id: int, first_frame: int, last_frame: float = inf) -> tuple[int, ...]:
        """Remove the poses of a map's frames from the first to the last; their indices, in order."""
        poses = self.of(map_id)
        taken = tuple(sorted(index for index in poses if first_frame <= index <= last_frame))
        for index in taken:
            del poses[index]
        return taken

    def maps(self) -> set[int]:
        """Ids of the maps that have poses."""
        return set(self._poses)

    def of(self, map_id: int) -> dict[int, _Pose]:
        """The poses of a map's frames, by the frame's index."""
        return self._poses.get(map_id, {})

    def count(self, map_id: int) -> int:
        """Number of tracked frames of a map."""
        return len(self.of(map_id))

    def rescale(self, map_id: int, factor: np.ndarray) -> None:
        """Follow a map whose lengths have changed by ``factor`` (n_keyframes,) around each keyframe."""
        poses = self.of(map_id)
        for index, pose in poses.items():
            if factor[pose.keyframe] != 1.0:
                T = pose.T_cam_keyframe.copy()
                T[:3, 3] *= factor[pose.keyframe]
                poses[index] = _Pose(pose.stamp_s, pose.keyframe, T)

    def join(self, map_id: int, other_id: int, keyframe_offset: int, scale: float) -> None:
        """Move an absorbed map's frames to the absorbing map, whose own are kept.

        Args:
            map_id: the absorbing map.
            other_id: the absorbed one; its frames are removed.
            keyframe_offset: added to the other map's keyframe rows.
            scale: factor on the other map's lengths.
        """
        own = self._poses.setdefault(map_id, {})
        for index, pose in self._poses.pop(other_id, {}).items():
            T = pose.T_cam_keyframe.copy()
            T[:3, 3] *= scale
            own.setdefault(index, _Pose(pose.stamp_s, pose.keyframe + keyframe_offset, T))

    def trajectory(self, map_id: int, map_: Map) -> MapTrajectory:
        """Trajectory of a map's frames in the current map."""
        poses = self.of(map_id)
        frames = sorted(poses)
        T_map_cam = np.empty((len(frames), 4, 4))
        for i, index in enumerate(frames):
            pose = poses[index]
            T_map_cam[i] = np.linalg.inv(pose.T_cam_keyframe @ map_.T_cam_map(pose.keyframe))
        stamps = np.array([poses[index].stamp_s for index in frames])
        return MapTrajectory(map_id, np.array(frames, int), stamps, T_map_cam)


def keyframe_trajectory(map_: Map) -> MapTrajectory:
    """Keyframe trajectory of a map, in order of time.

    A frame that is a keyframe of two fused maps appears once.
    """
    by_frame = {map_.frame_index(int(k)): int(k) for k in map_.keyframes()}
    rows = [by_frame[index] for index in sorted(by_frame)]
    return MapTrajectory(
        map_.map_id,
        np.array([map_.frame_index(k) for k in rows], int),
        np.array([map_.features(k).stamp_s for k in rows]),
        np.array([np.linalg.inv(map_.T_cam_map(k)) for k in rows]).reshape(-1, 4, 4),
    )
