"""What happened in runs, as tables: figures, breakages, the audit against the truth."""

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from dslab.experiments.cli.console import number, out, share, table_of
from dslab.experiments.evaluation.audit_text import audit_text, silent_losses
from dslab.scenarios.describe import describe_kind

_REASONS = {
    "too_few_matches_with_last_frame": "too few matches with the last frame",
    "too_few_local_map_inliers": "too few inliers in the local map",
    "too_many_outliers": "too many outliers in the local map",
    "uncertain_pose": "a pose that is not known",
    "one_place_decides": "a pose that hangs on one place of the image",
    "view_disagrees": "points of the map that the view does not show",
    "no_reinit": "neither relocalized nor a new map",
    "few_inliers": "too few inliers",
}
_DECLARES = {
    "losses": "declares losses in its own words, and not what becomes of them",
    "nothing": "declares nothing: frames without a pose and the audit are what counts",
}
_REPAIRS = {"recovery": "fusions", "place": "joins", "relocalization": "relocalizations"}


def print_runs(summaries: Mapping[str, dict]) -> None:
    """Print what happened in one run, or in several over one sequence side by side."""
    if len(summaries) == 1:
        out.print(summary_table(*summaries.values()))
    else:
        out.print(systems_table(summaries))
        out.print(
            "Tracked: frames with a live pose. Complete: frames with a final pose in the largest map; ATE: "
            "their RMSE after Sim(3) alignment. Recovered: the maps were fused. A breakage shortly after a "
            "segment counts for the segment."
        )
    if any(summary["breakage_list"] or silent_losses(summary) for summary in summaries.values()):
        out.print(breakage_table(summaries))
    for name, summary in summaries.items():
        if summary["ended"] != "finished" and len(summaries) > 1:
            out.print(f"{name}: {_ending_text(summary)}")
        if summary["declares"] != "events":
            live = "; final poses stand in for live ones" if summary["live_poses"] == "final" else ""
            out.print(f"{name}: {_DECLARES[summary['declares']]}{live}")
        out.print(f"{name}: {audit_text(summary)}")


def summary_table(summary: dict) -> Table:
    """The main figures of a run."""
    first = summary["first_tracked_frame"]
    given = summary["frames"] + summary["dropped_frames"] + summary["unreadable_frames"]
    begun = f"{first}, after {number(summary['time_to_initialise_s'], 2, ' s')}"
    rows = {} if summary["ended"] == "finished" else {"ended": _ending_text(summary)}
    rows |= {"frames dropped, too late": summary["dropped_frames"]} if summary["dropped_frames"] else {}
    rows |= {"frames left out, unreadable": unread} if (unread := summary["unreadable_frames"]) else {}
    rows |= {
        "frames tracked": f"{summary['tracked']} of {given} ({share(summary['share_tracked'])})",
        "frames with a pose in the end": f"{summary['posed']} of {given} ({share(summary['share_posed'])})",
        "of all frames in the largest map": share(summary["completeness"]),
        "first tracked frame": _never_initialized(summary) if first is None else begun,
        "maps / keyframes / points": f"{summary['maps']} / {summary['keyframes']} / {summary['map_points']}",
        "breakages / recovered / relocalized": f"{summary['breakages']} / {summary['recoveries']} / "
        f"{summary['relocalizations']}",
        "ATE (RMSE, Sim(3))": _ate(summary),
        "path covered": f"{number(summary['path_m'], 2, ' m')} ({share(summary['path_share'])})",
        **{
            f"{stage} CPU, median / p95": f"{number(summary[f'{prefix}cpu_ms_median'], 1)} / "
            f"{number(summary[f'{prefix}cpu_ms_p95'], 1)} ms per {each}"
            for stage, prefix, each in (("tracking", "", "frame"), ("mapping", "mapping_", "keyframe"))
        },
        "peak memory": number(summary["peak_rss_mb"], 0, " MiB"),
    }
    title = f"{summary['sequence']}, {summary['system']}, seed {summary['seed']}"
    table = table_of(({"": name, "is": value} for name, value in rows.items()), title)
    table.show_header, table.columns[1].justify = False, "left"
    return table


