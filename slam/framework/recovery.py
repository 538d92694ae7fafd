"""A recovery thread: a system that is given the buffer backward in time, from a new map to a saved one.

Source: Huang et al., 2020, Algorithm 1. It starts some way into the new map, crosses the gap, and ends as
soon as it lies on a saved map as it lies on the new one: as :mod:`slam.framework.alignment` judges.
"""

from collections.abc import Sequence as Many
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dslab.slam.core.events import PlacedKeyframe
from dslab.slam.core.relation import PlacedFrames, Relation
from dslab.slam.framework.alignment import Aligned, SeamConfig, SeenPoints, align, residuals
from dslab.slam.framework.odometry import Fed, GivenFrame, Kind
from dslab.slam.framework.pieces import JoinedMap
from dslab.slam.optimization.sim3 import moved, sim3_decompose, sim3_inverse

_STRIDE = 5  # frames between two looks whether a saved map is reached
_PLACED = 100  # most poses of a side that a relation states
_DISAGREES = 3.0
"""Distance of two poses of a frame, in median ones of the window, that by chance one in 10,000 exceeds (χ² of
three degrees of freedom)."""
_NONE = Aligned(np.eye(4), 0, "too_short")
Poses = dict[int, np.ndarray]


@dataclass(eq=False)
class Recovered:
    """What has come of a recovery thread.

    Attributes:
        old: the saved map that it has reached; None if it has failed.
        stage, reason: where and why it has failed: ``propagation``, ``overlap``, ``sim3``.
        covered: number of frames that it has placed, and ``passed_over`` of those between that it has not.
        to_new, to_old: how it lies on the two maps.
        old_poses, new_poses: of the two maps, at that time.
        bridge: its poses between the seams, in the old map.
        replaced: frames of the old map behind its seam, whose poses the recovery's replace.
        times_s: of frames.
        cpu_ms: what the system says that it took, its mapping and loops included.
    """

    old: JoinedMap | None = None
    stage: str = ""
    reason: str = ""
    covered: int = 0
    passed_over: int = 0
    to_new: Aligned = _NONE
    to_old: Aligned = _NONE
    old_poses: Poses = field(default_factory=dict)
    new_poses: Poses = field(default_factory=dict)
    bridge: Poses = field(default_factory=dict)
    replaced: set[int] = field(default_factory=set)
    times_s: dict[int, float] = field(default_factory=dict)
    cpu_ms: float = 0.0

    @property
    def S_old_new(self) -> np.ndarray:
        """(4, 4) similarity from the new map to the old one."""
        return self.to_old.S_b_a @ sim3_inverse(self.to_new.S_b_a)

    @property
    def scale(self) -> float:
        """Factor from the new map's lengths to the old one's."""
        return float(sim3_decompose(self.S_old_new)[0])

    def told(self) -> dict[str, Any]:
        """Fields of the event that ends it."""
        placed = ()
        if self.old is not None:
            placed = tuple(
                PlacedKeyframe(f, self.times_s[f], tuple(map(tuple, moved(self.S_old_new, T).tolist())))
                for f, T in sorted(self.new_poses.items())
                if f in self.times_s
            )
        return {
            "stage": self.stage,
            "reason": self.reason,
            "frames_covered": self.covered,
            "frames_passed_over": self.passed_over,
            "inliers": self.to_old.poses,
            "placed": placed,
            "cpu_ms": self.cpu_ms,
        }

    def relation(self) -> Relation:
        """What a fusion by it asserts: the sides next to the gap, in the old map."""
        old = [f for f in sorted(self.old_poses, reverse=True) if f not in self.replaced]
        new = sorted(self.new_poses)
        S = self.S_old_new
        return Relation(
            self._placed(old, self.old_poses),
            self._placed(new, {f: moved(S, self.new_poses[f]) for f in new}),
            0.0,
        )

    def _placed(self, frames: Many[int], poses: Poses) -> PlacedFrames:
        known = [f for f in frames if f in self.times_s][:_PLACED]
        stamps_s = np.array([self.times_s[f] for f in known])
        return PlacedFrames(np.array(known, int), stamps_s, np.array([poses[f] for f in known]))


