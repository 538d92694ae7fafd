"""Is a unit's stress rescuable by images: do usable frames on either side of it share surface?"""

from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.eq1.arms import settings_of
from dslab.experiments.eq1.units import UnitSpec
from dslab.experiments.evaluation.view_overlap import best_overlap
from dslab.experiments.runs.execution import slam_camera
from dslab.sim.sequence import Sequence


def overlap_columns(unit: UnitSpec, sequence: Sequence, cache_dir: Path | None = None) -> dict[str, Any]:
    """The columns of the view overlap about the stress, from truth and exact depth.

    Usable are frames on which the stress does not act: as many before it as Dual-SLAM's buffer holds, and all
    behind it.

    Args:
        unit: its spec; null columns for a sham, which has no stress, and a system without recovery.
        sequence: its frames.
        cache_dir: folder of rendered sequences; None for the default one.
    """
    acting = [segment for segment in sequence.segments if segment.first_frame >= 0]
    if not acting or sequence.T_world_cam is None or not unit.recovers:
        return {"view_overlap": None, "rescuable": None}
    _, dual = settings_of(unit).of(unit.system, slam_camera(sequence.camera))
    first = min(segment.first_frame for segment in acting)
    last = max(segment.last_frame for segment in acting)
    since_s = sequence.stamps_s[first] - dual.buffer_s
    before = np.flatnonzero(sequence.stamps_s[:first] >= since_s)
    after = range(last + 1, len(sequence))
    found = best_overlap(unit.scenario, sequence.T_world_cam, before, after, cache_dir=cache_dir)
    return {"view_overlap": found.overlap, "rescuable": found.is_rescuable}
