"""Where a saved map may be in the current one, until the views of a time have told."""

from dataclasses import dataclass, field

import numpy as np

from dslab.slam.dual.fusion.fuse import FusionConfig
from dslab.slam.loop_closing.map_alignment import Alignment, agree
from dslab.slam.loop_closing.place_check import (
    PlaceCheckConfig,
    asked_span_s,
    double_in_reach,
    fault_of_view,
    within_reach,
)
from dslab.slam.map.map import Map
from dslab.slam.optimization.sim3 import sim3_inverse


@dataclass
class Hypothesis:
    """A similarity between the current map and a saved one, and what views say of it.

    Attributes:
        old: the saved map.
        alignments: those that gave this similarity, the newest last.
        verdicts: by keyframe of the current map that says something: what is against it, empty for nothing.
    """

    old: Map
    alignments: list[Alignment]
    verdicts: dict[int, str] = field(default_factory=dict)

    @property
    def newest(self) -> Alignment:
        """Its last alignment."""
        return self.alignments[-1]

    def is_that_of(self, alignment: Alignment, config: FusionConfig) -> bool:
        """Return True if an alignment gives the same similarity."""
        same_map = self.newest.old_map_id == alignment.old_map_id
        return same_map and agree(self.old, self.newest, alignment, config)

    def look(self, current: Map, keyframe: int, config: PlaceCheckConfig) -> None:
        """Ask the view of a further keyframe."""
        if keyframe in self.verdicts:
            return
        fault = fault_of_view(current, keyframe, self.old, self.newest, config, self.alignments[0])
        if fault is not None:
            self.verdicts[keyframe] = fault

    def is_sound(self, share: float) -> bool:
        """Return True if most views speak for it."""
        faults = list(self.verdicts.values())
        return faults.count("") >= share * len(faults)

    def is_nearly_as_good_as(self, other: "Hypothesis", share: float) -> bool:
        """Return True if most views speak for it, and half as many as for another one."""
        return self.is_sound(share) and 2 * self._speak_for() >= other._speak_for()

    def _speak_for(self) -> int:
        return list(self.verdicts.values()).count("")

    def accepted(self, current: Map, place: PlaceCheckConfig, confirmations: int) -> tuple[Alignment, ...]:
        """The alignments to fuse with, the newest last; empty as long as more is asked."""
        rows = sorted(self.verdicts)
        asked_s = asked_span_s(self.old, current, place)
        sound = place.far_sound if asked_s else place.min_sound
        if double_in_reach(self.old, current, self.newest.S_old_new, place):
            asked_s, sound = place.far_max_s, place.double_sound
        seen_s = current.features(rows[-1]).stamp_s - current.features(rows[0]).stamp_s
        if seen_s < asked_s - 1e-6 or self.verdicts[rows[-1]]:
            return ()
        if not self.is_sound(sound):
            return ()
        standing = [a for a in self.alignments if not current.arrays.kf_bad[a.new_keyframe]]
        olds = {a.old_keyframe for a in standing}
        return tuple(standing) if len(olds) >= confirmations else ()


def rival(one: Hypothesis, other: Hypothesis, config: PlaceCheckConfig) -> bool:
    """Return True if at most one of two hypotheses can hold.

    Two places of one map are two. Those of two maps may be one; then they tell how these lie to each other,
    and the camera must have been able to come from one to the other.
    """
    if one.old is other.old:
        return not agree(one.old, one.newest, other.newest, config.apart)
    older, younger = sorted((one, other), key=lambda h: h.old.map_id)
    S = older.newest.S_old_new @ sim3_inverse(younger.newest.S_old_new)
    return not within_reach(older.old, younger.old, np.ascontiguousarray(S), config.reach)
