"""Relation between two sides of a map, as asserted by a loop closure, a fusion or a relocalization."""

from dataclasses import dataclass

import numpy as np

from dslab.slam.core.snapshot import Immutable


@dataclass(frozen=True, eq=False)
class PlacedFrames(Immutable):
    """Poses of frames in one map, nearest to the recognised place first.

    Attributes:
        frames: (n,) int frame indices.
        stamps_s: (n,) float64 their times.
        T_map_cam: (n, 4, 4) float64 rigid poses, camera to map.
    """

    frames: np.ndarray
    stamps_s: np.ndarray
    T_map_cam: np.ndarray


@dataclass(frozen=True, eq=False)
class Relation(Immutable):
    """Where a loop closure, a fusion or a relocalization asserts that two sides lie to each other.

    Both sides are in the frame and scale of the old one, as they were at the moment of the declaration and
    before anything was corrected: later drift and repair do not change it.

    Attributes:
        old: keyframes around the recognised one.
        new: keyframes around the recognising one, moved by the asserted similarity; of a relocalization the
            frames that were on probation.
        depth: median depth of the points that the recognised keyframe sees, map units; 0 without any.
    """

    old: PlacedFrames
    new: PlacedFrames
    depth: float
