"""Recovery: the new map, extended backward in time over the buffer until it meets the old one.

Source: paper, Sec. III-B and Algorithm 1.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import Protocol, Self

import numpy as np

from slam.core.camera import PinholeCamera
from slam.core.frame import Frame, FrameFeatures
from slam.dual.fusion.fuse import FusionConfig
from slam.loop_closing.map_alignment import Alignment
from slam.map.map import Map
from slam.mapping.local_mapping import LocalMappingConfig
from slam.tracking.tracker import TrackingConfig


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
        camera: what the images were taken with.
        image_of: the (H, W) uint8 image of a frame by its index; the first frame's and the buffered ones'
            are there for a thread that has said that it needs images.
    """

    new_map: Map
    first: Frame
    backward: Sequence[FrameFeatures]
    old_maps: Sequence[Map]
    step: np.ndarray
    rng: np.random.Generator
    camera: PinholeCamera
    image_of: Callable[[int], np.ndarray]


@dataclass
class RecoveryResult:
    """What a recovery thread made of it.

    Attributes:
        success: an alignment was found and confirmed.
        stage: where it failed: ``propagation``, ``overlap`` or ``sim3``; empty on success.
        reason: why.
        frames_covered: buffered frames gone back over.
        frames_passed_over: those of them that could not be placed.
        keyframes_made: keyframes that the new map has gained.
        alignments_tried: pairs of keyframes at which the maps were compared.
        inliers: of the last placed frame, or of the alignment on success.
        alignment: the accepted similarity, None on failure.
        confirming: the earlier ones that agree with it.
        map: the new map as extended.
        frames: the frames placed backward.
    """

    map: Map
    success: bool = False
    stage: str = ""
    reason: str = ""
    frames_covered: int = 0
    frames_passed_over: int = 0
    keyframes_made: int = 0
    alignments_tried: int = 0
    inliers: int = 0
    alignment: Alignment | None = None
    confirming: tuple[Alignment, ...] = ()
    frames: list[Frame] = field(default_factory=list)


@dataclass(frozen=True)
class RecoveryCost:
    """What a thread's steps take on one core, measured; lockstep mode reckons the time of a recovery by it.

    Attributes:
        frame_ms: per buffered frame gone over.
        keyframe_ms: per keyframe made.
        alignment_ms: per pair of keyframes compared.
    """

    frame_ms: float
    keyframe_ms: float
    alignment_ms: float

    def seconds(self, result: RecoveryResult) -> float:
        """The time that a recovery with this result takes."""
        return 1e-3 * (
            self.frame_ms * result.frames_covered
            + self.keyframe_ms * result.keyframes_made
            + self.alignment_ms * result.alignments_tried
        )


class RecoveryThread(Protocol):
    """One way of going back. It keeps nothing from one run to the next.

    Attributes:
        name: of its kind.
        needs_images: whether frames must be held as images and not only as features.
        cost: the time that its steps take.
    """

    name: str
    needs_images: bool
    cost: RecoveryCost

    def run(self, task: RecoveryTask) -> RecoveryResult:
        """Go back over the buffer until the maps meet or the way is lost."""
        ...


@dataclass(frozen=True)
class RecoveryConfig:
    """Settings of a recovery thread; kinds with settings of their own extend it.

    Attributes:
        max_unusable_s: how long a run of frames it may pass over before it gives up; 0 for none, as in the
            paper, infinity for any number, as in its released code.
        tracking, mapping, fusion: settings of the parts that it reuses.
    """

    max_unusable_s: float = 2.0
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    mapping: LocalMappingConfig = field(default_factory=LocalMappingConfig)
    fusion: FusionConfig = field(default_factory=FusionConfig)

    def __post_init__(self) -> None:
        """Check what has no other guard."""
        if not self.max_unusable_s >= 0:
            raise ValueError(f"max_unusable_s must be 0 or more, is {self.max_unusable_s}")

    @classmethod
    def extending(cls, config: "RecoveryConfig | None") -> Self:
        """These settings, where ``config`` has them; what is shared taken from it, where it has not."""
        if isinstance(config, cls):
            return config
        shared = {f.name: getattr(config, f.name) for f in fields(RecoveryConfig)} if config else {}
        return cls(**shared)
