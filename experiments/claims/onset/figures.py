"""Figures of an onset experiment: is a map wrong before it is lost, how long, and how often in silence?"""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from dslab.experiments.claims.onset.judged import LEVELS, RARE, WRONG, JudgedUnits
from dslab.experiments.claims.onset.unit import BROKE, HELD, UNIT, VOID, OnsetSpec
from dslab.experiments.eq1.records import SHAM
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.world_intervals import difference_interval, share_interval

if TYPE_CHECKING:
    import pandas as pd

_FEW = 10
"""Worlds with a breakage, with fewer of which nothing is said, as in the tests of Eq. 1."""
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def figures(spec: OnsetSpec, table: "pd.DataFrame") -> dict[str, Any]:
    """All figures; worlds are the sample, those of two bases are different ones.

    Per system, and there over all stress, per kind of stress and per condition: the counts of units, the
    share that breaks, and of the breakages: ``late`` ones, whose true loss is longer before the declared one
    than each of ``before_s``; per level, of ``LEVELS``, those whose map was so for longer than that before
    the declared and before the true loss; ``view_fails``, those whose map was right to the end;
    ``narrow_rare``, those before which the live pose's error relative to the last keyframe is above the 95 %
    quantile of the lead-in. ``silent`` is the share of units that did not break, of those whose map is wrong
    at the end or whose pose is truly lost. ``placebo``: the same rules on maps without stress, at random
    times and at the times of the breakages; ``excess`` is the paired difference to the latter.
    """
    judged = JudgedUnits(spec, table)
    units = judged.table()
    every = table[table.row_kind == UNIT]
    found: dict[str, Any] = {"systems": {}, "telling": {}, "answer": []}
    for system in spec.systems:
        own, of_all = units[units.system == system], every[every.system == system]
        if own.empty:
            continue
        stressed = own[own.stress != SHAM]
        groups = {"all": _group(spec, stressed, of_all[of_all.stress != SHAM])}
        groups |= {
            stress: _group(spec, own[own.stress == stress], of_all[of_all.stress == stress])
            for stress in own.stress.unique()
        }
        conditions = {
            name: _group(spec, own[own.condition == name], of_all[of_all.condition == name])
            for name in own.condition.unique()
        }
        placebo = {level: _placebo(spec, judged, system, level, stressed) for level in LEVELS}
        verdict = _verdict(groups["all"], spec)
        found["systems"][system] = {
            "stress": groups,
            "conditions": conditions,
            "placebo": placebo,
            "delays": _delays(stressed),
            "verdict": verdict,
        }
        found["telling"][system] = _telling(spec, own)
        found["answer"] += _answer(system, found["systems"][system])
    found["answer"].append([row for s, of in found["telling"].items() for row in _told(s, of)])
    return found


def _group(spec: OnsetSpec, units: "pd.DataFrame", of_all: "pd.DataFrame") -> dict[str, Any]:
    broken, held = units[units.outcome == BROKE], units[units.outcome == HELD]
    late_s = _column(broken, "late_s")
    told: dict[str, Any] = {
        "units": len(of_all),
        "void": int((of_all.outcome == VOID).sum()),
        "not_exposed": int(((of_all.outcome != VOID) & (of_all.exposed == 0)).sum()),
        "broke": _share(units, units.outcome == BROKE),
        "silent": _share(held, _column(held, "silent_s") > 0),
        "late": {f"{t:g}": _share(broken, late_s > t) for t in spec.before_s},
        "narrow_rare": _share(broken, _column(broken, "narrow_rank") >= RARE),
        "narrow_ratio": _quantiles(_column(broken, "narrow_ratio")),
    }
    for level in LEVELS:
        since_s, true_s = _column(broken, f"{level}_s"), _column(broken, f"{level}_true_s")
        known = broken[np.isfinite(since_s)]
        lost = broken[np.isfinite(true_s)]
        told[level] = {
            "before_declared": {
                f"{t:g}": _share(known, _column(known, f"{level}_s") > t) for t in spec.before_s
            },
            "before_true": {
                f"{t:g}": _share(lost, _column(lost, f"{level}_true_s") > t) for t in spec.before_s
            },
            "view_fails": _share(known, _column(known, f"{level}_s") == 0),
            "held_at_end": _share(held, _column(held, f"{level}_s") > 0),
            "held_ever": _share(held, held.get(f"{level}_ever", False)),
            "seconds": _quantiles(since_s[since_s > 0]),
            "causes": _causes(broken, level),
        }
    rank = _column(broken, "onset_narrow_rank")
    told["narrow_before_onset"] = _share(broken[np.isfinite(rank)], rank[np.isfinite(rank)] >= RARE)
    return told


