"""Tables of the page on the paper's claims, made from the published rows in ``claims``."""

import json
from collections.abc import Iterator
from dataclasses import asdict, astuple
from functools import cache
from math import exp
from pathlib import Path
from typing import Any

from figures import bullets, table, with_ends

from dslab.experiments.campaign.folder import read_experiment
from dslab.experiments.claims.variants.deviations import ALL, DEVIATIONS, NEVER, PUBLISHED, made
from dslab.experiments.report.describe import interval_of_share, percent
from dslab.experiments.statistics.direction import directions
from dslab.experiments.statistics.from_records import cells_of
from dslab.experiments.statistics.world_intervals import Interval
from dslab.scenarios.describe import describe_kind

HERE = Path(__file__).parent
ENDS = ("value", "low", "high")


def claim_conditioning() -> str:
    """Errors of two views over three baselines by scene, and how they go with the baseline."""
    found = _claim("conditioning")
    slopes = {(s["scene"], s["error"]): s["slope"] for s in found["slopes"] if s["over"] == "baseline_m"}
    rows = []
    for gap in found["by_gap"]:
        if gap["gap"] in (1, 4, 16):
            slope = slopes[gap["scene"], "direction_deg"] if gap["gap"] == 1 else None
            names = "direction_deg", "bound_direction_deg", "direction_deg_of_bound"
            told = [with_ends({end: gap[name][end] for end in ENDS}) for name in names]
            rotation, depth = f"{gap['rotation_deg']['value']:.2g}", percent(gap["depth"]["value"])
            power = with_ends(slope) if slope else ""
            rows.append((gap["scene"], f"{gap['baseline_m']:.2f}", *told, rotation, depth, power))
    header = (
        "scene",
        "baseline, m",
        "direction, deg",
        "bound",
        "over bound",
        "rotation, deg",
        "depth",
        "power",
    )
    return table(header, rows)


def claim_ransac() -> str:
    """Errors of direction by 50 and by 50,000 samples of RANSAC, over the narrowest and widest baselines."""
    found = _claim("ransac-iterations")
    at = {(row["scene"], row["gap"], row["samples"]): row for row in found["by_samples"]}
    rows = []
    for change in found["changes"]:
        few, many = (at[change["scene"], change["gap"], samples] for samples in (50, 50_000))
        if change["gap"] in (1, 16):
            told = [with_ends({end: row["direction_deg"][end] for end in ENDS}) for row in (few, many)]
            share = interval_of_share(many["telling_5"])
            rows.append(
                (change["scene"], f"{few['baseline_m']:.2f}", *told, with_ends(change["ratio"]), share)
            )
    return table(
        ("scene", "baseline, m", "50 samples, deg", "50,000 samples, deg", "ratio in a world", "looks right"),
        rows,
    )


def claim_onset() -> str:
    """What was wrong when tracking was lost, by system and stress."""
    rows = []
    for system, found in _claim("onset")["systems"].items():
        for stress, of in found["stress"].items():
            words = {"sham": "none", "all": "all stress"}.get(
                stress, stress.replace("-", " ").replace("_", " ")
            )
            wrong = of["wrong"]
            told = (of["broke"], wrong["before_declared"]["0.1"], wrong["view_fails"], of["silent"])
            shares = ["" if share is None else interval_of_share(share) for share in told]
            rows.append((system, words, of["units"] - of["void"] - of["not_exposed"], *shares))
    header = (
        "system",
        "stress",
        "units",
        "breaks",
        "map wrong > 0.1 s before",
        "map right to the end",
        "silent",
    )
    return table(header, rows)


