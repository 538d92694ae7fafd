"""Answer of an experiment: what was asked, tried, measured and predicted, and how sure that is."""

from dataclasses import dataclass
from typing import Any

from experiments.report.conditions import describe_stress
from experiments.report.describe import listed, number, percent, plural
from scenarios.describe import describe_kind

WORLDS_FOR_A_TEST = 100
"""Number of worlds below which they are called too few: a rough figure, the power was not simulated."""

_KINDS_WITH_DOSES = 4


@dataclass(frozen=True)
class AnswerRow:
    """Failures with n recovery threads, as shares of the trials; None where not determined.

    Attributes:
        n: number of recovery threads.
        measured, low, high: share of trials in which tracking breaks and all n threads fail; its interval.
        predicted, predicted_low, predicted_high: the same by Eq. 1, kinds of world told apart.
    """

    n: int
    measured: float | None
    low: float | None
    high: float | None
    predicted: float | None
    predicted_low: float | None
    predicted_high: float | None


@dataclass(frozen=True)
class Answer:
    """Answer of an experiment, for page and terminal.

    Attributes:
        sentences: plain text, the verdict first; measured and predicted shares are in the rows instead.
        rows: one per n; empty before a trial is completed.
    """

    sentences: list[str]
    rows: list[AnswerRow]


def answer(results: dict[str, Any]) -> Answer:
    """Answer the question of an experiment from its figures.

    Args:
        results: figures as `report_content` returns them and report.json holds them.
    """
    kinds = results["kinds_of_world"]
    rows = [_row(level) for level in kinds["levels"]]
    if not rows:
        return Answer(["No result yet: no trial is completed.", _asked(), _tried(results)], [])
    sentences = [_verdict(kinds), _asked(), _tried(results), _certainty(results), _mixture(kinds)]
    return Answer([*filter(None, sentences), _limits(results)], rows)


def _row(level: dict[str, Any]) -> AnswerRow:
    measured = level["measured"]
    low, high = level["predicted_interval"] or (None, None)
    predicted = level["predicted_by_kind"]
    return AnswerRow(level["n"], measured["value"], measured["low"], measured["high"], predicted, low, high)


def _verdict(kinds: dict[str, Any]) -> str:
    if kinds["worlds"] < WORLDS_FOR_A_TEST:
        return "No verdict on Eq. 1: too few units to decide."
    return "No verdict on Eq. 1: no test here allows for units that share a world."


def _asked() -> str:
    return (
        "Asked: does Dual-SLAM fail as rarely as Eq. 1 of its paper says, Pr(failure) = p₀ · prⁿ? A failure "
        "is a trial in which tracking breaks (p₀) and each of n recovery threads fails (pr); Eq. 1 takes "
        "these for independent."
    )


def _tried(results: dict[str, Any]) -> str:
    kinds, threads = results["kinds_of_world"], results["experiment"]["threads"]
    worlds = f" ({listed(kinds['kinds'])})" if kinds["kinds"] else ""
    return (
        f"Tried: {_stress(results['conditions'])}. {plural(kinds['units'], 'trial')} (units) in "
        f"{plural(kinds['worlds'], 'rendered world')}{worlds}; recovery threads in order: "
        f"{', '.join(thread['kind'].upper() for thread in threads)}."
    )


def _stress(found: list[dict[str, Any]]) -> str:
    """Kinds of degradation, with their doses if there are few."""
    kinds = list(dict.fromkeys(condition["kind"] for condition in found))
    few = len(kinds) <= _KINDS_WITH_DOSES
    return listed([describe_stress(found, kind) if few else describe_kind(kind) for kind in kinds])


def _certainty(results: dict[str, Any]) -> str:
    kinds, confidence = results["kinds_of_world"], results["analysis"]["settings"]["confidence"]
    return (
        f"How sure: the {number(100 * confidence)} % intervals rest on {plural(kinds['worlds'], 'world')}, "
        "for trials in one world succeed and fail together."
    )


def _mixture(kinds: dict[str, Any]) -> str | None:
    """Prediction from conditions that mix kinds of world."""
    shares = [percent(level["predicted_by_cell"]) for level in kinds["levels"]]
    if not kinds["mixed"]:
        return None
    return (
        f"Mixed worlds: predicted from {listed(kinds['kinds'])} together, not from each kind apart, it would "
        f"be {listed(shares)}: where easy and hard worlds are mixed, failures coincide more often than Eq. 1 "
        "says, even if it holds in each kind."
    )


def _limits(results: dict[str, Any]) -> str:
    units = results["units"]
    left_out = [
        f"{plural(units['void'], 'trial')} without a healthy map before the stress" if units["void"] else "",
        f"{plural(units['errors'], 'trial')} that ended in an error of the machine"
        if units["errors"]
        else "",
    ]
    without = listed([part for part in left_out if part])
    return (
        "Not said: anything about real footage, other cameras, or worlds and doses that were not tried."
        + (f" Left out: {without}." if without else "")
    )
