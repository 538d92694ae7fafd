"""The summary of a run: counts, accuracy, times, audit; null for undetermined figures."""

from collections import Counter
from collections.abc import Sequence as Many

import numpy as np

from dslab.experiments.evaluation import metrics
from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.audit_report import audit_record
from dslab.experiments.evaluation.breakages import BreakageOutcome, breakage_outcomes
from dslab.experiments.evaluation.broken_maps import breakage_figures
from dslab.experiments.evaluation.intact_map import judge_intact
from dslab.experiments.runs.execution import RunRecord
from dslab.experiments.runs.files import plain
from dslab.experiments.runs.provenance import code_hash, commit, versions
from dslab.scenarios.describe import describe_kind
from dslab.sim.sequence import Sequence
from dslab.slam.core.events import Relocalized, RescueEnd, TrackingState
from dslab.slam.core.results import TrackingResult

RPE_STEP_S = 1.0


def summarise(record: RunRecord) -> dict:
    """All figures of a run as plain JSON values.

    ``ate_m`` is the RMSE after Sim(3) alignment of the map with most frames, over ``ate_poses`` frames. It
    favours a system that gets lost early, so read it together with ``completeness``, the share of all frames
    that have a pose in this map in the end, and ``path_share``. ``keyframe_ate_m`` is that of its keyframes,
    ``rpe_*`` the error of the relative pose over one second. Shares are of all frames that there were.
    ``tracked`` counts the frames that had a pose live, ``posed`` those that have one in the end: a recovery
    adds poses, and the system may take some back. ``rescued_frames`` of the live ones were placed by
    intensities where features did not track, in ``rescues`` stretches that have ended.
    ``scale_along`` is true over estimated path length per tenth of the path, ``scale_first_over_last`` that
    of the first quarter over that of the last: 1 without scale drift. ``scale_reason`` says why they lack.
    ``cpu_ms_*`` is the CPU time of the tracking stages per frame, ``mapping_cpu_ms_*`` that of local mapping
    per keyframe, ``loop_cpu_ms_*`` that of loop closing. ``dropped_frames`` were too late to be fed,
    ``unreadable_frames`` could not be read; neither are among the ``frames``.
    ``input`` has the digests of all that the run was given: runs of equal ones are repeats of each other.
    ``ended`` says how the run ended, ``declares`` what the system says of itself (``events``, ``losses`` or
    ``nothing``), and ``live_poses`` whether they were given frame by frame: ``final`` ones stand in for them
    where a program does not say.
    """
    outcomes = breakage_outcomes(record.events, record.sequence.segments, list(record.sequence.stamps_s))
    audit = audit_record(record)
    summary = {
        "sequence": sequence_label(record.sequence),
        "source": record.sequence.source,
        "scenario_seed": record.sequence.meta.get("seed"),
        "input": record.input or None,
        "system": record.system_kind,
        "seed": record.seed,
        "ended": record.ending.kind.value,
        "ended_message": record.ending.message,
        "declares": record.declares.value,
        "live_poses": "given" if record.has_live_poses else "final",
        **_counts(record, outcomes),
        **_main_map(record),
        **_accuracy(record),
        **time_figures(record.results),
        "frames_per_s": len(record.results) / record.wall_s if record.wall_s > 0 else None,
        "peak_rss_mb": round(record.peak_rss_mb, 1),
        "commit": commit(),
        "code": code_hash(),
        "breakage_list": [_breakage(o, record) | breakage_figures(record, o, audit) for o in outcomes],
        "segments": segment_rows(record, outcomes),
        "audit": audit,
        "stages": stage_times(record.results),
        "versions": versions(),
        "config": record.config,
    }
    return plain(summary)


def sequence_label(sequence: Sequence) -> str:
    """Name of a sequence; a degraded one goes by its source's name, with its segments."""
    if "degraded" not in sequence.meta:
        return sequence.name
    stress = ", ".join(f"{describe_kind(s.kind)} {s.start_s:g}-{s.end_s:g} s" for s in sequence.segments)
    return f"{sequence.name}, degraded: {stress}"


def _commonest_reason(record: RunRecord) -> str:
    """The reason that most frames have, and in how many of them; empty without reasons."""
    reasons = Counter(result.reason for result in record.results if result.reason)
    return "{} in {} of {} frames".format(*reasons.most_common(1)[0], len(record.results)) if reasons else ""


def is_tracked(result: TrackingResult) -> bool:
    """True if the frame has a pose."""
    return result.state is TrackingState.TRACKING and result.T_map_cam is not None


def given_frames(record: RunRecord) -> int:
    """All frames that there were: fed, too late to be fed, or not readable."""
    return len(record.results) + record.dropped_frames + record.unreadable_frames


def posed_frames(record: RunRecord) -> np.ndarray:
    """(frames,) bool, true if the frame has a final pose in any map."""
    posed = np.zeros(len(record.results), bool)
    for trajectory in record.trajectories:
        posed[trajectory.frames] = True
    return posed