def _placebo(
    spec: OnsetSpec, judged: JudgedUnits, system: str, level: str, stressed: "pd.DataFrame"
) -> dict[str, Any]:
    """The rule's false alarms, and what breakages have beyond them, paired by world."""
    import pandas as pd

    drawn = [(place, s) for place, delays in judged.placebo(system, level).items() for s in delays]
    random = pd.DataFrame(drawn, columns=["place", "s"])
    broken = stressed[stressed.outcome == BROKE]
    since_s, beside_s = _column(broken, f"{level}_s"), _column(broken, f"{level}_placebo_s")
    pairs = broken[np.isfinite(since_s) & np.isfinite(beside_s)]
    excess = {}
    for t in spec.before_s:
        more = (_column(pairs, f"{level}_s") > t).astype(float) - (_column(pairs, f"{level}_placebo_s") > t)
        by_world = _by_world(pairs, more)
        of = difference_interval(Figure.mean(by_world)) if len(by_world) > 1 else None
        excess[f"{t:g}"] = of and vars(of) | {"worlds": len(by_world)}
    return {
        "random": {f"{t:g}": _share(random, random.s.to_numpy() > t) for t in (0.0, *spec.before_s)},
        "at_breakages": {
            f"{t:g}": _share(pairs, _column(pairs, f"{level}_placebo_s") > t) for t in spec.before_s
        },
        "excess": excess,
        "narrow_rare": _share(pairs, _column(pairs, "narrow_placebo_rank") >= RARE),
        "seconds": sorted(np.round(random.s.to_numpy(), 3).tolist()),
    }


def _delays(stressed: "pd.DataFrame") -> dict[str, list[float]]:
    """Seconds for which maps were wrong when their loss was declared, by kind of stress, sorted."""
    broken = stressed[stressed.outcome == BROKE]
    return {
        str(stress): sorted(np.round(_column(own, f"{WRONG}_s"), 3).tolist())
        for stress, own in broken.groupby("stress", sort=False)
    }


def _telling(spec: OnsetSpec, units: "pd.DataFrame") -> dict[str, dict[str, Any] | None]:
    """The units most worth seeing, the first of equal ones.

    ``longest``: the breakage before which the map was wrong for longest; ``typical``: the one for which that
    time is nearest to the median of all breakages; ``silent``: of the maps that did not break, the one that
    was wrong, or whose pose was truly lost, for longest at the end.
    """
    broken, held = units[units.outcome == BROKE], units[units.outcome == HELD]
    since_s = _column(broken, f"{WRONG}_s")
    silent_s = _column(held, "silent_s")
    far_s = np.abs(since_s - np.median(since_s)) if len(since_s) else since_s
    return {
        "longest": _unit(broken.iloc[int(since_s.argmax())]) if (since_s > 0).any() else None,
        "typical": _unit(broken.iloc[int(far_s.argmin())]) if len(broken) else None,
        "silent": _unit(held.iloc[int(silent_s.argmax())]) if (silent_s > 0).any() else None,
    }


