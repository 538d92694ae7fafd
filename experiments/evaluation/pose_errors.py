"""Errors of single poses by an alignment to the truth, and the bounds beyond which a pose is wrong."""

from dataclasses import dataclass

import numpy as np

from dslab.experiments.evaluation.alignment import Similarity
from dslab.experiments.evaluation.metrics import PosePairs, position_errors_m, rotation_errors_deg


@dataclass(frozen=True)
class PoseBounds:
    """Bounds beyond which a pose counts as wrong.

    Attributes:
        position_share: position error allowed per metre of the extent over which poses are compared.
        position_floor_m: position error allowed in any case.
        rotation_deg: orientation error allowed.
    """

    position_share: float = 0.05
    position_floor_m: float = 0.1
    rotation_deg: float = 5.0

    def position_m(self, extent_m: np.ndarray | float) -> np.ndarray:
        """Position error allowed over an extent, metres."""
        return np.maximum(self.position_floor_m, self.position_share * np.asarray(extent_m))


@dataclass(frozen=True)
class PoseErrors:
    """Errors of single poses in a common alignment.

    Attributes:
        frames: (n,) int frame indices.
        position_m, bound_m, rotation_deg: (n,) float64.
        false: (n,) bool, out of bounds.
    """

    frames: np.ndarray
    position_m: np.ndarray
    bound_m: np.ndarray
    rotation_deg: np.ndarray
    false: np.ndarray


def pose_errors(
    pairs: PosePairs, alignment: Similarity, extent_m: np.ndarray | float, bounds: PoseBounds
) -> PoseErrors:
    """Compare poses with the truth.

    Args:
        pairs: n poses.
        alignment: of their map to the world.
        extent_m: (n,), or one for all: the extent over which they are compared.
        bounds: of a right pose.
    """
    position_m, rotation_deg = position_errors_m(pairs, alignment), rotation_errors_deg(pairs, alignment)
    bound_m = np.broadcast_to(bounds.position_m(extent_m), position_m.shape)
    right = (position_m <= bound_m) & (rotation_deg <= bounds.rotation_deg)
    return PoseErrors(pairs.frames, position_m, bound_m, rotation_deg, ~right)
