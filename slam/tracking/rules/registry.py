"""The rules of tracking by the names that settings give them."""

from dslab.slam.tracking.config import TrackingConfig
from dslab.slam.tracking.rules import own, published
from dslab.slam.tracking.rules.interface import Rules

_BY_NAME = {
    "own": Rules(own.OwnSearch(), own.OwnGate(), own.OwnLoss(), own.OwnKeyframeChoice()),
    "published": Rules(
        published.PublishedSearch(),
        published.PublishedGate(),
        published.PublishedLoss(),
        published.PublishedKeyframeChoice(),
    ),
}


def rules_of(config: TrackingConfig) -> Rules:
    """The rules that settings name."""
    return _BY_NAME[config.rules]
