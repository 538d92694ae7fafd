"""Place recognition in one map, for loop closing and relocalization."""

from dataclasses import dataclass
from typing import Self

from slam.config import SlamConfig
from slam.loop_closing.detection import LoopDetector
from slam.map.map import Map
from slam.places.recognition import KeyframeDatabase
from slam.tracking.relocalization import Relocalizer


@dataclass(frozen=True)
class Places:
    """Keyframe database of a map, with the loop detector and the relocalizer that use it."""

    database: KeyframeDatabase
    loops: LoopDetector
    relocalizer: Relocalizer

    @classmethod
    def of(cls, map_: Map, config: SlamConfig) -> Self:
        """Set up place recognition in a map."""
        database = KeyframeDatabase(map_)
        return cls(
            database,
            LoopDetector(map_, database, config.loops),
            Relocalizer(map_, database, config.relocalization),
        )
