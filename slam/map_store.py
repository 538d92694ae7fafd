"""The maps of a system and what belongs to each: places, frame poses, the last loss of tracking."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

from dslab.slam.config import SlamConfig
from dslab.slam.core.frame import FrameFeatures
from dslab.slam.loop_closing.detection import LoopDetector
from dslab.slam.map.map import Map
from dslab.slam.map.noise import KeypointNoise
from dslab.slam.map.trajectory import FramePoses
from dslab.slam.places.recognition import KeyframeDatabase
from dslab.slam.tracking.doubt import Doubt
from dslab.slam.tracking.reach import Reach
from dslab.slam.tracking.relocalization import Relocalizer
from dslab.slam.tracking.rules.registry import rules_of


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
            LoopDetector(map_, database, config.loops, config.belief),
            Relocalizer(map_, database, config.relocalization, rules_of(config.tracking)),
        )


@dataclass(frozen=True)
class Loss:
    """Loss of tracking in a map.

    Attributes:
        at: the frame that could not be tracked.
        doubt: of the map, if it was lost for that.
    """

    at: FrameFeatures
    doubt: Doubt | None = None


class MapStore:
    """The maps of a system, by id.

    Args:
        config: the system's settings.

    Attributes:
        poses: of the tracked frames of all maps.
        current_id: of the map in which tracking works, or of the one to be initialized.
        saved: ids of the maps left at a breakage, the last left first.
    """

    def __init__(self, config: SlamConfig) -> None:
        self.poses = FramePoses()
        self.current_id = 0
        self.saved: list[int] = []
        self._config = config
        self._maps: dict[int, Map] = {}
        self._noise: KeypointNoise | None = None  # of the newest map
        self._places: dict[int, Places] = {}
        self._losses: dict[int, Loss] = {}
        self._reaches: dict[int, Reach | None] = {}
        self._newest_id = 0

    def __len__(self) -> int:
        return len(self._maps)

    def __contains__(self, map_id: int) -> bool:
        return map_id in self._maps

    def __getitem__(self, map_id: int) -> Map:
        return self._maps[map_id]

    def __iter__(self) -> Iterator[int]:
        """Ids of the maps, the one with most tracked frames first."""
        return iter(sorted(self._maps, key=lambda k: (-self.poses.count(k), k)))

    @property
    def current(self) -> Map:
        """The map in which tracking works."""
        return self._maps[self.current_id]

    @property
    def is_one_unbroken(self) -> bool:
        """True if there is one map, and tracking was never lost in it."""
        return len(self._maps) == 1 and not self._losses

    def add(self, map_: Map) -> None:
        """Add a new map; its keypoints are as noisy as those of the one before."""
        if self._noise is not None:
            map_.noise = replace(self._noise)
        self._noise = map_.noise
        self._maps[map_.map_id] = map_

    def forget(self, map_id: int) -> None:
        """Remove a dropped or absorbed map, except for the poses of its frames."""
        del self._maps[map_id]
        self._places.pop(map_id, None)
        self._losses.pop(map_id, None)
        self._reaches.pop(map_id, None)

    def next_map(self) -> None:
        """Make a map that does not exist yet the current one."""
        self._newest_id += 1
        self.current_id = self._newest_id

    def save_current(self) -> None:
        """Keep the current map to be continued later."""
        self.saved.insert(0, self.current_id)

    def places(self, map_id: int) -> Places:
        """Place recognition in a map, with loop detection and relocalization."""
        if map_id not in self._places:
            self._places[map_id] = Places.of(self._maps[map_id], self._config)
        return self._places[map_id]

    @property
    def known_places(self) -> dict[int, Places]:
        """Place recognition in the maps where it was ever asked for, by their ids."""
        return self._places

    def note_loss(self, map_id: int, loss: Loss) -> None:
        """Put down that tracking was lost in a map."""
        self._losses[map_id] = loss
        self._reaches.pop(map_id, None)

    def loss(self, map_id: int) -> Loss:
        """The last loss of tracking in a map."""
        return self._losses[map_id]

    def last_keyframe(self, map_id: int) -> int:
        """The keyframe nearest in time to the last loss of tracking in a map."""
        map_, lost_at = self._maps[map_id], self.loss(map_id).at.index
        return min(map(int, map_.keyframes()), key=lambda k: abs(map_.frame_index(k) - lost_at))

    def reach(self, map_id: int) -> Reach | None:
        """Where the camera can be since it was lost in a map; None if unknown."""
        if map_id not in self._reaches:
            path = self.poses.trajectory(map_id, self._maps[map_id])
            self._reaches[map_id] = Reach.of(path) if self._config.belief else None
        return self._reaches[map_id]
