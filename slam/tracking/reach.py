"""How far a camera can have come since its last pose."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from dslab.slam.belief.model import Unseen
from dslab.slam.core.results import MapTrajectory
from dslab.slam.core.settings import setting, settings


@settings
class ReachConfig:
    """Bounds of a motion that nobody has seen."""

    factor: float = setting(1.25, "largest speed of the unseen camera over that in the map")
    slack_s: float = setting(0.5, "time before the last pose from which on it may have been wrong already")
    fast_share: float = setting(0.95, "share of its motion slower than the speed used", le=1)
    memory_s: float = setting(2.0, "time for which a place out of reach rules out those that follow from it")


@dataclass(frozen=True)
class Reach:
    """Positions that a camera can have reached, going on as fast as it moved in its map.

    Attributes:
        centre: (3,) its last position, frame map.
        stamp_s: time of that position.
        speed: greatest usual speed, map units per second.
        config: bounds.
        ruled_out: times and positions that were asked for and not allowed, of the last ``memory_s`` seconds.
    """

    centre: np.ndarray
    stamp_s: float
    speed: float
    config: ReachConfig
    ruled_out: list[tuple[float, np.ndarray]] = field(default_factory=list)

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
        """Return True if the camera can be at ``centre`` (3,) at a time; if not, this is remembered."""
        self.ruled_out[:] = [
            (at_s, position)
            for at_s, position in self.ruled_out
            if abs(stamp_s - at_s) <= self.config.memory_s
        ]
        follows = any(self._is_near(centre, position, stamp_s - at_s) for at_s, position in self.ruled_out)
        if follows or not self._is_near(centre, self.centre, stamp_s - self.stamp_s):
            self.ruled_out.append((stamp_s, np.array(centre)))
            return False
        return True

    def follows(self, centre: np.ndarray, stamp_s: float, before: np.ndarray, before_s: float) -> bool:
        """Return True if the camera can have come to ``centre`` (3,) from a position just before."""
        gap_s = abs(stamp_s - before_s)
        return gap_s <= self.config.memory_s and self._is_near(centre, before, gap_s)

    def unseen(self, centre: np.ndarray, stamp_s: float, depth: float) -> Unseen:
        """The motion from its last position to ``centre`` (3,) at a time, in lengths of a median depth."""
        depth = depth or np.nan  # of no points
        since_s, away = abs(stamp_s - self.stamp_s), float(np.linalg.norm(centre - self.centre))
        return Unseen(since_s, self._radius(since_s) / depth, away / depth)

    def _is_near(self, centre: np.ndarray, other: np.ndarray, time_s: float) -> bool:
        return bool(np.linalg.norm(centre - other) <= self._radius(time_s))

    def _radius(self, time_s: float) -> float:
        return self.config.factor * self.speed * (abs(time_s) + self.config.slack_s)
