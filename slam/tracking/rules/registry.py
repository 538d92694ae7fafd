"""The rules of tracking by the names that settings give them."""

from dslab.slam.tracking.config import TrackingConfig
from dslab.slam.tracking.rules import derived, own, published
from dslab.slam.tracking.rules.interface import Rules

OWN = Rules(own.OwnSearch(), own.OwnGate(), own.OwnLoss(), own.OwnKeyframeChoice())
PUBLISHED = Rules(
    published.PublishedSearch(),
    published.PublishedGate(),
    published.PublishedLoss(),
    published.PublishedKeyframeChoice(),
)
DERIVED = Rules(
    derived.DerivedSearch(), derived.DerivedGate(), derived.DerivedLoss(), derived.DerivedKeyframeChoice()
)
_BY_NAME = {"own": OWN, "published": PUBLISHED, "derived": DERIVED}


def rules_of(config: TrackingConfig) -> Rules:
    """The rules that settings name."""
    return Rules(
        _BY_NAME[config.search].search,
        _BY_NAME[config.gate].gate,
        _BY_NAME[config.loss].loss,
        _BY_NAME[config.keyframe].keyframe,
    )
