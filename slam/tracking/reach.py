"""How far a camera has come since its last pose."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from dslab.slam.belief.model import Unseen
from dslab.slam.core.results import MapTrajectory

_FAST = 0.95
"""Share of a motion that is slower than the speed used."""


@dataclass(frozen=True)
class Reach:
    """Positions that a camera has reached, going on as fast as it moved in its map.

    Attributes:
        centre: (3,) its last position, frame map.
        stamp_s: time of that position.
        speed: greatest usual speed, map units per second.
    """

    centre: np.ndarray
    stamp_s: float
    speed: float

    @classmethod
    def of(cls, path: MapTrajectory) -> Self | None:
        """Reach from the end of a path; None if it is too short to have a speed."""
        if len(path.frames) < 3:
            return None
        centres = path.T_map_cam[:, :3, 3]
        speeds = np.linalg.norm(np.diff(centres, axis=0), axis=1) / np.diff(path.stamps_s)
        return cls(centres[-1], float(path.stamps_s[-1]), float(np.quantile(speeds, _FAST)))

    def unseen(self, centre: np.ndarray, stamp_s: float, depth: float) -> Unseen:
        """The motion from its last position to ``centre`` (3,) at a time, in lengths of a median depth."""
        depth = depth or np.nan
        since_s, away = abs(stamp_s - self.stamp_s), float(np.linalg.norm(centre - self.centre))
        return Unseen(since_s, self.speed * since_s / depth, away / depth)
