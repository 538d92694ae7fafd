"""What a tracker decides by: a search, a gate, a loss and a choice of keyframes, each a rule of its own.

A rule has no state. It reads that of the tracker which asks, and its settings; so each may be replaced alone.
"""

from abc import ABC, abstractmethod
from typing import NamedTuple, Protocol

import numpy as np

from dslab.slam.association.placing import NOTHING, Sighted
from dslab.slam.core.frame import Frame, FrameFeatures
from dslab.slam.core.results import RelativePose
from dslab.slam.map.map import Map
from dslab.slam.tracking.belief import MotionBelief
from dslab.slam.tracking.config import TrackingConfig


class Tracking(Protocol):
    """The state of a tracker that rules read; see ``slam.tracking.tracker.Tracker``."""

    map: Map
    config: TrackingConfig
    observing: bool
    velocity: np.ndarray | None
    passed_over: int
    last_keyframe: FrameFeatures | None
    resumed: FrameFeatures | None
    motion: MotionBelief
    sharpest: float


class Search(ABC):
    """Where points of the map are sought in a frame."""

    @abstractmethod
    def predict(self, tracking: Tracking, frame: Frame, last: Frame) -> bool:
        """Find a first pose of a frame, and matches with the last one; True if both are found."""

    @abstractmethod
    def seek(self, map_: Map, frame: Frame, points: np.ndarray, observing: bool) -> None:
        """Match a frame with points (Q,) int32 of a map about its pose.

        Args:
            map_: of the points.
            frame: with a pose; its matches are replaced or added to.
            points: see there.
            observing: count in the map how often its points are in view.
        """

    def learn(self, tracking: Tracking, frame: Frame, last: Frame) -> None:
        """Learn from a frame that counts as tracked, before the velocity is its own; nothing by itself."""
        return


class Gate(ABC):
    """Which matches of a frame are believed."""

    @abstractmethod
    def refine(self, map_: Map, frame: Frame, also: Sighted = NOTHING) -> tuple[int, np.ndarray]:
        """Refine a frame's pose by its matches, take the outliers from it.

        Args:
            map_: of its matches.
            frame: with a pose to start from.
            also: k further points that it shows.

        Returns:
            Number of inliers among the matches, and (k,) bool which of the further ones are.
        """

    def relative(self, map_: Map, frame: Frame) -> RelativePose | None:
        """Return a frame's pose relative to its reference keyframe and how well it is known; here unknown."""
        return None


class Loss(ABC):
    """When a frame that has a pose counts as lost."""

    least_inliers: int
    """Fewer tell no pose."""

    @abstractmethod
    def fault(self, tracking: Tracking, frame: Frame, last: Frame, inliers: int) -> str:
        """Why a frame counts as lost; empty if it does not."""

    def fault_of_view(self, tracking: Tracking, frame: Frame, last: Frame) -> str:
        """What the view says against its pose, however many inliers it has; empty for nothing."""
        return ""


class KeyframeChoice(ABC):
    """When a tracked frame becomes a keyframe."""

    @abstractmethod
    def may(self, tracking: Tracking, frame: Frame, mapping_is_idle: bool) -> bool:
        """Return True if the frame comes late enough to be one, whatever it shows."""

    @abstractmethod
    def wants(self, tracking: Tracking, frame: Frame, inliers: int, mapping_is_idle: bool) -> bool:
        """Return True if the frame is to become one."""


class Rules(NamedTuple):
    """The four rules of a tracker."""

    search: Search
    gate: Gate
    loss: Loss
    keyframe: KeyframeChoice
