"""What is believed, of any place that is supposed."""

from dslab.slam.core.settings import setting, settings


@settings
class BeliefConfig:
    """When a supposed place counts, and what is asked of it."""

    alpha: float = setting(0.01, "chance that a place which is believed is another one", gt=0, le=0.5)
    patience_s: float = setting(1.0, "time for which a place may be less likely than not")
    around: int = setting(10, "keyframes whose points are expected, those that share most")
    views: int = setting(5, "keyframes around a loop or join that are asked at once")
