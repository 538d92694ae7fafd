"""Overlap of the extended map with old maps, tested at keyframes of similar time."""

from collections.abc import Callable

import numpy as np

from dslab.slam.core.frame import Frame
from dslab.slam.dual.fusion.fuse import FusionConfig, confirms
from dslab.slam.dual.recovery.common_points import align_all, pairs_close_in_time
from dslab.slam.dual.recovery.interface import RecoveryTask
from dslab.slam.loop_closing.map_alignment import Alignment, align
from dslab.slam.loop_closing.place_check import double_in_reach, fault_of_alignment
from dslab.slam.map.map import Map

Doubt = Callable[[Map, Alignment], str]
"""What speaks against an alignment with an old map; empty if nothing does."""


class Overlap:
    """Aligns the extended map with old maps at keyframes of about the same time.

    Attributes:
        accepted: the alignment that is confirmed; None while none is.
        confirming: the earlier alignments that agree with it.
        tried: number of keyframe pairs compared.
    """

    def __init__(
        self, task: RecoveryTask, config: FusionConfig, at_once: bool = False, doubt_more: Doubt | None = None
    ) -> None:
        """Prepare the comparison.

        Args:
            task: of the recovery.
            config: acceptance of an alignment.
            at_once: compare all keyframes together, by :meth:`compare_all`.
            doubt_more: asked last, of an alignment against which nothing else speaks.
        """
        self._task = task
        self._config = config
        self._place = config.place or task.system.place
        self._at_once = at_once
        self._doubt_more = doubt_more
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
        self._doubt = ""
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
        self._doubt = fault_of_alignment(old, task.new_map, alignment, task.rng, self._place)
        if not self._doubt and double_in_reach(old, task.new_map, alignment.S_old_new, self._place):
            self._doubt = "look_alike_in_reach"
        if not self._doubt and self._doubt_more is not None:
            self._doubt = self._doubt_more(old, alignment)
        if self._doubt:
            return False
        self.accepted, self.confirming = alignment, confirming
        return True

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
                self._doubt = "" if self._doubt_more is None else self._doubt_more(old, found)
                if not self._doubt:
                    self.accepted = found
                    return

    def verdict(self) -> tuple[str, str]:
        """(stage, reason) of a recovery without a confirmed alignment."""
        if self._doubt:
            return "sim3", self._doubt
        if self._found:
            return "sim3", "alignments_do_not_agree" if len(self._found) > 1 else "alignment_not_confirmed"
        if "sim3" in self._failures:
            return "sim3", "too_few_inliers"
        return "overlap", "too_few_common_points" if self._failures else "old_map_not_reached"
