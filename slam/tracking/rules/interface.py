"""What a tracker decides by: a search, a gate, a loss and a choice of keyframes, each a rule of its own.

A rule has no state. It reads that of the tracker which asks, and its settings; so each may be replaced alone.
"""

from abc import ABC, abstractmethod
from typing import NamedTuple, Protocol

import numpy as np

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

    def optimize(self, frame: Frame) -> int:
        """Refine a frame's pose by its matches, by the gate; number of inliers."""
        ...


class Search(ABC):
    """Where points of the map are sought in a frame."""

    @abstractmethod
    def predict(self, tracking: Tracking, frame: Frame, last: Frame) -> bool:
        """Find a first pose of a frame, and matches with the last one; True if both are found."""

    @abstractmethod
    def match_local_map(self, tracking: Tracking, frame: Frame) -> int:
        """Match a frame with the map around its pose; the keyframe that shares most with it, -1 for none."""

    def learn(self, tracking: Tracking, frame: Frame, last: Frame) -> None:
        """Learn from a frame that counts as tracked, before the velocity is its own; nothing by itself."""
        return


class Gate(ABC):
    """Which matches of a frame are believed."""

    @abstractmethod
    def optimize(self, tracking: Tracking, frame: Frame) -> int:
        """Refine a frame's pose by its matches, take the outliers from it; number of inliers."""

    def relative(self, tracking: Tracking, frame: Frame) -> RelativePose | None:
        """Return a frame's pose relative to its reference keyframe and how well it is known; here unknown."""
        return None


class Loss(ABC):
    """When a frame that has a pose counts as lost."""

    @abstractmethod
    def least_inliers(self, tracking: Tracking, frame: Frame, usual: int) -> int:
        """Inliers that a pose must have, where usually ``usual`` suffice."""

    @abstractmethod
    def fault(self, tracking: Tracking, frame: Frame, last: Frame, inliers: int, matches: int) -> str:
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
