"""Settings of Dual-SLAM."""

from dslab.slam.core.settings import setting, settings
from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.dual.recovery.registry import ThreadSpec


@settings
class DualConfig:
    """Settings of Dual-SLAM."""

    buffer_s: float = setting(10.0, "span of the feature buffer; the paper finds 10 s to work well", gt=0)
    buffer_cap_s: float = setting(
        60.0, "most that the buffer grows to before recovery starts; beyond it the oldest frames leave", gt=0
    )
    start_keyframes: int = setting(5, "keyframes of the new map when recovery starts, for a sound geometry")
    max_start_noise: float = setting(
        1.5, "largest median noise of a new map, over the usual; a noisier one is begun anew", ge=1
    )
    recovery_threads: tuple[ThreadSpec, ...] = setting(
        (ThreadSpec("orb"), ThreadSpec("sift")), "recoveries of a breakage; the first success in order counts"
    )
    workers: int = setting(2, "recovery threads that run at the same time", ge=1)
    exhaustive: bool = setting(False, "run every thread to its end, also after one has succeeded")
    relocalization: bool = setting(True, "seek frames in saved maps while the new map is small")
    relocalization_maps: int = setting(2, "saved maps that are searched, the last saved first")
    place_merging: FusionConfig | None = setting(
        FusionConfig(), "acceptance of a saved map whose place is recognised; null for never"
    )
