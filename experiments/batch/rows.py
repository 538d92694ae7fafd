"""The row of a run: its columns, and how they are made from a record."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.end_alignment import end_alignment_error_m
from dslab.experiments.runs.execution import RunRecord

Row = dict[str, Any]

CONTENT = "sequence_digest"
DOSE = "dose"
KEY = (CONTENT, DOSE, "system", "run")
STAGE = "stage_"
"""Start of the columns with the median CPU time of a stage, milliseconds."""
ERROR = "error"
"""In ``ended``: the run could not be made, which says nothing of the system."""
DECLARED = ("loops", "relocalizations", "joins", "fusions")
"""What the audit judges, of all that a system declares."""
COLUMNS = {
    "source": ("string", "the sequence, as named"),
    "sequence": ("string", "its own name"),
    CONTENT: ("string", "hash of its images, times, camera and truth, or of the scenario"),
    "stress": ("string", "the segments that were added"),
    DOSE: ("Float64", "the value of theirs that is one of a series"),
    "system": ("string", "name of the system"),
    "run": ("Int64", "number of the run, from 0"),
    "seed": ("Int64", "seed of the system"),
    "folder": ("string", "its result folder, within that of the batch"),
    "first_frame": ("Int64", "first frame of the sequence that was given"),
    "frames": ("Int64", "frames that the system was given"),
    "dropped_frames": ("Int64", "further ones that were too late to be given"),
    "unreadable_frames": ("Int64", "further ones that could not be read"),
    "ended": ("string", "how the run ended; `error` if it could not be made"),
    "ended_message": ("string", "a line about that"),
    "declares": ("string", "what the system says of itself"),
    "live_poses": ("string", "`given` frame by frame, or `final` ones in their place"),
    "intact": ("boolean", "one map goes from the first pose to the end"),
    "intact_reason": ("string", "why not"),
    "longest_gap_s": ("Float64", "longest section that the map lacks"),
    "completeness": ("Float64", "share of all frames that have a pose in the main map in the end"),
    "share_tracked": ("Float64", "share of all frames that had a pose live"),
    "path_share": ("Float64", "share of the true path between frames of the main map"),
    "frames_to_initialise": ("Int64", "frames up to the first live pose"),
    "time_to_initialise_s": ("Float64", "from the first frame to the first live pose"),
    "ate_m": ("Float64", "RMSE of the frames of the main map after Sim(3) alignment"),
    "keyframe_ate_m": ("Float64", "that of its keyframes"),
    "scale_first_over_last": ("Float64", "scale of the path's first quarter over that of its last"),
    "end_alignment_m": ("Float64", "RMS between the path aligned to its start and to its end"),
    "ate_reason": ("string", "why there is none"),
    "rpe_m": ("Float64", "RMSE of the translation over one second"),
    "rpe_deg": ("Float64", "RMSE of the rotation over one second"),
    "breakages": ("Int64", "breakages that the system declared"),
    "recoveries": ("Int64", "of them recovered"),
    "recoveries_needed": ("Int64", "of them followed by a recovery"),
    "recovered_by_first": ("Int64", "recovered by its first thread"),
    "recovered_by_later": ("Int64", "by a later one"),
    "recovery_s": ("Float64", "mean time from a breakage to the fusion that a recovery brought"),
    "relocalizations": ("Int64", "of them relocalized"),
    "relocalization_s": ("Float64", "mean time from a breakage to its relocalization"),
    **{f"declared_{name}": ("Int64", f"{name} that it declared; null without truth") for name in DECLARED},
    **{f"false_{name}": ("Int64", f"{name} that are false") for name in DECLARED},
    "unjudged": ("Int64", "of what it declared, what could not be judged"),
    "maps": ("Int64", "maps in the end"),
    "ms_median": ("Float64", "tracking per frame, wall"),
    "cpu_ms_median": ("Float64", "tracking per frame, CPU of its thread"),
    "cpu_ms_p95": ("Float64", "likewise, 95th percentile"),
    "mapping_cpu_ms_median": ("Float64", "mapping per keyframe"),
    "loop_cpu_ms_median": ("Float64", "loop closing per keyframe"),
    "cpu_s": ("Float64", "CPU of tracking, mapping and loop closing; of a program all that it used"),
    "wall_s": ("Float64", "time in the system; of a program with its start"),
    "peak_rss_mb": ("Float64", "largest resident memory"),
    "spec": ("string", "hash of the settings of the batch"),
    "system_digest": ("string", "hash of the class or the description of the system"),
    "code": ("string", "hash of the code that makes images and poses"),
    "commit": ("string", "of the lab"),
}
_OF_SUMMARY = (
    "frames", "dropped_frames", "unreadable_frames", "ended", "ended_message", "declares", "live_poses",
    "intact", "intact_reason", "longest_gap_s", "completeness", "share_tracked", "path_share",
    "ate_m", "keyframe_ate_m", "rpe_m", "rpe_deg",
    "frames_to_initialise", "time_to_initialise_s", "breakages", "recoveries", "relocalizations", "maps",
    "ms_median", "cpu_ms_median", "cpu_ms_p95", "mapping_cpu_ms_median", "loop_cpu_ms_median", "peak_rss_mb",
    "commit", "ate_reason", "scale_first_over_last",
)  # fmt: skip


def figures_of(record: RunRecord, summary: dict) -> Row:
    """The columns of a row that its run decides.

    Args:
        record: the run.
        summary: of :func:`experiments.evaluation.summary.summarise`.
    """
    return {
        **{name: summary[name] for name in _OF_SUMMARY},
        "end_alignment_m": _end_alignment_m(record),
        "cpu_s": _cpu_s(record),
        "wall_s": record.wall_s,
        **_recoveries(summary["breakage_list"]),
        **_declared(summary["audit"]),
        **{f"{STAGE}{name}": times["cpu_ms_median"] for name, times in summary["stages"].items()},
    }


def typed(rows: list[Row], systems: Sequence[str]) -> pd.DataFrame:
    """Rows as a table, sorted, its types independent of which figures are missing.

    Args:
        rows: of runs.
        systems: their names in the order of the batch, which is kept: others stand beside the first.
    """
    stages = sorted({str(name) for row in rows for name in row if str(name).startswith(STAGE)})
    types = {name: kind for name, (kind, _) in COLUMNS.items()} | dict.fromkeys(stages, "Float64")
    table = pd.DataFrame(rows, columns=list(types))
    by, rank = ["source", DOSE, "system", "run"], {name: place for place, name in enumerate(systems)}
    table = table.astype(types).sort_values(
        by, kind="stable", key=lambda of: of.map(rank) if of.name == "system" else of
    )
    return table.reset_index(drop=True)


def _recoveries(breakages: list[dict]) -> Row:
    """Recoveries that were needed, what brought them about, how long they and relocalizations took."""
    by = [b["thread"] for b in breakages if b["recovered"]]
    lost_s = [b["lost_s"] for b in breakages if b["lost_s"] is not None]
    took_s = [b["repair_time_s"] - b["time_s"] for b in breakages if b["recovered"]]
    return {
        "recoveries_needed": sum(b["recovery_threads"] > 0 for b in breakages),
        "recovered_by_first": by.count(1),
        "recovered_by_later": len(by) - by.count(1),
        "recovery_s": float(np.mean(took_s)) if took_s else None,
        "relocalization_s": float(np.mean(lost_s)) if lost_s else None,
    }


def _declared(audit: dict | None) -> Row:
    """Number of declarations by kind, how many of them are false, how many were not judged."""
    if audit is None:
        return {}
    verdicts = {name: [found["false"] for found in audit[name]] for name in DECLARED}
    return {
        **{f"declared_{name}": len(of_kind) for name, of_kind in verdicts.items()},
        **{f"false_{name}": of_kind.count(True) for name, of_kind in verdicts.items()},
        "unjudged": sum(of_kind.count(None) for of_kind in verdicts.values()),
    }


def _cpu_s(record: RunRecord) -> float:
    own_ms = sum(sum(r.cpu_ms.values()) + r.mapping_cpu_ms + r.loop_cpu_ms for r in record.results)
    return own_ms / 1000 if record.cpu_s is None else record.cpu_s


def _end_alignment_m(record: RunRecord) -> float | None:
    sequence = record.sequence
    if sequence.T_world_cam is None or not record.trajectories:
        return None
    error_m = end_alignment_error_m(record.trajectories[0], sequence.stamps_s, sequence.T_world_cam)
    return None if isinstance(error_m, Undefined) else error_m
