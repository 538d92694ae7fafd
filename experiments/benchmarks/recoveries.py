"""Recoveries from the breakages of healthy maps over many sequences, every thread to its end."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from dslab.experiments.benchmarks.kept_rows import keep_rows
from dslab.experiments.evaluation.alignment import Undefined, align_poses
from dslab.experiments.evaluation.breakages import BreakageOutcome, breakage_outcomes
from dslab.experiments.evaluation.declared_audit import audit_declared
from dslab.experiments.evaluation.metrics import associate, path_length_m, position_errors_m, rms
from dslab.experiments.evaluation.view_overlap import best_overlap, is_rescuable
from dslab.experiments.jobs.ledger import Row
from dslab.experiments.runs.execution import RunRecord, execute
from dslab.experiments.runs.sources import open_sequence
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_folder
from dslab.scenarios.loading import load_scenario
from dslab.scenarios.spec import Scenario
from dslab.sim.sequence import Sequence as ImageSequence
from dslab.slam.core.events import Fusion, RecoveryStart
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.registry import parse_threads
from dslab.slam.factory import build_system

KEY = ("scenario", "seed", "threads", "breakage")
_BEFORE_S, _LEAST_POSES = 5.0, 15
_LEAST_BOUND_M, _BOUND_SHARE = 0.1, 0.05  # of the path in that time


def measure_recoveries(
    scenarios: Sequence[str],
    seeds: Sequence[int],
    threads: str,
    folder: Path,
    workers: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> pd.DataFrame:
    """Run Dual-SLAM over sequences of scenarios; one row per breakage, kept in a folder.

    Every thread runs to its end, and nothing but recoveries brings maps together: no relocalization in saved
    maps, no fusion by place. Sequences that the folder has already are not run again. A seed is that of the
    sequence and of the system.

    Args:
        scenarios: names or files.
        seeds: of each scenario.
        threads: kinds of the recovery threads in order, such as ``"orb,sift"``.
        folder: see :func:`experiments.benchmarks.kept_rows.keep_rows`.
        workers: number of processes.
        progress: called with (step, sequences done, sequences in all).

    Returns:
        Rows with ``breakage`` from 1 on; 0 for a sequence without one.

    Raises:
        InputError: the folder is of something else or other code; a sequence has no ground truth.
    """
    jobs = [(scenario, seed, threads) for seed in seeds for scenario in scenarios]
    return keep_rows(folder, "recoveries", KEY, {job: job for job in jobs}, run_sequence, workers, progress)


def run_sequence(job: tuple[str, int, str]) -> list[Row]:
    """One row per breakage of a sequence; one without a breakage if there is none."""
    scenario, seed, threads = job
    sequence = open_sequence(scenario, seed)
    if sequence.T_world_cam is None:
        raise InputError(scenario, "has no ground truth", "name a sequence or scenario with ground truth")
    dual = DualConfig(
        recovery_threads=parse_threads(threads), exhaustive=True, relocalization=False, place_merging=None
    )
    record = execute(
        sequence, "dual", seed, build=lambda kind, camera, s: build_system(kind, camera, s, dual=dual)
    )
    about = {"scenario": scenario, "seed": seed, "threads": threads}
    world = None if is_folder(Path(scenario)) else load_scenario(scenario, seed)
    return [about | row for row in breakage_rows(record, world, dual.buffer_s)]


def breakage_rows(
    record: RunRecord, scenario: Scenario | None = None, buffer_s: float = DualConfig.buffer_s
) -> list[Row]:
    """What broke, whether the map was right until then, what each thread came to, whether a fusion is false.

    A map is healthy if its live poses of the last 5 s lie within .1 m or 5 % of the path, after a similarity.
    ``to_fusion_s`` is the time from the recovery's start, at the new map's fifth keyframe, to the fusion.
    ``view_overlap`` is the largest of two usable frames on either side, by exact depth: see
    :func:`usable_frames`.

    Args:
        record: of a run over a sequence with ground truth.
        scenario: that the sequence was rendered from; without it the overlap stays unknown.
        buffer_s: span of the frames before a breakage that a recovery has.
    """
    sequence = record.sequence
    stamps_s, segments = np.asarray(sequence.stamps_s), sequence.segments
    truth = np.empty((0, 4, 4)) if sequence.T_world_cam is None else sequence.T_world_cam
    false = {f.event: f.audit.false for f in audit_declared(record).fusions}
    rows: list[Row] = []
    for number, outcome in enumerate(breakage_outcomes(record.events, segments, stamps_s), start=1):
        before = _error_before(record, outcome)
        error_m, bound_m = before or (None, None)
        fusion = outcome.fusion if outcome.recovered else None
        ends = {e.thread: e for e in outcome.recoveries}
        usable = usable_frames(sequence, outcome, buffer_s)
        rows.append({
            "breakage": number, "frame": outcome.breakage.frame, "map_id": outcome.breakage.map_id,
            "reason": outcome.breakage.reason, "dropped": outcome.dropped,
            "cause": "" if outcome.segment is None else segments[outcome.segment].kind,
            "error_m": error_m, "bound_m": bound_m,
            "healthy": None if before is None else before[0] <= before[1],
            "view_overlap": best_overlap(scenario, truth, *usable).overlap if scenario and before else None,
            "rescued": outcome.recovered,
            "false_fusion": None if fusion is None else false[fusion],
            "to_fusion_s": None if fusion is None else fusion.stamp_s - _start_s(record, fusion),
            **{f"thread_{k}": e.success for k, e in ends.items()},
            **{f"thread_{k}_reason": f"{e.stage}: {e.reason}".strip(": ") for k, e in ends.items()},
        })  # fmt: skip
    return rows or [
        {
            "breakage": 0, "cause": "", "healthy": None, "rescued": None, "false_fusion": None,
            "view_overlap": None, "to_fusion_s": None,
        }
    ]  # fmt: skip


def usable_frames(
    sequence: ImageSequence, outcome: BreakageOutcome, buffer_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Frames on which no stress acts, before and after what broke the map.

    Before: as many as a recovery's buffer holds. Without a stress the two sides meet at the breakage.
    """
    frames, stamps_s = np.arange(len(sequence)), np.asarray(sequence.stamps_s)
    acts = np.zeros(len(sequence), bool)
    for segment in sequence.segments:
        acts |= segment.mask(len(sequence))
    first, last = outcome.breakage.frame, outcome.breakage.frame - 1
    if outcome.segment is not None:
        cause = sequence.segments[outcome.segment]
        first, last = cause.first_frame, cause.last_frame
    before = (frames < first) & (stamps_s >= stamps_s[first] - buffer_s) & ~acts
    return frames[before], frames[(frames > last) & ~acts]


