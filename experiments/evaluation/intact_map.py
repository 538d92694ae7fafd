"""The verdict *intact map* on a run, by which the paper counts failures.

Source: Huang et al., "Dual-SLAM", IROS 2020. Sec. V-A and Table II: "Failure rate = # failure / # trials"; a
failure is a trial in which the system "fails to construct an intact map" (Sec. IV-B). Table III of Sec. V-B:
a trial that needs recovery is a failure unless the recovery succeeds. Fig. 8: "In cases where the SLAM
breaks, large sections of ground-truth become visible." How large is not said: the bound below is ours. A late
start is no failure there (Fig. 6).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dslab.slam.core.results import MapTrajectory

MOST_GAP_S = 5.0
"""Longest section that an intact map may lack."""


@dataclass(frozen=True)
class IntactMap:
    """The verdict.

    Attributes:
        intact: one map goes from the first pose of the run to the end of the sequence.
        longest_gap_s: longest time in there without a pose of that map; None without a map.
        reason: why it is not intact; empty if it is.
    """

    intact: bool
    longest_gap_s: float | None
    reason: str


def judge_intact(
    trajectories: Sequence[MapTrajectory], first_pose_s: float | None, end_s: float
) -> IntactMap:
    """Judge the final maps of a run, of any system: only poses are asked for.

    Args:
        trajectories: final paths of all maps, that with most frames first.
        first_pose_s: stamp of the first frame that had a pose in any map, live or in the end; None for none.
        end_s: stamp of the last frame of the sequence.
    """
    if not trajectories or first_pose_s is None or not len(trajectories[0].stamps_s):
        return IntactMap(False, None, "no map")
    stamps_s = np.concatenate([[first_pose_s], trajectories[0].stamps_s, [end_s]])
    gaps_s = np.diff(np.sort(stamps_s))
    widest = int(gaps_s.argmax())
    gap_s = float(gaps_s[widest])
    if gap_s <= MOST_GAP_S:
        return IntactMap(True, gap_s, "")
    where = "at its end" if widest == len(gaps_s) - 1 else "at its start" if widest == 0 else "within"
    return IntactMap(False, gap_s, f"lacks {gap_s:.1f} s {where}")
