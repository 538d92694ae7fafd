"""Findings of a report as sentences."""

from typing import Any

from experiments.report.describe import figure_of, number, p_value, plural, proportion, share_of

VERDICTS = ("consistent", "optimistic", "pessimistic", "undecided")


def verdict(analysis: dict[str, Any]) -> dict[str, Any]:
    """Results of the withdrawn tests, which take units for independent.

    Args:
        analysis: the analysis as plain data.
    """
    levels = [_level(analysis, n) for n in range(1, analysis["threads"] + 1)]
    return {
        "tests_headline": _tests_headline(levels),
        "levels": [
            level | {"told": _overall(level), "sentences": _sentences(level, analysis)} for level in levels
        ],
        "dependence": _dependence(analysis),
        "meanings": _meanings(analysis["settings"]),
    }


def _meanings(settings: dict[str, Any]) -> dict[str, str]:
    ratio, power = number(settings["power_ratio"]), number(settings["power_wanted"])
    return {
        "consistent": f"the test does not reject Eq. 1 and would have detected a ratio of {ratio} with a "
        f"power of at least {power}; this does not confirm Eq. 1",
        "optimistic": "Eq. 1 is too optimistic: significantly more failures were measured than it predicts",
        "pessimistic": "Eq. 1 is too pessimistic: significantly fewer failures were measured than "
        "it predicts",
        "undecided": f"Eq. 1 is not rejected, but there are too few trials: the power to detect a ratio "
        f"of {ratio} is below {power}",
    }


def _level(analysis: dict[str, Any], n: int) -> dict[str, Any]:
    own = [(cell["cell"], level) for cell in analysis["cells"] for level in cell["levels"] if level["n"] == n]
    named = {v: [cell for cell, level in own if level["verdict"] == v] for v in VERDICTS}
    powers = [level["power_ratio_2"] for _, level in own if level["power_ratio_2"] is not None]
    settings = analysis["settings"]
    pooled = (e for e in analysis["heterogeneity"]["eckhardt_lee"] if e["n"] == n)
    return {
        "n": n,
        "cells": len(own),
        "counts": {v: len(named[v]) for v in VERDICTS},
        "named": named,
        "powered": sum(power >= settings["power_wanted"] for power in powers),
        "power_low": min(powers, default=None),
        "power_high": max(powers, default=None),
        "equivalent": sum(
            level["tost_p"] is not None and level["tost_p"] < settings["alpha"] for _, level in own
        ),
        "overall": next(pooled, None),
    }


def _tests_headline(levels: list[dict[str, Any]]) -> str:
    if not any(level["overall"] and level["overall"]["measured"]["units"] for level in levels):
        return "No result yet: no trial is completed."
    total = {v: sum(level["counts"][v] for level in levels) for v in VERDICTS}
    tests = sum(total.values())
    if total["undecided"] == tests:
        return "Undecided: no condition has enough trials to test Eq. 1."
    rest = f" {total['undecided']} of {tests} verdicts are undecided." if total["undecided"] else ""
    if total["optimistic"] and total["pessimistic"]:
        return (
            f"Eq. 1 is off in both directions: {total['optimistic']} of {tests} verdicts find it optimistic, "
            f"{total['pessimistic']} pessimistic.{rest}"
        )
    if total["optimistic"] or total["pessimistic"]:
        way, which = ("more", "optimistic") if total["optimistic"] else ("fewer", "pessimistic")
        off = f"Eq. 1 is rejected in {total[which]} of {tests} verdicts"
        return f"{off}: {way} failures than it predicts.{rest}"
    return f"Eq. 1 is not rejected in {total['consistent']} of {tests} verdicts with enough power.{rest}"


def _sentences(level: dict[str, Any], analysis: dict[str, Any]) -> list[str]:
    settings, sentences = analysis["settings"], []
    if level["power_low"] is not None:
        low, high = (number(round(level[f"power_{end}"], 2)) for end in ("low", "high"))
        sentences.append(
            f"The power to detect a ratio of {number(settings['power_ratio'])} is {low} to {high}; it "
            f"reaches {number(settings['power_wanted'])} in {plural(level['powered'], 'condition')}."
        )
    sentences.append(
        f"Agreement within a factor of {number(settings['equivalence_ratio'])} is shown in "
        f"{plural(level['equivalent'], 'condition')} (equivalence test, uncorrected)."
    )
    return sentences


def _overall(level: dict[str, Any]) -> str | None:
    """Comparison of measured and predicted failures over all units."""
    overall = level["overall"]
    if not overall or not overall["measured"]["units"]:
        return None
    measured, within = overall["measured"], overall["within"]
    return (
        f"All conditions together, n = {level['n']}: failures were measured in {proportion(measured)}. "
        f"Eq. 1 within each condition predicts {share_of(within)}, "
        f"Eq. 1 of the pooled shares {share_of(overall['pooled'])}."
    )


def _dependence(analysis: dict[str, Any]) -> list[str]:
    """Odds ratios over all units, and number of cells in which independence is rejected."""
    sentences = []
    alpha = analysis["settings"]["alpha"]
    for thread in range(1, analysis["threads"] + 1):
        own = [t for cell in analysis["cells"] for t in cell["threads"] if t["thread"] == thread]
        tested = [t for t in own if t["fisher_p"] is not None]
        within = [t for t in own if t["mantel_haenszel_p"] is not None]
        if tested:
            rejected = sum(t["fisher_p"] < alpha for t in tested)
            rejected_within = sum(t["mantel_haenszel_p"] < alpha for t in within)
            least = p_value(min(t["fisher_p"] for t in tested))
            sentences.append(
                f"Thread {thread}: independence of breakage and recovery failure is rejected in {rejected} "
                f"of {plural(len(tested), 'condition')} over all worlds (least p {least}) and in "
                f"{rejected_within} of {len(within)} within worlds."
            )
    for name, estimate in analysis["heterogeneity"]["gee"].items():
        if estimate["value"] is not None and "odds" in name:
            sentences.append(f"Over all trials, {name}: {figure_of(estimate)}.")
    return sentences