def _start_s(record: RunRecord, fusion: Fusion) -> float:
    """Time at which the first thread of the recovery that led to a fusion began."""
    of_fusion = (fusion.old_map_id, fusion.new_map_id)
    starts = [e for e in record.events if isinstance(e, RecoveryStart) and e.frame <= fusion.frame]
    return min((e.stamp_s for e in starts if (e.old_map_id, e.map_id) == of_fusion), default=np.nan)


def _error_before(record: RunRecord, outcome: BreakageOutcome) -> tuple[float, float] | None:
    """Error of the broken map's live poses in the last seconds, and its bound, m; None if too few."""
    broke, live = outcome.breakage, record.live.get(outcome.breakage.map_id)
    stamps_s, T_world_cam = np.asarray(record.sequence.stamps_s), record.sequence.T_world_cam
    if live is None or T_world_cam is None:
        return None
    pairs = associate(live, stamps_s, T_world_cam)
    recent = (pairs.frames < broke.frame) & (stamps_s[pairs.frames] >= broke.stamp_s - _BEFORE_S)
    pairs = pairs.where(recent)
    if len(pairs) < _LEAST_POSES:
        return None
    aligned = align_poses(pairs.T_map_cam, pairs.T_world_cam)
    if isinstance(aligned, Undefined):
        return None
    path_m = path_length_m(T_world_cam[pairs.frames[0] : pairs.frames[-1] + 1])
    return rms(position_errors_m(pairs, aligned)), max(_LEAST_BOUND_M, _BOUND_SHARE * path_m)


def recovery_sums(rows: pd.DataFrame) -> pd.DataFrame:
    """Per scenario and cause: breakages of healthy maps; of these rescued, and by each thread to its end.

    With the median and the 95th percentile of the time from a recovery's start to its fusion, s. Where views
    on either side overlap too little for any recovery by images, ``views`` is ``hopeless``, else ``shared``;
    ``unknown`` without exact depth.
    """
    healthy = rows[rows.healthy.eq(True)].copy()  # it may be missing, as what follows
    threads = [name for name in rows.columns if name.startswith("thread_") and name[7:].isdigit()]
    for name in ("rescued", "false_fusion", *sorted(threads)):
        healthy[name] = healthy[name].eq(True)
    healthy["breakages"] = 1
    healthy["to_fusion_s"] = healthy["to_fusion_s"].astype(float)  # all may be None
    overlap = healthy["view_overlap"] if "view_overlap" in healthy else pd.Series(None, healthy.index)
    healthy["views"] = [
        "unknown" if pd.isna(share) else "shared" if is_rescuable(share) else "hopeless" for share in overlap
    ]
    groups = healthy.groupby(["scenario", "cause", "views"])
    sums = groups[["breakages", "rescued", *sorted(threads), "false_fusion"]].sum()
    delay = groups["to_fusion_s"]
    sums["to_fusion_s_median"], sums["to_fusion_s_p95"] = delay.median(), delay.quantile(0.95)
    return sums.reset_index()
