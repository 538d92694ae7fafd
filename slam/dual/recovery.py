"""Recovery: the new map, extended backward in time over the buffer until it meets the old one.

Source: paper, Sec. III-B and Algorithm 1.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from slam.dual.fusion import FusionConfig
from slam.frame import Frame, FrameFeatures
from slam.local_mapping import LocalMappingConfig
from slam.map import Map
from slam.map_alignment import Alignment
from slam.tracking import TrackingConfig


@dataclass(frozen=True)
class RecoveryTask:
    """What a recovery thread is given.

    Attributes:
        new_map: a copy of its own to extend.
        first: the new map's first frame, tracked in it.
        backward: buffered frames before it, newest first.
        old_maps: the saved maps that the buffer reaches, newest first, not to be changed.
        step: T_cam_last of one frame backward, as far as the new map's first motion tells.
        rng: stream of this thread.
    """

    new_map: Map
    first: Frame
    backward: Iterable[FrameFeatures]
    old_maps: Sequence[Map]
    step: np.ndarray
    rng: np.random.Generator


@dataclass
class RecoveryResult:
    """What a recovery thread made of it.

    Attributes:
        success: an alignment was found and confirmed.
        stage: where it failed: ``propagation``, ``overlap`` or ``sim3``; empty on success.
        reason: why.
        frames_covered: buffered frames gone back over.
        frames_passed_over: those of them that could not be tracked.
        inliers: of the last tracked frame, or of the alignment on success.
        alignment: the accepted similarity, None on failure.
        map: the new map as extended.
        frames: the frames tracked backward.
    """

    map: Map
    success: bool = False
    stage: str = ""
    reason: str = ""
    frames_covered: int = 0
    frames_passed_over: int = 0
    inliers: int = 0
    alignment: Alignment | None = None
    frames: list[Frame] = field(default_factory=list)


class RecoveryThread(Protocol):
    """One way of going back."""

    name: str

    def run(self, task: RecoveryTask) -> RecoveryResult:
        """Go back over the buffer until the maps meet or the way is lost."""
        ...


@dataclass(frozen=True)
class RecoveryConfig:
    """Settings of a recovery thread.

    Attributes:
        max_unusable_s: how long a run of frames it may pass over, carried by the motion model, before it
            gives up. The paper passes over none, its released code any number.
        tracking, mapping, fusion: settings of the parts that it reuses.
    """

    max_unusable_s: float = 2.0
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    mapping: LocalMappingConfig = field(default_factory=LocalMappingConfig)
    fusion: FusionConfig = field(default_factory=FusionConfig)
