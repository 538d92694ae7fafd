"""Figures of variants: shares and medians with intervals, and paired differences with tests.

Worlds are the sample. World number w is one draw in all conditions: what is pooled is its mean over
conditions, and tests exchange the names of two variants in whole worlds.
"""

from collections.abc import Iterator
from itertools import product
from math import isfinite
from typing import Any

import numpy as np
import pandas as pd

from dslab.experiments.claims.variants.quantities import QUANTITIES
from dslab.experiments.claims.variants.spec import VariantsSpec
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.systems import exchange_test
from dslab.experiments.statistics.verdicts import LEVEL, holm
from dslab.experiments.statistics.world_intervals import (
    Interval,
    difference_interval,
    median_interval,
    share_interval,
)

Data = dict[str, Any]
POOLED = ""
"""Condition of what is pooled over all of them."""
MIDDLE = (0.6, 0.95)
"""Shares of the path between a run that got lost and one that did not."""


def figures(spec: VariantsSpec, table: pd.DataFrame) -> Data:
    """The figures of a table of rows; only those of worlds in which the stress acted, where there is one.

    Returns:
        ``estimates``: per variant, condition and quantity: of shares the mean,
        of amounts the median, with interval and worlds. ``contrasts``: per
        variant with its reference, measure and condition, and pooled (condition ``""``): the mean difference
        of the same world, its interval, ``p`` by Holm over all contrasts of the measure (pooled ones, and
        those in single conditions, each for themselves), ``better`` where it is told from 0, the worlds that
        have both, and those that have one. ``untold``: variants that were tested and differ from their
        reference in no measure. ``middle``: for
        a histogram. ``values``: of each world, for a histogram and for dots.
    """
    used = table[table.exposed.isna() | table.exposed.eq(True)]
    by_world = _by_world(spec, used)
    contrasts = _contrasts(spec, by_world)
    tested = [row for row in contrasts if row["p"] is not None]
    told = {row["variant"] for row in tested if row["p"] <= LEVEL}
    found: Data = {
        "name": spec.name,
        "claim": spec.claim,
        "worlds": int(table.world.nunique()),
        "rows": len(table),
        "unexposed": int(len(table) - len(used)),
        "plot": spec.plot,
        "measures": list(spec.measures),
        "conditions": list(spec.cells),
        "estimates": list(_estimates(spec, by_world)),
        "contrasts": contrasts,
        "untold": list(dict.fromkeys(row["variant"] for row in tested if row["variant"] not in told)),
    }
    if spec.plot in ("histogram", "dots"):
        found["values"] = list(_values(spec, used))
    if spec.plot == "histogram":
        found["middle"] = [_middle(used[used.variant == v.name], v.name) for v in spec.variants]
    return found | {"answer": _answer(spec, found)}


