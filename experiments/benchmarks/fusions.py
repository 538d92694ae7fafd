"""How long fusions hold the tracking thread up, and frames dropped beside recoveries and fusions."""

from collections.abc import Sequence

import numpy as np

from dslab.experiments.runs.execution import RunRecord

_STAGE = "fusion"


def fusion_figures(records: Sequence[RunRecord]) -> dict:
    """Figures of fusions over repeated runs.

    Returns:
        ``count``: number of fusions; ``hold_up_ms_max``: longest wall time that the tracking thread spent on
        one, None without any. ``beside_frames``: frames fed from the start of a recovery to its end or
        fusion, and those in which a fusion was taken over; ``beside_dropped``: frames dropped there;
        ``other_frames``, ``other_dropped``: all others.
    """
    hold_ups_ms = [r.ms[_STAGE] for record in records for r in record.results if _STAGE in r.ms]
    figures = {"count": 0, "hold_up_ms_max": max(hold_ups_ms, default=None)}
    figures |= dict.fromkeys(("beside_frames", "beside_dropped", "other_frames", "other_dropped"), 0)
    for record in records:
        beside, dropped = frames_beside_recovery(record), dropped_after(record)
        figures["count"] += sum(e.kind == "fusion" and e.record()["accepted"] for e in record.events)
        for name, mask in (("beside", beside), ("other", ~beside)):
            figures[f"{name}_frames"] += int(mask.sum())
            figures[f"{name}_dropped"] += int(dropped[mask].sum())
    return figures


def frames_beside_recovery(record: RunRecord) -> np.ndarray:
    """(n,) bool mask of the frames during which a recovery or a fusion was under way."""
    beside = np.zeros(len(record.results), bool)
    started: dict[int, int] = {}
    for event in record.events:
        if event.kind == "recovery_start":
            started.setdefault(event.map_id, event.frame)
        elif event.kind == "recovery_end":
            beside[started[event.map_id] : event.frame + 1] = True
        elif event.kind == "fusion":
            first = started.get(event.record()["new_map_id"], event.frame)
            beside[first : event.frame + 1] = True
    return beside


def dropped_after(record: RunRecord) -> np.ndarray:
    """(n,) int number of frames dropped after each frame fed."""
    stamps_s = record.sequence.stamps_s
    if len(stamps_s) < 2:
        return np.zeros(len(stamps_s), int)
    steps_s = np.diff(stamps_s)
    return np.append(np.rint(steps_s / np.median(steps_s)).astype(int) - 1, 0)