def recover(
    kind: Kind, seed: int, frames: Many[GivenFrame], new: JoinedMap, saved: Many[JoinedMap], seam: SeamConfig
) -> Recovered:
    """Run a recovery thread.

    Args:
        kind: of its system.
        seed: of it.
        frames: the buffer, oldest first.
        new: the new map, in which the newest frame lies.
        saved: maps that it may reach, the newest first.
        seam: how it is judged.
    """
    new_poses, new_points = new.poses(), new.points()
    sought = [(m, m.poses(), m.points()) for m in saved]
    found = Recovered(new_poses=new_poses, times_s={frame.index: frame.stamp_s for frame in frames})
    fed = Fed(kind, seed, frames[-1].index, [frame.index for frame in reversed(frames)])
    entry, reached = min(new_poses), max(max(poses) for _, poses, _ in sought)
    found.stage, found.reason = "overlap", "no_common_frames"
    for count, frame in enumerate(reversed(frames)):
        lost = fed.feed(frame)  # line 4: the next frame, backward in time
        found.cpu_ms += fed.cpu_ms
        if lost:
            found.stage, found.reason = "propagation", lost
            if not kind.parts.returns:
                break
            continue  # it may find its place behind the gap
        if frame.index > reached or count % _STRIDE:
            continue
        own = fed.poses()
        if not own:
            assert fed.result is not None
            found.stage, found.reason = "propagation", fed.result.reason or "not_initialized"
            break
        camera, points = fed.system.camera, fed.points()
        found.to_new = _aligned(own, new_poses, seam, SeenPoints(camera, points, new_points))
        if found.to_new.refused:
            found.stage, found.reason = _stage(found.to_new)
            break
        for m, poses, old_points in sought:  # line 6: does it share enough with a saved map?
            found.to_old = _aligned(own, poses, seam, SeenPoints(camera, points, old_points))
            if not found.to_old.refused:
                _join(found, m, poses, own, entry, seam)
                break
            found.stage, found.reason = _stage(found.to_old)
        if found.old is not None:
            break
    placed = fed.poses()
    found.covered = len(placed)
    found.passed_over = max(placed) - min(placed) + 1 - len(placed) if placed else 0
    fed.finish()
    return found


def _aligned(own: Poses, other: Poses, seam: SeamConfig, points: SeenPoints) -> Aligned:
    """The recovery's map against another, by common frames, those first in time.

    The new map's first frames lie next to the gap. A saved map's last ones may be what broke it: the window
    moves on with the recovery, backward, until it fits.
    """
    common = sorted(set(own) & set(other))[: seam.window]
    T_own, T_other = (np.array([poses[f] for f in common]).reshape(-1, 4, 4) for poses in (own, other))
    return align(T_own, T_other, seam, points)


def _stage(aligned: Aligned) -> tuple[str, str]:
    """Where and why an alignment has failed."""
    return ("overlap" if aligned.refused == "too_short" else "sim3"), aligned.refused


def _join(found: Recovered, old: JoinedMap, poses: Poses, own: Poses, entry: int, seam: SeamConfig) -> None:
    """Note that a saved map is reached, up to its newest pose that agrees: behind it the recovery's stand."""
    common = np.array(sorted(set(own) & set(poses)))
    off = residuals(found.to_old.S_b_a, *(np.array([of[f] for f in common]) for of in (own, poses)))
    last = common[off <= _DISAGREES * np.median(off[: seam.window])][-1]
    found.old, found.old_poses, found.stage, found.reason = old, poses, "", ""
    found.bridge = {f: moved(found.to_old.S_b_a, T) for f, T in own.items() if last < f < entry}
    found.replaced = {f for f in poses if f > last and f in own}
