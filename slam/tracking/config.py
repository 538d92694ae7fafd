"""Settings of the tracker."""

from typing import Literal

from dslab.slam.core.settings import setting, settings
from dslab.slam.tracking.doubt import DoubtConfig

Rule = Literal["own", "published"]
"""By which a tracker decides: ours, or ORB-SLAM's as published."""


@settings
class TrackingConfig:
    """Rules and thresholds of the tracker; the thresholds are those of our own rules."""

    rules: Rule = setting("own", "what decides: covariances; published: what ORB-SLAM's text says")
    max_uncertainty: float = setting(0.05, "rad or median depths by which a pose may be unknown")
    local_map_keyframes: int = setting(20, "most keyframes of the local map")
    keyframe_information: float = setting(
        0.75, "share of the best information since the last keyframe below which one is made", le=1
    )
    urgent_information: float = setting(0.5, "keyframe_information right behind a keyframe", le=1)
    keyframe_interval_s: float = setting(0.1, "least time between keyframes")
    doubt: DoubtConfig = setting(DoubtConfig(), "bounds of a motion that is believed")
