"""Interface of recovery threads, which extend the new map backward to an old one.

Source: paper, Sec. III-B and Algorithm 1.
"""

import math
import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol, Self, TypeVar

import numpy as np

from dslab.slam.config import SlamConfig
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.frame import Frame, FrameFeatures
from dslab.slam.core.settings import setting, settings
from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.features.remembered import Remembered
from dslab.slam.loop_closing.map_alignment import Alignment
from dslab.slam.map.map import Map
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.tracking.belief import MotionBelief
from dslab.slam.tracking.config import TrackingConfig
from dslab.slam.tracking.doubt import DoubtConfig

Found = TypeVar("Found")


@dataclass
class Cancellation:
    """Request to a recovery thread to end: nothing depends on its result any more."""

    requested: bool = False


@dataclass
class ReusedTime:
    """CPU time that others spent on what a run found in images."""

    cpu_ms: float = 0.0


@dataclass(frozen=True)
class RecoveryTask:
    """Input of a recovery thread.

    Attributes:
        new_map: the thread's own copy of the new map, to be extended.
        first: the new map's first frame, tracked in it.
        backward: buffered frames before it, newest first.
        old_maps: the saved maps that the buffer reaches, newest first; read only.
        step: T_cam_last of one frame backward, from the new map's first motion.
        rng: stream of this thread.
        camera: the camera of the images.
        image_of: the (H, W) uint8 image of a frame by its index; the first frame's and the buffered ones'
            are available to a thread that declares ``needs_images``.
        motion: how far the motion model was off so far; the thread's own.
        cancellation: asked for between frames by a thread that can be ended early.
        system: settings of the system, for all that the thread's own leave open.
        remembered: what threads have found in images, with the time it took, shared by copies of the system;
            None for nothing.
        reused: the time that this run was saved by that.
    """

    new_map: Map
    first: Frame
    backward: Sequence[FrameFeatures]
    old_maps: Sequence[Map]
    step: np.ndarray
    rng: np.random.Generator
    camera: PinholeCamera
    image_of: Callable[[int], np.ndarray]
    motion: MotionBelief = field(default_factory=MotionBelief)
    cancellation: Cancellation = field(default_factory=Cancellation)
    system: SlamConfig = field(default_factory=SlamConfig)
    remembered: Remembered[tuple[Any, float]] | None = None
    reused: ReusedTime = field(default_factory=ReusedTime)

    def found_in(self, index: int, find: Callable[[np.ndarray], Found], kind: Hashable) -> Found:
        """What ``find`` returns for the image of a frame; see :class:`Remembered`."""
        is_new = False

        def timed(image: np.ndarray) -> tuple[Found, float]:
            nonlocal is_new
            is_new, started_s = True, time.thread_time()
            return find(image), 1e3 * (time.thread_time() - started_s)

        image = self.image_of(index)
        found, cpu_ms = timed(image) if self.remembered is None else self.remembered.of(image, timed, kind)
        self.reused.cpu_ms += 0.0 if is_new else cpu_ms
        return found


@dataclass
class RecoveryResult:
    """Result of a recovery thread.

    Attributes:
        success: an alignment was found and confirmed.
        stage: the stage that failed: ``propagation``, ``overlap`` or ``sim3``; ``cancelled`` if it was ended;
            empty on success.
        reason: reason of the failure.
        frames_covered: number of buffered frames processed.
        frames_passed_over: those of them that got no pose.
        frames_checked: number of buffered frames processed once more, to check the recovery.
        keyframes_made: keyframes added to the new map, and to the map by which that was checked.
        alignments_tried: pairs of keyframes at which the maps were compared.
        inliers: of the last placed frame, or of the alignment on success.
        alignment: the accepted similarity, None on failure.
        confirming: the earlier alignments that agree with it.
        map: the new map as extended.
        frames: the frames placed backward.
    """

    map: Map
    success: bool = False
    stage: str = ""
    reason: str = ""
    frames_covered: int = 0
    frames_passed_over: int = 0
    frames_checked: int = 0
    keyframes_made: int = 0
    alignments_tried: int = 0
    inliers: int = 0
    alignment: Alignment | None = None
    confirming: tuple[Alignment, ...] = ()
    frames: list[Frame] = field(default_factory=list)


@dataclass(frozen=True)
class RecoveryCost:
    """Measured time of a thread's steps on one core, for lockstep mode.

    Attributes:
        frame_ms: per buffered frame processed.
        keyframe_ms: per keyframe made.
        alignment_ms: per pair of keyframes compared.
        start_ms: before the first of these.
    """

    frame_ms: float
    keyframe_ms: float
    alignment_ms: float
    start_ms: float = 0.0

    def seconds(self, result: RecoveryResult) -> float:
        """Duration of a recovery with this result."""
        return 1e-3 * (
            self.start_ms
            + self.frame_ms * (result.frames_covered + result.frames_checked)
            + self.keyframe_ms * result.keyframes_made
            + self.alignment_ms * result.alignments_tried
        )


class RecoveryThread(Protocol):
    """A kind of recovery thread; it keeps no state between runs.

    Attributes:
        name: name of the kind.
        needs_images: the buffer must hold images, not only features.
        cost: time of its steps.
    """

    name: str
    needs_images: bool
    cost: RecoveryCost

    def run(self, task: RecoveryTask) -> RecoveryResult:
        """Go backward over the buffer until the maps overlap or tracking fails."""
        ...


@settings
class RecoveryConfig:
    """Settings of a recovery thread; kinds with settings of their own extend it."""

    max_unusable_s: float = setting(
        2.0, "longest run of frames without a pose; 0: none, as in the paper; null: any", le=math.inf
    )
    whole_buffer: bool = setting(
        False, "go back to the buffer's end, as in the paper, not only until alignments agree"
    )
    at_once: bool = setting(
        False, "compare maps once, at the buffer's end, as in the paper, not at each keyframe"
    )
    tracking: TrackingConfig | None = setting(None, "tracking backward; null for the system's own")
    mapping: LocalMappingConfig | None = setting(None, "local mapping backward; null for the system's own")
    fusion: FusionConfig = setting(FusionConfig(), "acceptance of the old map")
    doubt: DoubtConfig = setting(
        DoubtConfig(min_share=0.0, slower=2.0), "doubt of the map that grows backward; unsteady poses pass"
    )

    def tracking_in(self, task: RecoveryTask) -> TrackingConfig:
        """Settings of tracking: the thread's, or else the system's."""
        return replace(self.tracking or task.system.tracking, doubt=self.doubt)

    def mapping_in(self, task: RecoveryTask) -> LocalMappingConfig:
        """Settings of local mapping: the thread's, or else the system's."""
        return self.mapping or task.system.mapping

    @classmethod
    def extending(cls, config: "RecoveryConfig | None") -> Self:
        """Return ``config`` if it is of this class, else settings with its shared fields."""
        if isinstance(config, cls):
            return config
        shared = {f.name: getattr(config, f.name) for f in fields(RecoveryConfig)} if config else {}
        return cls(**shared)
