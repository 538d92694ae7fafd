"""How far a camera can have come since its last pose."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from slam.core.results import MapTrajectory


@dataclass(frozen=True)
class ReachConfig:
    """Bounds of a motion that nobody has seen.

    Attributes:
        factor: on the speed at which the camera moved in the map, of which it may be this much faster.
        slack_s: time before the last pose from which on it may have been wrong already.
        fast_share: share of its motion in which the camera was slower than the speed that is used.
    """

    factor: float = 1.0
    slack_s: float = 0.5
    fast_share: float = 0.95


@dataclass(frozen=True)
class Reach:
    """Positions that a camera can have reached, going on as fast as it moved in its map.

    Attributes:
        centre: (3,) its last position, frame map.
        stamp_s: time of that position.
        speed: greatest usual speed, map units per second.
        config: bounds.
    """

    centre: np.ndarray
    stamp_s: float
    speed: float
    config: ReachConfig

    @classmethod
    def of(cls, path: MapTrajectory, config: ReachConfig) -> Self | None:
        """Reach from the end of a path; None if it is too short to have a speed."""
        if len(path.frames) < 3:
            return None
        centres = path.T_map_cam[:, :3, 3]
        speeds = np.linalg.norm(np.diff(centres, axis=0), axis=1) / np.diff(path.stamps_s)
        return cls(
            centres[-1], float(path.stamps_s[-1]), float(np.quantile(speeds, config.fast_share)), config
        )

    def allows(self, centre: np.ndarray, stamp_s: float) -> bool:
        """Return True if the camera can be at ``centre`` (3,) at a time."""
        time_s = abs(stamp_s - self.stamp_s) + self.config.slack_s
        return bool(np.linalg.norm(centre - self.centre) <= self.config.factor * self.speed * time_s)
