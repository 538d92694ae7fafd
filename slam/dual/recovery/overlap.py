"""Overlap of the extended map with old maps, tested at keyframes of similar time."""

import numpy as np

from slam.core.frame import Frame
from slam.dual.fusion.fuse import FusionConfig, confirms
from slam.dual.recovery.interface import RecoveryTask
from slam.loop_closing.map_alignment import Alignment, align
from slam.loop_closing.place_check import doubt
from slam.map.map import Map


class Overlap:
    """Aligns the extended map with old maps at keyframes of about the same time.

    Attributes:
        tried: number of keyframe pairs compared.
        confirming: the earlier alignments that agree with the last one.
    """

    def __init__(self, task: RecoveryTask, config: FusionConfig) -> None:
        self._task = task
        self._config = config
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
        self.confirming: tuple[Alignment, ...] = ()

    @property
    def accepted(self) -> Alignment:
        """The last alignment found."""
        return self._found[-1]

    def is_old_keyframe(self, frame: Frame) -> bool:
        """Return True if an old map has a keyframe of this same frame."""
        return any(frame.features.index in keyframes for keyframes in self._keyframes)

    def attempt(self, frame: Frame, keyframe: int) -> bool:
        """Align this keyframe with every old map close in time; True once enough alignments agree."""
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
        self.confirming = tuple(e for e in self._found if confirms(old, e, alignment, self._config))
        self._found.append(alignment)
        if len(self.confirming) + 1 < self._config.confirmations:
            return False
        self._doubt = doubt(old, task.new_map, alignment, task.rng, self._config.place)
        return not self._doubt

    def verdict(self) -> tuple[str, str]:
        """(stage, reason) of a recovery without a confirmed alignment."""
        if self._doubt:
            return "sim3", self._doubt
        if self._found:
            return "sim3", "alignments_do_not_agree" if len(self._found) > 1 else "alignment_not_confirmed"
        if "sim3" in self._failures:
            return "sim3", "too_few_inliers"
        return "overlap", "too_few_common_points" if self._failures else "old_map_not_reached"