def main_map_pairs(record: RunRecord) -> metrics.PosePairs | None:
    """Path of the main map, which has most frames, paired with the truth; None if either is missing."""
    if record.sequence.T_world_cam is None or not record.trajectories:
        return None
    return metrics.Truth.of(record.sequence).pairs(record.trajectories[0])


def segment_rows(record: RunRecord, outcomes: list[BreakageOutcome]) -> list[dict]:
    """Figures of each injected segment: frames, breakages, repairs, ATE with its number of poses.

    The ATE of a segment is that of the main map, aligned as a whole, over the segment's frames. A breakage
    counts in one segment only, so that the sum over segments is at most that of the run: of overlapping ones,
    in that which started last.
    """
    errors, pairs = {}, main_map_pairs(record)
    if pairs is not None and not isinstance(ate := metrics.ate(pairs), Undefined):
        errors = dict(zip(pairs.frames.tolist(), ate.errors_m.tolist(), strict=True))
    rows = []
    for index, segment in enumerate(record.sequence.segments):
        inside = range(segment.first_frame, segment.last_frame + 1) if segment.first_frame >= 0 else range(0)
        own = [o for o in outcomes if o.segment == index]
        posed = [errors[f] for f in inside if f in errors]
        fields = ("kind", "severity", "start_s", "end_s", "first_frame", "last_frame")
        rows.append(
            {"index": index, **{name: getattr(segment, name) for name in fields}}
            | {
                "frames": len(inside),
                "tracked": sum(is_tracked(record.results[f]) for f in inside),
                "breakages": len(own),
                "recoveries": sum(o.recovered for o in own),
                "relocalizations": sum(o.relocalized is not None for o in own),
                "ate_m": metrics.rms(np.array(posed)) if posed else None,
                "ate_poses": len(posed),
            }
        )
    return rows


def stage_times(results: Many[TrackingResult]) -> dict[str, dict[str, float | None]]:
    """Median and 95th percentile of the times of each tracking stage, over the frames in which it ran."""
    cpu, wall = [r.cpu_ms for r in results], [r.ms for r in results]

    def ran(times_ms: list[dict[str, float]], stage: str) -> list[float]:
        return [of_frame[stage] for of_frame in times_ms if stage in of_frame]

    return {
        stage: {
            "frames": len(ran(cpu, stage)),
            "cpu_ms_median": _median(ran(cpu, stage)),
            "cpu_ms_p95": _p95(ran(cpu, stage)),
            "ms_median": _median(ran(wall, stage)),
        }
        for stage in dict.fromkeys(stage for of_frame in cpu for stage in of_frame)
    }


def _counts(record: RunRecord, outcomes: list[BreakageOutcome]) -> dict:
    tracked = [r.frame for r in record.results if is_tracked(r)]
    frames, first = len(record.results), tracked[0] if tracked else None
    given = given_frames(record)
    posed = int(posed_frames(record).sum())
    stamps_s = record.sequence.stamps_s
    rescues = [event for event in record.events if isinstance(event, RescueEnd)]
    return {
        "frames": frames,
        "dropped_frames": record.dropped_frames,
        "unreadable_frames": record.unreadable_frames,
        "tracked": len(tracked),
        "share_tracked": len(tracked) / given if given else None,
        "posed": posed,
        "share_posed": posed / given if given else None,
        "share_tracked_after_init": None if first is None else len(tracked) / (frames - first),
        "first_tracked_frame": first,
        "reason_not_initialized": _commonest_reason(record) if first is None else "",
        "frames_to_initialise": None if first is None else first + 1,
        "time_to_initialise_s": None if first is None else stamps_s[first] - stamps_s[0],
        "maps": len(record.trajectories),
        "keyframes": sum(len(k.frames) for k in record.keyframes),
        "map_points": sum(record.map_points.values()),
        "breakages": len(outcomes),
        "recoveries": sum(o.recovered for o in outcomes),
        "relocalizations": sum(o.relocalized is not None for o in outcomes),
        "rescues": len(rescues),
        "rescued_frames": sum(e.frames for e in rescues),
    }


def _accuracy(record: RunRecord) -> dict:
    names = ("ate_m", "ate_median_m", "ate_max_m", "ate_share_of_path", "scale_m_per_map_unit", "scale_along")
    names += ("scale_first_over_last", "scale_reason", "ate_poses", "keyframe_ate_m")
    names += ("path_m", "path_share", "true_path_m")
    names += ("rpe_m", "rpe_median_m", "rpe_deg", "rpe_median_deg", "rpe_pairs", "rpe_reason")
    empty = dict.fromkeys(names)
    truth = record.sequence.T_world_cam
    if truth is None:
        return {**empty, "ate_reason": "no ground truth"}
    empty["true_path_m"] = metrics.path_length_m(truth)
    empty["keyframe_ate_m"] = _keyframe_ate_m(record)
    pairs = main_map_pairs(record)
    if pairs is None:
        return {**empty, "ate_reason": "no map", "path_m": 0.0, "path_share": 0.0}
    covered = metrics.coverage(pairs.frames, truth)
    found = {**empty, "path_m": covered.path_m, "path_share": covered.share, "ate_poses": len(pairs)}
    ate = metrics.ate(pairs)
    if isinstance(ate, Undefined):
        return {**found, "ate_reason": ate.reason}
    step = max(1, round(RPE_STEP_S * record.sequence.camera.fps))
    rpe = metrics.rpe(pairs, step, ate.alignment.scale)
    scale = metrics.scale_along(pairs)
    if isinstance(scale, Undefined):
        found["scale_reason"] = scale.reason
    else:
        found |= {"scale_along": scale.relative, "scale_first_over_last": scale.first_over_last}
    return {
        **found,
        "ate_m": ate.rmse_m,
        "ate_median_m": float(np.median(ate.errors_m)),
        "ate_max_m": float(ate.errors_m.max()),
        "ate_share_of_path": ate.rmse_m / covered.path_m if covered.path_m > 0 else None,
        "scale_m_per_map_unit": ate.alignment.scale,
        "ate_reason": "",
        **_rpe(rpe),
    }


