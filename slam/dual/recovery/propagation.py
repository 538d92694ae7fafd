"""Backward propagation over the buffer to where the maps overlap, shared by all recovery threads.

Source: paper, Sec. III-B, III-C and Algorithm 1, lines 3-10 and 16-20.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dslab.slam.belief.belief import DISBELIEVED
from dslab.slam.core.events import CANCELLED
from dslab.slam.core.frame import Frame
from dslab.slam.dual.fusion.fuse import FusionConfig, confirms
from dslab.slam.dual.recovery.common_points import align_all, pairs_close_in_time
from dslab.slam.dual.recovery.interface import RecoveryConfig, RecoveryResult, RecoveryTask
from dslab.slam.loop_closing.map_alignment import Alignment, align
from dslab.slam.loop_closing.supposed import Supposed
from dslab.slam.map.map import Map
from dslab.slam.mapping.local_mapping import LocalMapper
from dslab.slam.tracking.tracker import Tracker

Objection = Callable[[Map, Alignment], str]
"""What speaks against an alignment with an old map; empty if nothing does."""


def propagate(
    task: RecoveryTask,
    config: RecoveryConfig,
    tracker: Tracker,
    mapper: LocalMapper,
    object_more: Objection | None = None,
) -> RecoveryResult:
    """Track the buffered frames newest first, map them, align with the old maps.

    Args:
        task: input; its new map is extended in place.
        config: settings.
        tracker: estimates poses in the new map; started at the task's first frame.
        mapper: extends the new map.
        object_more: what else may speak against an alignment, asked when nothing in the maps does.
    """
    result = RecoveryResult(task.new_map)
    overlap = Overlap(task, config.fusion, config.at_once, object_more)
    unusable_since_s = None
    for features in task.backward:  # lines 3, 16: for frame F_i in K do
        if task.cancellation.requested:
            result.stage = CANCELLED
            return result
        frame = Frame(features)
        result.frames_covered += 1
        outcome = tracker.track(frame)  # lines 4, 5: motion model; lines 17, 18: SIFT matches and PnP
        if not outcome.success:  # line 6: fewer tracked points than the threshold
            result.frames_passed_over += 1
            if unusable_since_s is None:
                unusable_since_s = features.stamp_s
            if unusable_since_s - features.stamp_s >= config.max_unusable_s:
                result.stage, result.reason = "propagation", outcome.reason
                return result  # line 7: break
            tracker.pass_over(frame)
            continue
        if tracker.doubt.reason:
            result.stage, result.reason = "propagation", tracker.doubt.reason
            return result
        unusable_since_s = None
        result.inliers = outcome.inliers
        result.frames.append(frame)
        if overlap.is_old_keyframe(frame) or tracker.wants_keyframe(frame, outcome.inliers):
            keyframe = mapper.insert(frame)  # lines 10, 20: bundle adjustment and reconstruction
            result.keyframes_made += 1
            tracker.keyframe_made(frame, keyframe)
            confirmed = overlap.attempt(frame, keyframe)
            result.alignments_tried = overlap.tried
            if confirmed and not config.whole_buffer:
                break
    overlap.compare_all()
    result.alignments_tried = overlap.tried
    if overlap.accepted is None:
        result.stage, result.reason = overlap.verdict()
    else:
        result.success, result.inliers = True, overlap.accepted.inliers
        result.alignment, result.confirming = overlap.accepted, overlap.confirming
    return result


class Overlap:
    """Aligns the extended map with old maps at keyframes of about the same time.

    Attributes:
        accepted: the alignment that is confirmed; None while none is.
        confirming: the earlier alignments that agree with it.
        tried: number of keyframe pairs compared.
    """

    def __init__(
        self,
        task: RecoveryTask,
        config: FusionConfig,
        at_once: bool = False,
        object_more: Objection | None = None,
    ) -> None:
        """Prepare the comparison.

        Args:
            task: of the recovery.
            config: acceptance of an alignment.
            at_once: compare all keyframes together, by :meth:`compare_all`.
            object_more: asked last, of an alignment against which nothing else speaks.
        """
        self._task = task
        self._config = config
        self._beliefs = task.system.belief
        self._at_once = at_once
        self._object_more = object_more
        self._compared: list[int] = []
        self._keyframes = [
            {old.frame_index(int(k)): int(k) for k in old.keyframes()} for old in task.old_maps
        ]
        self._stamps_s = [
            np.array([old.features(k).stamp_s for k in keyframes.values()])
            for old, keyframes in zip(task.old_maps, self._keyframes, strict=True)
        ]
        self._found: list[Alignment] = []
        self._failures: list[str] = []
        self._objection = ""
        self.tried = 0
        self.accepted: Alignment | None = None
        self.confirming: tuple[Alignment, ...] = ()

    def is_old_keyframe(self, frame: Frame) -> bool:
        """Return True if an old map has a keyframe of this same frame."""
        return any(frame.features.index in keyframes for keyframes in self._keyframes)

    def attempt(self, frame: Frame, keyframe: int) -> bool:
        """Align this keyframe with every old map close in time; True once enough alignments agree."""
        self._compared.append(keyframe)
        if self.accepted is not None or self._at_once:
            return self.accepted is not None
        for old, keyframes, stamps_s in zip(
            self._task.old_maps, self._keyframes, self._stamps_s, strict=True
        ):
            # Rounded to microseconds: of two keyframes as near as each other the first is taken.
            apart_s = np.abs(stamps_s - frame.features.stamp_s).round(6)
            nearest = int(apart_s.argmin())
            near = apart_s[nearest] <= self._config.max_time_gap_s
            if near and self._align(old, list(keyframes.values())[nearest], keyframe):
                return True
        return False

    def _align(self, old: Map, old_keyframe: int, keyframe: int) -> bool:
        task = self._task
        self.tried += 1
        alignment, reason, _ = align(old, task.new_map, old_keyframe, keyframe, task.rng, self._config)
        if alignment is None:
            self._failures.append(reason)
            return False
        confirming = tuple(e for e in self._found if confirms(old, e, alignment, self._config))
        self._found.append(alignment)
        if len(confirming) + 1 < self._config.confirmations:
            return False
        alignment, self._objection = self._asked(old, alignment)
        if not self._objection and self._object_more is not None:
            self._objection = self._object_more(old, alignment)
        if self._objection:
            return False
        self.accepted, self.confirming = alignment, confirming
        return True

    def _asked(self, old: Map, alignment: Alignment) -> tuple[Alignment, str]:
        """An alignment with what is believed of it, and what speaks against it."""
        if self._beliefs is None:
            return alignment, ""
        supposed = Supposed(old, self._task.new_map, alignment, self._beliefs)
        objection = "" if supposed.is_believed() else DISBELIEVED
        return replace(alignment, believed=supposed.believed), objection

    def compare_all(self) -> None:
        """If all keyframes are to be compared at once, do so: the newest old map that fits is accepted."""
        for old in self._task.old_maps if self._at_once else ():
            pairs = pairs_close_in_time(old, self._task.new_map, self._compared, self._config)
            self.tried += len(pairs)
            if pairs:
                new = self._task.new_map
                found, reason, _ = align_all(old, new, pairs, self._task.rng, self._config)
                if found is None:
                    self._failures.append(reason)
                    continue
                self._objection = "" if self._object_more is None else self._object_more(old, found)
                if not self._objection:
                    self.accepted = found
                    return

    def verdict(self) -> tuple[str, str]:
        """(stage, reason) of a recovery without a confirmed alignment."""
        if self._objection:
            return "sim3", self._objection
        if self._found:
            return "sim3", "alignments_do_not_agree" if len(self._found) > 1 else "alignment_not_confirmed"
        if "sim3" in self._failures:
            return "sim3", "too_few_inliers"
        return "overlap", "too_few_common_points" if self._failures else "old_map_not_reached"
