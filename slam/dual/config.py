"""Settings of Dual-SLAM."""

from dataclasses import dataclass, field

from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.dual.recovery.registry import ThreadSpec


@dataclass(frozen=True)
class DualConfig:
    """Settings of Dual-SLAM.

    Attributes:
        buffer_s: span of the feature buffer; the paper finds 10 s to work well.
        buffer_cap_s: the most that it grows to before recovery starts. Beyond it the oldest frames leave;
            once the last saved map's newest keyframe has left, recovery has nothing to reach and says so.
        start_keyframes: keyframes of the new map when recovery starts: enough for a sound first geometry.
        max_start_noise: largest median noise of the new map's frames, over the usual, when recovery starts. A
            map begun from smeared frames is dropped, and another one begun: its scale wanders unseen.
        recovery_threads: the recoveries of a breakage, each a thread; n of Eq. 1 is their number. The first
            in this order that succeeds counts.
        workers: recovery threads that run at the same time, of one breakage or of several.
        exhaustive: every thread is run to its end, also after one has succeeded; the first success counts.
        relocalization: until a new map has its start keyframes, frames are sought in the saved maps too.
        relocalization_maps: number of these saved maps, the last saved first.
        place_merging: acceptance of a saved map that keyframes of the current one recognise; None for never.
    """

    buffer_s: float = 10.0
    buffer_cap_s: float = 60.0
    start_keyframes: int = 5
    max_start_noise: float = 1.5
    recovery_threads: tuple[ThreadSpec, ...] = (ThreadSpec("orb"), ThreadSpec("sift"))
    workers: int = 2
    exhaustive: bool = False
    relocalization: bool = True
    relocalization_maps: int = 2
    place_merging: FusionConfig | None = field(default_factory=FusionConfig)

    def __post_init__(self) -> None:
        """Check the settings."""
        for spec in self.recovery_threads:
            if not isinstance(spec, ThreadSpec):
                raise ValueError(
                    f"recovery_threads must be ThreadSpec, as of parse_threads('orb,sift'); one is {spec!r}"
                )
        if self.workers < 1:
            raise ValueError(f"workers must be 1 or more, is {self.workers}")
        if not self.max_start_noise >= 1:
            raise ValueError(f"max_start_noise must be 1 or more, is {self.max_start_noise}")