def _rpe(rpe: metrics.Rpe | Undefined) -> dict:
    if isinstance(rpe, Undefined):
        return {"rpe_reason": rpe.reason}
    return {
        "rpe_m": rpe.translation_rmse_m,
        "rpe_median_m": rpe.translation_median_m,
        "rpe_deg": rpe.rotation_rmse_deg,
        "rpe_median_deg": rpe.rotation_median_deg,
        "rpe_pairs": rpe.pairs,
        "rpe_reason": "",
    }


def _keyframe_ate_m(record: RunRecord) -> float | None:
    truth = record.sequence.T_world_cam
    if truth is None or not record.keyframes:
        return None
    ate = metrics.ate(metrics.associate(record.keyframes[0], record.sequence.stamps_s, truth))
    return None if isinstance(ate, Undefined) else ate.rmse_m


def _main_map(record: RunRecord) -> dict:
    """How much of the run the main map has in the end, and whether it is intact."""
    given = given_frames(record)
    posed = len(record.trajectories[0].frames) if record.trajectories else 0
    end_s = float(record.sequence.stamps_s[-1]) if len(record.sequence) else 0.0
    intact = judge_intact(record.trajectories, _first_pose_s(record), end_s)
    return {
        "completeness": posed / given if given else None,
        "intact": intact.intact,
        "intact_reason": intact.reason,
        "longest_gap_s": intact.longest_gap_s,
    }


def _first_pose_s(record: RunRecord) -> float | None:
    live = [result.stamp_s for result in record.results if is_tracked(result)]
    first = [float(path.stamps_s[0]) for path in record.trajectories if len(path.stamps_s)]
    return min([*live[:1], *first], default=None)


def time_figures(results: Many[TrackingResult]) -> dict[str, float | None]:
    """Medians and 95th percentiles of times: tracking per frame, mapping and loop closing per keyframe."""
    cpu = [sum(r.cpu_ms.values()) for r in results]
    mapping = [r.mapping_cpu_ms for r in results if r.mapping_cpu_ms > 0]
    loops = [r.loop_cpu_ms for r in results if r.loop_cpu_ms > 0]
    return {
        "ms_median": _median([sum(r.ms.values()) for r in results]),
        "cpu_ms_median": _median(cpu),
        "cpu_ms_p95": _p95(cpu),
        "mapping_cpu_ms_median": _median(mapping),
        "mapping_cpu_ms_p95": _p95(mapping),
        "loop_cpu_ms_median": _median(loops),
        "loop_cpu_ms_p95": _p95(loops),
    }


def _breakage(outcome: BreakageOutcome, record: RunRecord) -> dict:
    index, repair, thread = outcome.segment, outcome.repair, outcome.recovered_by
    stamps_s = record.sequence.stamps_s
    return {
        "frame": outcome.breakage.frame,
        "stamp_s": outcome.breakage.stamp_s,
        "time_s": stamps_s[outcome.breakage.frame] - stamps_s[0],
        "map_id": outcome.breakage.map_id,
        "reason": outcome.breakage.reason,
        "inliers": outcome.breakage.inliers,
        "segment": None if index is None else record.sequence.segments[index].kind,
        "segment_index": index,
        "reinit_frame": outcome.reinit_frame,
        "recovery_threads": len({end.thread for end in outcome.recoveries}),
        "recovered": outcome.recovered,
        "fusion_frame": outcome.fusion.frame if outcome.fusion else None,
        "relocalized_frame": outcome.relocalized.frame if outcome.relocalized else None,
        "lost_s": outcome.relocalized.lost_s if outcome.relocalized else None,
        "repair": "relocalization" if isinstance(repair, Relocalized) else repair and repair.by,
        "repair_frame": repair.frame if repair else None,
        "repair_time_s": stamps_s[repair.frame] - stamps_s[0] if repair else None,
        "thread": thread.thread if thread else None,
        "method": thread.method if thread else None,
        "failure_reason": outcome.failure_reason,
    }


def _median(values: Many[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _p95(values: Many[float]) -> float | None:
    return float(np.percentile(values, 95)) if len(values) else None
