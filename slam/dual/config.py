"""Settings of Dual-SLAM."""

from dataclasses import dataclass, field

from slam.dual.fusion.fuse import FusionConfig
from slam.dual.recovery.registry import ThreadSpec


@dataclass(frozen=True)
class DualConfig:
    """Settings of Dual-SLAM.

    Attributes:
        buffer_s: span of the feature buffer; the paper finds 10 s to work well.
        buffer_cap_s: the most that it grows to before recovery starts. Beyond it the oldest frames leave;
            once the last saved map's newest keyframe has left, recovery has nothing to reach and says so.
        start_keyframes: keyframes of the new map when recovery starts: enough for a sound first geometry.
        threads: the recovery threads, in the order in which they are tried; n of Eq. 1 is their number.
        exhaustive: every thread is run to its end, also after one has succeeded; the first success counts.
        relocalization: until a new map is initialized, frames are relocalized in the saved maps too.
        relocalization_maps: number of these saved maps, the last saved first.
        place_merging: acceptance of a saved map recognised after its recovery has failed; None for never.
    """

    buffer_s: float = 10.0
    buffer_cap_s: float = 60.0
    start_keyframes: int = 5
    threads: tuple[ThreadSpec, ...] = (ThreadSpec("orb"), ThreadSpec("sift"))
    exhaustive: bool = False
    relocalization: bool = True
    relocalization_maps: int = 2
    place_merging: FusionConfig | None = field(default_factory=FusionConfig)