def _unit(row: Any) -> dict[str, Any]:
    names = ("unit", "condition", "world", "system", "seed", "world_seed", "sequence_seed", "declared_reason")
    told: dict[str, Any] = {name: row[name] for name in names}
    wrong_s = row[f"{WRONG}_s"] if row["outcome"] == BROKE else row["silent_s"]
    return told | {"wrong_s": wrong_s, "cause": row[f"{WRONG}_cause"]}


def _verdict(every: dict[str, Any], spec: OnsetSpec) -> str:
    """What is said of the paper's picture, by the share of breakages whose map was wrong before."""
    share = every[WRONG]["before_declared"][f"{spec.before_s[0]:g}"]
    if share is None or share["worlds"] < _FEW:
        return "untested: too few worlds with a breakage"
    if share["low"] > 0.5:
        return "holds: most maps are wrong before they are lost"
    if share["high"] < 0.5:
        return "does not hold: most maps are right when they are lost, the view fails"
    return "not decided"


def _answer(system: str, found: dict[str, Any]) -> list[Any]:
    """What is printed of a system: the verdict, and a row per kind of stress."""
    every, placebo = found["stress"]["all"], found["placebo"][WRONG]
    least = next(iter(every[WRONG]["before_declared"]))
    wrong = f"wrong > {least} s"
    rows = [
        {
            "stress": name,
            "units": of["units"],
            "break": _words(of["broke"]),
            wrong: _words(of[WRONG]["before_declared"][least]),
            "view fails": _words(of[WRONG]["view_fails"]),
            "silent": _words(of["silent"]),
        }
        for name, of in found["stress"].items()
    ]
    for name, share in (("random times", placebo["random"]), ("same times", placebo["at_breakages"])):
        rows.append(dict.fromkeys(rows[0], "") | {"stress": f"placebo, {name}", wrong: _words(share[least])})
    narrow = (
        f"{_words(every['narrow_rare'])}, without stress at the same times {_words(placebo['narrow_rare'])}"
    )
    return [
        f"{system}: {found['verdict']}",
        f"just before the loss the live pose is off the last keyframe by more than is usual in {narrow}",
        rows,
    ]


def _told(system: str, telling: dict[str, Any]) -> Iterable[dict[str, Any]]:
    for name, unit in telling.items():
        if unit is not None:
            of = f"{unit['condition']}, world {unit['world']}, {system}"
            yield {"most telling": name, "unit": unit["unit"], "of": of, "wrong for, s": unit["wrong_s"]}


def _words(share: dict[str, Any] | None) -> str:
    if share is None:
        return ""
    return "{:.0f} % [{:.0f}, {:.0f}]".format(*(100 * share[end] for end in ("value", "low", "high")))


def _share(units: "pd.DataFrame", event: Any) -> dict[str, Any] | None:
    """A share of units with its interval by worlds, each world weighted alike; None without a unit."""
    if units.empty:
        return None
    by_world = _by_world(units, np.broadcast_to(np.asarray(event, float), len(units)))
    return vars(share_interval(by_world)) | {"worlds": len(by_world), "units": len(units)}


def _by_world(units: "pd.DataFrame", values: Any) -> np.ndarray:
    return np.asarray(units.assign(value=values).groupby("place")["value"].mean(), float)


def _column(units: "pd.DataFrame", name: str) -> np.ndarray:
    """A column as floats; NaN where it is not known, or if no unit has it."""
    import pandas as pd

    if name not in units:
        return np.full(len(units), np.nan)
    return np.asarray(pd.to_numeric(units[name], errors="coerce"), float)


def _quantiles(values: np.ndarray) -> dict[str, Any] | None:
    """Quantiles over units, to describe; worlds give no interval here."""
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    found = np.quantile(known, _QUANTILES)
    return {"units": len(known)} | {f"{q:g}": float(v) for q, v in zip(_QUANTILES, found, strict=True)}


def _causes(broken: "pd.DataFrame", level: str) -> dict[str, int]:
    named = broken.get(f"{level}_cause")
    return (
        {} if named is None else {str(k): int(n) for k, n in named[named.astype(bool)].value_counts().items()}
    )
