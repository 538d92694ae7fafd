"""Settings of the tracker."""

from typing import Literal

from dslab.slam.core.settings import setting, settings
from dslab.slam.places.evidence import EvidenceBar
from dslab.slam.tracking.doubt import DoubtConfig

Rule = Literal["own", "published", "derived"]
"""By which a tracker decides: ours, or ORB-SLAM's as published."""


@settings
class CrossingConfig:
    """What the first frame behind a gap must show of the map; a recovery puts all later poses on it."""

    bar: EvidenceBar = setting(
        EvidenceBar(min_share=0.25, max_contradicted=0.3, min_extent=0.16), "what it must show"
    )
    around: int = setting(10, "keyframes whose points are expected")
    radius_px: float = setting(10.0, "half side of the window for an expected point, level 0")
    min_expected: float = setting(20.0, "with fewer expected points the view says nothing")


@settings
class TrackingConfig:
    """Rules and thresholds of the tracker; the thresholds are those of our own rules."""

    search: Rule = setting("own", "where points are sought in a frame; published: as ORB-SLAM's text says")
    gate: Rule = setting("own", "which matches are believed, and at which noise")
    loss: Rule = setting("own", "when a frame counts as lost")
    keyframe: Rule = setting("own", "when a frame becomes a keyframe")
    search_radius_px: float = setting(15.0, "half side of the window for a predicted point; doubled once")
    gap_radius_px: float = setting(20.0, "half side of the window behind passed-over frames; doubled twice")
    min_motion_matches: int = setting(
        20, "matches below which the reference keyframe replaces the motion model"
    )
    min_motion_inliers: int = setting(
        10, "inliers below which the reference keyframe replaces the motion model"
    )
    reference_ratio: float = setting(0.8, "best over second best of reference matches", le=1)
    local_map_ratio: float = setting(0.8, "best over second best of local map matches", le=1)
    min_reference_matches: int = setting(
        15, "matches below which tracking by the reference keyframe fails too"
    )
    min_inliers: int = setting(30, "map matches that survive pose optimisation, below which tracking is lost")
    cautious_inliers: int = setting(50, "min_inliers behind passed-over frames, whose pose nothing supports")
    max_uncertainty: float = setting(0.05, "rad or median depths by which a derived pose may be unknown")
    min_share: float = setting(0.0, "share of inliers below which a frame is rejected", le=1)
    local_map_keyframes: int = setting(80, "most keyframes of the local map")
    max_noise: float = setting(2.0, "how many times orb.noise_px all corners of a frame may be off", ge=1)
    keyframe_share: float = setting(0.9, "inliers below this share of the reference's make a keyframe", le=1)
    keyframe_cover: float = setting(0.6, "share of the view with found points below which one is made", le=1)
    urgent_share: float = setting(0.5, "keyframe_share right behind a keyframe", le=1)
    urgent_inliers: int = setting(150, "inliers below which every frame becomes a keyframe")
    keyframe_information: float = setting(
        0.85, "share of the best information since the last keyframe below which one is derived", le=1
    )
    urgent_information: float = setting(0.5, "keyframe_information right behind a keyframe", le=1)
    keyframe_interval_s: float = setting(0.1, "least time between keyframes")
    crossing: CrossingConfig = setting(CrossingConfig(), "what a frame behind a gap must show")
    doubt: DoubtConfig = setting(DoubtConfig(), "bounds of a motion that is believed")

    def __post_init__(self) -> None:
        derived = [getattr(self, name) == "derived" for name in ("search", "gate", "loss", "keyframe")]
        if any(derived) and not all(derived):
            raise ValueError("search, gate, loss and keyframe are derived together, name all four or none")
