"""What the audit by the truth found in a run, in words: the same in terminal, pages and recordings."""

from collections.abc import Sequence
from statistics import median
from typing import Any

_DECLARED = {"loop": "loops", "fusion": "fusions", "join": "joins", "relocalization": "relocalizations"}
_NO_TRUTH = "no ground truth"


def audit_text(summary: dict[str, Any]) -> str:
    """What the audit found in a run, in one line.

    Args:
        summary: of :func:`experiments.evaluation.summary.summarise`, or as read from its file.
    """
    audit = summary["audit"]
    if audit is None:
        return f"audit by the truth: nothing looked for: {_NO_TRUTH}"
    # Overlapping segments have a finding each.
    declared = {f["declared_frame"]: f for f in audit["losses"] if f["declared_frame"] is not None}
    delays_s = [f["delay_s"] for f in declared.values() if f["delay_s"] is not None]
    losses = count(len(declared), "declared loss", "declared losses")
    if delays_s:
        losses += f", {median(delays_s):.2f} s after the pose was truly lost"
        losses += " (median)" if len(delays_s) > 1 else ""
    parts = [f"not to be trusted, as {audit['truth_fault']}"] if audit.get("truth_fault") else []
    parts += [losses, *silence_parts(summary)]
    parts += [_false(one, many, audit[many]) for one, many in _DECLARED.items() if audit[many]]
    unjudged = [f["reason"] for f in audit["losses"] if f["silent"] is None]
    unjudged += [row["reason"] for many in _DECLARED.values() for row in audit[many] if row["false"] is None]
    parts += [f"{len(unjudged)} not judged ({', '.join(dict.fromkeys(unjudged))})"] if unjudged else []
    return f"audit by the truth: {'; '.join(parts)}"


def runs_text(summaries: Sequence[dict[str, Any]]) -> str:
    """What the audit found in several runs of a system: the line of one run, or of how many what is said."""
    if len(summaries) == 1:
        return audit_text(summaries[0])
    said = [(bool(silent_losses(s)), bool(corrupted_maps(s)), unlooked_for(s) is not None) for s in summaries]
    silent, corrupted, unlooked = (sum(column) for column in zip(*said, strict=True))
    parts = [f"silent losses in {silent or 'none'}", f"corrupted maps in {corrupted or 'none'}"]
    parts += [f"not looked for in {unlooked}"] if unlooked else []
    faults = [fault for s in summaries if s["audit"] and (fault := s["audit"].get("truth_fault"))]
    parts += [f"not to be trusted in {len(faults)}, as {faults[0]}"] if faults else []
    return f"audit by the truth, of {len(summaries)} runs: {', '.join(parts)}"


def silence_parts(summary: dict[str, Any]) -> list[str]:
    """Silent losses and corrupted maps, or that they were not looked for and why."""
    silent, why, maps = silent_losses(summary), unlooked_for(summary), summary["audit"]["maps"]
    corrupted = [_corrupted(found) for found in corrupted_maps(summary)]
    judged = any(found["corrupted"] is not None for found in maps)
    why_not_maps = "" if judged else maps[0]["reason"] if maps else "no map was left"
    if why and why_not_maps and not silent:
        return [f"silent losses and corrupted maps not looked for: {why}"]
    losses = count(len(silent), "silent loss", "silent losses")
    if silent:
        losses += f" (from {', '.join(_moment(f['true_loss_time_s']) for f in silent)} on)"
    elif why:
        losses = f"silent losses not looked for: {why}"
    else:
        live = summary["audit"]["live"]
        share = live["judged"] / live["poses"]
        if share < 0.995:  # what rounds to all is all
            losses += f", not looked for in {100 * (1 - share):.0f} % of the live poses ({live['reason']})"
    unlooked = f"corrupted maps not looked for: {why_not_maps}" if why_not_maps else "no corrupted maps"
    return [losses, *(corrupted or [unlooked])]


def silent_losses(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """The findings of losses that were never declared."""
    audit = summary["audit"]
    return [f for f in audit["losses"] if f["silent"]] if audit else []


def corrupted_maps(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """The findings of maps that are corrupted by the truth."""
    audit = summary["audit"]
    return [found for found in audit["maps"] if found["corrupted"]] if audit else []


def unlooked_for(summary: dict[str, Any]) -> str | None:
    """Why silent losses were looked for nowhere; None if they were somewhere."""
    audit = summary["audit"]
    if audit is None:
        return _NO_TRUTH
    return None if audit["live"]["judged"] else audit["live"]["reason"]


def count(number: int, one: str, many: str) -> str:
    """A number of things, in words."""
    return f"{number or 'no'} {one if number == 1 else many}"


def _corrupted(found: dict[str, Any]) -> str:
    bent = "" if found["time_s"] is None else f", bent at {_moment(found['time_s'])}"
    if found["error_m"] is None:
        return f"map {found['map_id']} corrupted{bent} (it follows the true path in no alignment)"
    off = f"{found['error_m']:.2f} m and {found['rotation_deg']:.1f}° off over {found['path_m']:.0f} m"
    return f"map {found['map_id']} corrupted{bent} ({off} as a whole)"


def _false(one: str, many: str, rows: list[dict[str, Any]]) -> str:
    """How many of the declared loops, fusions, joins or relocalizations are false, and when."""
    false = [_moment(row["time_s"]) for row in rows if row["false"]]
    found = f"{count(len(false), f'false {one}', f'false {many}')} of {len(rows)}"
    return f"{found} (at {', '.join(false)})" if false else found


def _moment(time_s: float) -> str:
    return f"{time_s:.2f} s"