INTERVALS = "95 % intervals below"
"""What the second lines of :func:`dose_row` are."""

_TRY = {
    "too_few_keypoints": "images show too few corners: try larger, brighter or sharper ones",
    "too_few_matches": "successive images have little in common: try a higher frame rate, or less blur",
    "low_parallax": "the camera hardly moves, or only turns: begin where it moves sideways",
    "no_model": "no motion explains the matches: check the calibration, and that frames are in order",
    "few_points": "few matches fit one motion: check the calibration",
    "few_points_after_adjustment": "few matches fit one motion: check the calibration",
}


def _never_initialized(summary: dict) -> str:
    reason = summary["reason_not_initialized"]
    if not reason:
        return "none: never initialized"
    word, _, where = reason.partition(" ")
    advice = f"; {_TRY[word]}" if word in _TRY else ""
    return f"none: never initialized, {_words(word)} {where}{advice}"


def systems_table(summaries: Mapping[str, dict]) -> Table:
    """The main figures of several systems over one sequence: a row each, and one per injected segment."""
    rows: list[dict[str, str]] = []
    for name, summary in summaries.items():
        rows += [{"": name, **_cells(summary, summary["completeness"])}]
        for segment in summary["segments"]:
            part = f" {describe_kind(segment['kind'])} {_span(segment)}"
            rows += [{"": part, **_cells(segment, _share_of(segment, "ate_poses"))}]
        rows += [{}]
    first = next(iter(summaries.values()))
    return table_of(rows, f"{first['sequence']}, seed {first['seed']}")


def breakage_table(summaries: Mapping[str, dict]) -> Table:
    """A row per breakage, and per loss that was never declared: when, why, and what became of it."""
    judged = any(summary["audit"] for summary in summaries.values())
    columns = ["declared", *(["truly lost"] if judged else []), "during", "cause", "what became of it"]
    shown: list[dict[str, str]] = []
    for name, summary in summaries.items():
        rows = [_breakage_row(breakage, summary) for breakage in summary["breakage_list"]]
        rows += [_silent_row(loss, summary) for loss in silent_losses(summary)]
        if len(summaries) > 1:
            shown += [dict.fromkeys(columns, "") | {"declared": name}]
        for _, declared, lost, *rest in sorted(rows):
            words = declared, *([lost] if judged else []), *rest
            shown += [dict(zip(columns, words, strict=True))]
        shown += [{}]
    return table_of(shown, "Breakages")


def dose_row(point: dict[str, Any]) -> dict[str, Any]:
    """Figures of a system at a dose, a point of a dose–response, with their intervals."""

    def cell(name: str, unit: str = "") -> str | None:
        mean, low, high = (point[name][part] for part in ("mean", "low", "high"))
        if mean is None:
            return None
        mean, low, high = (_short(value, unit) for value in (mean, low, high))
        return f"{mean}{unit}" + (f"\n{low} - {high}" if low else "")

    return {
        "": point["system"],
        "dose": f"{point['dose']:g}",
        "runs": point["runs"],
        "break": cell("broke", " %"),
        "no intact\nmap": cell("failed", " %"),
        "complete": cell("completeness", " %"),
        "ATE m": cell("ate_m"),
    }


def _short(value: float | None, unit: str) -> str:
    if value is None:
        return ""
    return f"{100 * value:.0f}" if unit else f"{value:.3g}"


def _ending_text(summary: dict) -> str:
    return f"{summary['ended'].replace('_', ' ')}: {summary['ended_message']}"


def _breakage_row(breakage: dict, summary: dict) -> tuple:
    finding = _finding(breakage, summary)
    if finding is None:
        lost = "-"
    elif finding["true_loss_frame"] is not None:
        lost = _moment(finding["true_loss_time_s"], finding["true_loss_frame"])
    else:
        lost = "not judged" if finding["reason"] else "pose right\nuntil then"
    reason = _words(breakage["reason"])
    cause = f"{reason}: {breakage['inliers']}" if breakage["inliers"] else reason
    declared = _moment(breakage["time_s"], breakage["frame"])
    during = _segment(breakage["segment_index"], summary)
    return breakage["frame"], declared, lost, during, cause, _fate(breakage, summary)