def claim_direction() -> str:
    """Forward tracking beside the threads of Algorithm 1 backward, by both readings of what fails."""
    _, records = read_experiment(HERE / "claims" / "direction")
    found = directions(cells_of(records, 4), (1, 3))
    rows = []
    for orb, sift in zip(found[: len(found) // 2], found[len(found) // 2 :], strict=True):
        for reading, words in (("declared", "declared"), ("with_silent", "with silent")):
            one, other = getattr(orb, reading), getattr(sift, reading)
            apart = [
                f"**{_points(of.difference)}**" if of.p <= 0.05 else _points(of.difference)
                for of in (one, other)
            ]
            condition = f"{describe_kind(orb.kind)}, {orb.world}, {orb.worlds}" if words == "declared" else ""
            rows.append((condition, words, interval_of_share(asdict(one.forward)), *apart))
    header = ("stress, kind and number of worlds", "failures", "p₀", "p₀ - pr, ORB", "p₀ - pr, SIFT")
    return table(header, rows)


def claim_buffer() -> str:
    """Seconds of buffer, and what they bring and cost."""
    at: dict[tuple[str, str], dict[str, str]] = {}
    for row in _claim("buffer")["estimates"]:
        share = row["measure"] in ("rescued", "failed", "wrong")
        cell = (interval_of_share if share else with_ends)({end: row[end] for end in ENDS})
        at.setdefault((row["condition"], row["variant"]), {})[row["measure"]] = cell
    names = "rescued", "wrong", "to_repair_s", "recovery_cpu_s", "buffer_mb"
    rows = []
    for (condition, variant), of in at.items():
        system, _, seconds = variant.partition("-")
        stress = describe_kind(condition.split("/")[1])
        rows.append((system, stress, int(seconds), *(of.get(name, "") for name in names)))
    header = "system", "stress", "buffer, s", "rescued", "wrong", "to a rescue, s", "CPU, s", "MB"
    return table(header, sorted(rows))


def claim_dichotomy() -> str:
    """Runs by the share of their path that the largest map covers."""
    names = "below", "between", "above"
    rows = [
        (part["variant"], part["runs"], *(interval_of_share(part[name]) for name in names))
        for part in _claim("dichotomy")["middle"]
        if part["between"]
    ]
    return table(("system", "runs", "under 60 %", "60 to 95 %", "more"), rows)


def _points(difference: Interval) -> str:
    value, low, high = (f"{round(100 * end) + 0:d}" for end in astuple(difference))
    return f"{value} [{low}, {high}]"


@cache
def _claim(name: str) -> dict[str, Any]:
    return json.loads((HERE / "claims" / name / "figures.json").read_text())


MEASURES = {
    "broke": "breaks, points",
    "failed": "fails, points",
    "path_share": "path, points",
    "log_ate": "ATE, ratio",
    "to_repair_s": "to a rescue, s",
}
WORDS = {
    "broke": "breaks {} points",
    "failed": "fails {} points",
    "wrong": "wrong {} points",
    "path_share": "path {} points",
    "log_ate": "ATE {} times",
    "to_repair_s": "to a rescue {} s",
    "cpu_ms": "CPU {} ms a frame",
}
CPU_SPREAD_MS = 1.0
"""Told differences of CPU time that are less are left out: equal runs differ by half of it."""


def claim_ablation() -> str:
    """Differences that deviations make, undone off ours: those told from 0 over all conditions or in one."""
    found = {
        (row["variant"], row["measure"], row["condition"]): row for row in _claim("ablation")["contrasts"]
    }
    told = {variant for (variant, measure, _), row in found.items() if measure in MEASURES and _is_told(row)}
    rows = []
    for name in (f"without-{deviation.name}" for deviation in DEVIATIONS):
        if name in told:
            cells = [_difference(found[name, measure, ""], measure) for measure in MEASURES]
            rows.append((f"`{name.removeprefix('without-')}`", *cells, "; ".join(_in_one_condition(name))))
    return table(("without", *MEASURES.values(), "in one condition"), rows)


def deviations() -> str:
    """Every deviation that settings undo: these settings, what was told from 0, and which gained nothing."""
    lines = []
    for deviation in DEVIATIONS:
        heading = "" if deviation.heading == PUBLISHED else f"**{deviation.heading}**, "
        settings = [f"`{name}{_written(value, ': ')}`" for name, value in made(deviation).items()]
        undone = [f"`{_written(value)}`" for value in deviation.undone.values()]
        told = f"{heading}`{deviation.name}`: {', '.join(settings)}; undone by {', '.join(undone)}."
        lines.append(f"{told} {_worth(deviation.name)}")
    return "\n".join(bullets(lines))


def _written(value: Any, before: str = "") -> str:
    if value == {}:  # on, with settings of its own
        return ""
    return before + ("infinite" if value in (NEVER, ALL) else json.dumps(value))


def _worth(name: str) -> str:
    """What was told from 0 without a deviation, and with it alone on the published profile."""
    without = list(_told("ablation", f"without-{name}"))
    alone = list(_told("ablation-paper", f"with-{name}"))
    measured = {
        row["variant"] for claim in ("ablation", "ablation-paper") for row in _claim(claim)["contrasts"]
    }
    if not measured & {f"without-{name}", f"with-{name}"}:
        return "Not measured."
    gains = any(row["better"] is False for row in without) or any(row["better"] for row in alone)
    sides = (("Without it", without), ("Alone", alone))
    parts = [f"{words} {'; '.join(map(_told_words, rows))}." for words, rows in sides if rows]
    return " ".join([*parts, *([] if gains else ["**No gain.**"])])


def _told(claim: str, variant: str) -> list[dict[str, Any]]:
    """What is told from 0 of a variant over all conditions, and in one where it is not over all."""
    rows = [row for row in _claim(claim)["contrasts"] if row["variant"] == variant and _is_told(row)]
    rows = [row for row in rows if row["measure"] != "cpu_ms" or abs(row["value"]) > CPU_SPREAD_MS]
    pooled = {row["measure"] for row in rows if not row["condition"]}
    return [row for row in rows if not row["condition"] or row["measure"] not in pooled]


def _told_words(row: dict[str, Any]) -> str:
    told = WORDS[row["measure"]].format(_difference(row, row["measure"]).strip("*"))
    return f"{told} ({row['condition'].split('/')[1].replace('_', ' ')})" if row["condition"] else told


def _in_one_condition(variant: str) -> Iterator[str]:
    """What is told from 0 in a condition, and not over all."""
    for row in _told("ablation", variant):
        if row["condition"] and row["measure"] in MEASURES:
            stress = row["condition"].split("/")[1].replace("_", " ")
            yield f"{MEASURES[row['measure']].split(',')[0]} {_difference(row, row['measure'])}, {stress}"


def _is_told(row: dict[str, Any]) -> bool:
    return row.get("better") is not None


def _difference(row: dict[str, Any], measure: str) -> str:
    """A difference of a measure with its interval, bold where it is told from 0; empty where none."""
    if row["value"] is None or row["low"] is None:
        return ""
    points = 1 if measure in ("to_repair_s", "cpu_ms") else 100
    value, low, high = (exp(row[end]) if measure == "log_ate" else points * row[end] for end in ENDS)
    words = f"{value:.2g} [{low:.2g}, {high:.2g}]"
    return f"**{words}**" if _is_told(row) else words


def claim_init() -> str:
    """Frames to a map at the start and after a breakage, by windows and by GMS."""
    found = {(e["variant"], e["condition"], e["measure"]): e for e in _claim("init")["estimates"]}
    rows = []
    for condition in dict.fromkeys(condition for _, condition, _ in found):
        for measure, words in (("first_map_frames", "start"), ("next_map_frames", "after a breakage")):
            told = (found[name, condition, measure] for name in ("paper", "paper+", "dual", "dual+"))
            cells = (f"{e['value']:g} [{e['low']:g}, {e['high']:g}]" for e in told)
            rows.append((f"{condition.split('/')[0]}, {words}", *cells))
    header = ("frames to a map", "`paper`: windows", "`paper+`: GMS", "`dual`: windows", "`dual+`: both")
    return table(header, rows)