def _by_world(spec: VariantsSpec, table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Of every quantity the (W, variants x conditions) mean of each world, NaN where it has none."""
    at = pd.MultiIndex.from_product([[v.name for v in spec.variants], list(spec.cells)])
    keys = [table.world, table.variant, table.condition]
    return {
        name: quantity.of(table).groupby(keys).mean().unstack([1, 2]).reindex(columns=at)
        for name, quantity in QUANTITIES.items()
    }


def _estimates(spec: VariantsSpec, by_world: dict[str, pd.DataFrame]) -> Iterator[Data]:
    for variant in spec.variants:
        for condition in spec.cells:
            for name, quantity in QUANTITIES.items():
                known = by_world[name][variant.name, condition].dropna().to_numpy(float)
                if len(known):
                    found = (share_interval if quantity.is_share else median_interval)(known)
                    about = {"variant": variant.name, "system": variant.system, "at": variant.at}
                    yield about | {"condition": condition, "measure": name, **_data(found, len(known))}


def _data(found: Interval | float, worlds: int) -> Data:
    if isinstance(found, float):
        return {"value": found, "low": None, "high": None, "worlds": worlds}
    low, high = (end if isfinite(end) else None for end in (found.low, found.high))
    return {"value": found.value, "low": low, "high": high, "worlds": worlds}


def _contrasts(spec: VariantsSpec, by_world: dict[str, pd.DataFrame]) -> list[Data]:
    rng = np.random.default_rng(spec.seed("exchanges"))
    rows: list[Data] = []
    for measure in spec.measures:
        for chosen in ([POOLED], list(spec.cells)):
            family = []
            for pair, condition in product(spec.contrasts, chosen):
                own = [by_world[measure][name] for name in pair]
                sides = own if condition == POOLED else [side[[condition]] for side in own]
                about = {"variant": pair[0], "against": pair[1], "measure": measure}
                family.append(about | {"condition": condition, **_contrast(*sides, rng)})
            tested = [row for row in family if row["p"] is not None]
            for row, p in zip(tested, holm([row["p"] for row in tested]), strict=True):
                row["p"] = float(p)
                row["better"] = (
                    (row["value"] > 0) == QUANTITIES[measure].more_is_better if p <= LEVEL else None
                )
            rows += family
    return rows


def _contrast(variant: pd.DataFrame, reference: pd.DataFrame, rng: np.random.Generator) -> Data:
    """The paired difference of two variants, (W, conditions) each, before Holm's correction."""
    difference = variant - reference
    counts = {"left_out": variant.isna() != reference.isna(), "more": difference > 0, "less": difference < 0}
    found: Data = {name: int(of.to_numpy().sum()) for name, of in counts.items()}
    by_world = difference.mean(axis=1).dropna().to_numpy(float)
    if not len(by_world):
        return found | {"value": None, "low": None, "high": None, "worlds": 0, "p": None}
    figure = Figure.mean(by_world)
    spread = difference_interval(figure) if len(by_world) > 1 and figure.error else figure.value
    p = exchange_test(by_world, rng) if len(by_world) > 1 else None
    return found | _data(spread, len(by_world)) | {"p": p}


def _values(spec: VariantsSpec, table: pd.DataFrame) -> Iterator[Data]:
    """The values of all worlds, rounded to what a picture shows."""
    for variant in spec.variants:
        for condition in spec.cells:
            own = table[(table.variant == variant.name) & (table.condition == condition)]
            for measure in (*spec.measures, *(("onset_share",) if spec.plot == "histogram" else ())):
                known = QUANTITIES[measure].of(own) if measure in QUANTITIES else own[measure].astype(float)
                values = [float(f"{value:.4g}") for value in known.dropna()]
                never = len(own) - len(values)
                about = {"variant": variant.name, "condition": condition, "measure": measure}
                yield about | {"values": values, "never": never}


def _middle(table: pd.DataFrame, variant: str) -> Data:
    """Shares of a variant's runs that cover little, something between, and nearly all of the path.

    Beside them ``onset_between``: of the runs that broke, those whose stress began between, where a run that
    stays lost ends.
    """
    low, high = MIDDLE
    known = table[table.path_share.notna()]
    path, onset = known.path_share.astype(float), known.onset_share.astype(float)
    parts = {"below": path < low, "between": (path >= low) & (path <= high), "above": path > high}
    found: Data = {"variant": variant, "runs": len(known)}
    for name, event in parts.items():
        by_world = event.astype(float).groupby(known.world).mean().to_numpy(float)
        found[name] = _data(share_interval(by_world), len(by_world)) if len(by_world) else None
        found[f"{name}_runs"] = int(event.sum())
    broke = known.broke.eq(True)
    between = ((onset >= low) & (onset <= high)).astype(float)[broke]
    by_world = between.groupby(known.world[broke]).mean().to_numpy(float)
    found["onset_between"] = _data(share_interval(by_world), len(by_world)) if len(by_world) else None
    return found


def _answer(spec: VariantsSpec, found: Data) -> list[Any]:
    """The figures in a few sentences, with a table of what was told, or of what was measured."""
    if spec.plot == "histogram":
        return [_middle_sentence(part) for part in found["middle"] if part["between"]]
    parts: list[Any] = []
    tested = [row for row in found["contrasts"] if row["p"] is not None]
    for measure in spec.measures:
        own = [row for row in tested if row["measure"] == measure]
        sure = sum(row["p"] <= LEVEL for row in own)
        if own:
            parts.append(f"{QUANTITIES[measure].label}: {sure} of {len(own)} differences are told from 0")
    if told := [_difference_row(row) for row in tested if row["p"] <= LEVEL]:
        parts.append(told)
    if found["untold"]:
        parts.append(f"told from their reference by nothing: {', '.join(found['untold'])}")
    return parts if spec.plot == "forest" else [*parts, _estimate_rows(spec, found)]


def _difference_row(row: Data) -> dict[str, str]:
    """A difference as a row of a printed table."""
    ends = "" if row["low"] is None else f" [{row['low']:.2g}, {row['high']:.2g}]"
    found = {name: row[name] for name in ("variant", "against", "measure")}
    found |= {"condition": row["condition"] or "all", "difference": f"{row['value']:+.2g}{ends}"}
    return found | {"worlds": str(row["worlds"]), "p": f"{row['p']:.2g}"}


def _estimate_rows(spec: VariantsSpec, found: Data) -> list[dict[str, str]]:
    """A row per variant and condition with its measures; intervals are in the figures."""
    rows: dict[tuple[str, str], dict[str, str]] = {}
    for row in found["estimates"]:
        at = rows.setdefault((row["variant"], row["condition"]), dict.fromkeys(spec.measures, ""))
        if row["measure"] in at:
            at[row["measure"]] = f"{row['value']:.3g}"
    return [{"variant": name, "condition": condition, **of} for (name, condition), of in rows.items()]


def _middle_sentence(part: Data) -> str:
    between, (low, high) = part["between"], (f"{100 * end:g} %" for end in MIDDLE)
    words = "{:.1f} % [{:.1f}, {:.1f}]".format(*(100 * between[end] for end in ("value", "low", "high")))
    return (
        f"{part['variant']}: of {part['runs']} runs in {between['worlds']} worlds {part['below_runs']} cover "
        f"less than {low} of the path, {part['between_runs']} from there to {high} ({words}), "
        f"{part['above_runs']} more."
    )