def _silent_row(loss: dict, summary: dict) -> tuple:
    lost = _moment(loss["true_loss_time_s"], loss["true_loss_frame"])
    during = _segment(loss["segment"], summary)
    return loss["true_loss_frame"], "never", lost, during, "wrong poses, given as right ones", "silent loss"


def _fate(breakage: dict, summary: dict) -> str:
    """What became of a broken map."""
    if summary["declares"] == "losses":
        return "not said"
    if breakage["repair"] is None:
        again = breakage["reinit_frame"]
        begun = f"; new map from frame {again} on" if again is not None else ""
        reason = "; ".join(map(_words, breakage["failure_reason"].split("; ")))
        left_behind = reason.startswith(("map dropped", "a recovery went past"))
        return f"{'' if left_behind else 'never repaired: '}{reason}{begun}"
    at = number(breakage["repair_time_s"], 2, " s")
    if breakage["repair"] == "place":
        return f"merged with the new map by place, at {at}{_verdict(breakage, summary)}"
    if breakage["repair"] == "relocalization":
        return (
            f"relocalized at {at}, {number(breakage['lost_s'], 2, ' s')} later{_verdict(breakage, summary)}"
        )
    thread = f" by thread {breakage['thread']} ({breakage['method']})" if breakage["thread"] else ""
    return f"recovered{thread}, fused at {at}{_verdict(breakage, summary)}"


def _verdict(breakage: dict, summary: dict) -> str:
    """The audit's verdict on a repair; empty without truth."""
    if summary["audit"] is None:
        return ""
    rows = summary["audit"][_REPAIRS[breakage["repair"]]]
    of = next((r for r in rows if r["frame"] == breakage["repair_frame"]), None)
    if of is None:
        return ""
    if not of["false"]:
        return "; right by the truth" if of["false"] is False else "; could not be judged"
    figures = []
    if of.get("scale_error") is not None:
        figures.append(f"scale {100 * of['scale_error']:+.0f} %")
    if of["position_error_m"] is not None:
        figures.append(
            f"{number(of['position_error_m'], 2, ' m')} and {number(of['rotation_error_deg'], 1, '°')} off"
        )
    return f"; FALSE by the truth: {', '.join(figures)}"


def _finding(breakage: dict, summary: dict) -> dict | None:
    """The audit's finding of a breakage, that of its own segment first; None without truth."""
    losses = summary["audit"]["losses"] if summary["audit"] else []
    own = [f for f in losses if f["declared_frame"] == breakage["frame"]]
    return next((f for f in own if f["segment"] == breakage["segment_index"]), next(iter(own), None))


def _segment(index: int | None, summary: dict) -> str:
    if index is None:
        return "no segment"
    segment = summary["segments"][index]
    return f"{describe_kind(segment['kind'])}\n{_span(segment)}"


def _span(segment: dict) -> str:
    return f"{segment['start_s']:g}-{segment['end_s']:g} s"


def _moment(time_s: float, frame: int) -> str:
    return f"{number(time_s, 2, ' s')}\nframe {frame}"


def _words(reason: str) -> str:
    return _REASONS.get(reason) or reason.replace("_", " ")


def _share_of(part: dict, frames: str) -> float | None:
    return part[frames] / part["frames"] if part["frames"] else None


def _cells(part: dict, completeness: float | None) -> dict[str, str]:
    return {
        "tracked": share(part.get("share_tracked", _share_of(part, "tracked"))),
        "com-\nplete": share(completeness),
        "break-\nages": str(part["breakages"]),
        "recov-\nered": str(part["recoveries"]),
        "relocal-\nized": str(part["relocalizations"]),
        "ATE": number(part["ate_m"], 3, " m"),
    }


def _ate(summary: dict) -> str:
    if summary["ate_m"] is None:
        return f"- ({summary['ate_reason']})"
    return (
        f"{summary['ate_m']:.4f} m, {share(summary['ate_share_of_path'])} of the path, "
        f"over {summary['ate_poses']} frames"
    )
