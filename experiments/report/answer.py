"""Answer of an experiment in plain words: what was asked, the answer, for which conditions, how sure."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from dslab.experiments.report.conditions import describe_label, describe_stress, thread_names
from dslab.experiments.report.describe import interval_of_share, listed, p_value, percent, plural
from dslab.experiments.statistics.verdicts import LEVEL

LEAST_WORLDS = 10
"""Worlds with the event below which nothing is tested (`statistics.verdicts`)."""

_KINDS_WITH_DOSES = 4
_READINGS = ("of_sequences", "of_averages")
_REFUTED = ("optimistic", "pessimistic")
_FEW = 2  # systems, of which it is also said that they are not told apart
_ASKED = (
    "Asked: does Dual-SLAM fail as rarely as Eq. 1 of its paper says, Pr(failure) = p₀ · prⁿ, as if the "
    "breakage of tracking (p₀) and the failure of each of n recovery threads (pr) were independent?"
)
MEANINGS = {
    "optimistic": "Eq. 1 predicted too few failures",
    "pessimistic": "Eq. 1 predicted too many",
    "consistent": "Eq. 1 agrees with what was measured, within .3 of the way to the weakest link",
    "undecided": "there are too few worlds to decide",
    "saturated": "Eq. 1 cannot be told from the weakest link, as all fails",
    "untested": f"fewer than {LEAST_WORLDS} worlds with a breakage, or with a failure of each thread, "
    "or too few with a dual failure",
}


@dataclass(frozen=True)
class Answer:
    """Answer of an experiment, for page and terminal.

    Attributes:
        headline: the verdict.
        sentences: the paragraph behind it.
        rows: per kind of world and n, as ``KindOfWorld`` of the analysis.
    """

    headline: str
    sentences: list[str]
    rows: list[dict[str, Any]]


def answer(results: dict[str, Any]) -> Answer:
    """Answer the question of an experiment from its figures: of systems compared, then of Eq. 1."""
    of_eq1 = _of_eq1(results)
    if results["systems"] is None:
        return of_eq1
    headline, sentences = systems_answer(results["systems"])
    headlines = [headline, of_eq1.headline] if results["asks_eq1"] else [headline]
    return Answer(" ".join(headlines), [*sentences, *of_eq1.sentences], of_eq1.rows)


def has_crossing_arm(results: dict[str, Any]) -> bool:
    """True if the threads crossed every segment, which gives the pr of Eq. 1."""
    return "crossing" in results["experiment"]["spec"]["arms"]


def systems_answer(beside: dict[str, Any]) -> tuple[str, list[str]]:
    """How often each system fails under stress, and which differ.

    Args:
        beside: ``systems`` of the figures, of which all is taken.

    Returns:
        The headline, and the sentences behind it.
    """
    under = {about["system"]: about["under_stress"] for about in beside["about"]}
    worlds = dict.fromkeys(share["world"] for shares in under.values() for share in shares)
    each = []
    for world in worlds:
        shares = [
            (name, s["mission_failure"]) for name, of in under.items() for s in of if s["world"] == world
        ]
        said = ", ".join(f"{name} {interval_of_share(share)}" for name, share in shares)
        each.append(f"{world.replace('_', ' ')}: {said}" if len(worlds) > 1 else said)
    if not each:
        return "No trial under stress is completed.", []
    sentences, untold = [], 0
    for pair in beside["over_doses"]:
        if pair["failure"] == "mission_failure":
            surely = pair["p"] is not None and pair["p"] <= LEVEL
            if not surely and len(beside["names"]) > _FEW:
                untold += 1
                continue
            than = "less" if pair["difference"] < 0 else "more"
            verdict = f"fails {than} often than" if surely else "is not told from"
            points = 100 * pair["difference"]
            sentences.append(
                f"{pair['first']} {verdict} {pair['second']} ({pair['world'].replace('_', ' ')}: "
                f"{points:+.1f} points over {plural(pair['worlds'], 'world')}, p {_equals(pair['p'])})."
            )
    if untold:
        sentences.append(f"{plural(untold, 'more comparison')} of two systems tell none from the other.")
    return f"Missions that fail under stress: {'; '.join(each)}.", [*_gains(beside["gains"]), *sentences]


def _gains(gains: list[dict[str, Any]]) -> list[str]:
    """What Dual-SLAM gains over each system, in a sentence."""
    sentences = []
    for pair in dict.fromkeys((g["missions"]["first"], g["missions"]["second"]) for g in gains):
        own = [g for g in gains if (g["missions"]["first"], g["missions"]["second"]) == pair]
        each = [
            f"{g['missions']['image'].replace('_', ' ')}: {g['fails']} to {g['fails_with']} of "
            f"{g['missions']['units']}, p {_equals(g['missions']['p'])}"
            for g in own
        ]
        rescuable, recovered, joins, false = (
            sum(g[name] for g in own) for name in ("rescuable", "recovered", "joins", "false")
        )
        sentences.append(
            f"Missions of {pair[0]} that fail, alone and as {pair[1]}: {'; '.join(each)}. Of "
            f"{plural(rescuable, 'breakage')} that images can recover {recovered} are; of "
            f"{plural(joins, 'declared join')} {false} are false."
        )
    return sentences


def _equals(p: float | None) -> str:
    said = p_value(p)
    return said if said.startswith("<") else f"= {said}"


def _of_eq1(results: dict[str, Any]) -> Answer:
    analysis = results["analysis"]
    told = confirmed(analysis["cells"])
    if not results["asks_eq1"]:
        said = "Eq. 1 is about the threads of dual and paper: these systems stand beside each other."
        return Answer("Not asked: no system has recovery threads.", [said], [])
    if not results["free_arm"]:
        return Answer("Eq. 1 is not asked: only the crossing arm ran.", [*_crossings(results)], [])
    if not has_crossing_arm(results):
        said = "Without the crossing arm no failure of a thread is known apart from breakages."
        left = [said, _tried(results), _certainty(results), _limits(results)]
        return Answer("Eq. 1 is not asked: only the free arm ran.", left, [])
    asked = [_ASKED, _tried(results)]
    if not told:
        return Answer("No result yet: no trial is completed.", asked, [])
    sentences = [*asked, *_verdicts(results, told)]
    sentences.append(
        "These are the conditions named before the run; the others are exploratory."
        if any(cell["confirmatory"] for cell in told)
        else "No condition was named before the run: all are exploratory."
    )
    sentences += [*_readings(results, told), _certainty(results)]
    if results["reanalysed"]:
        sentences.append("Reanalysed: the spec mixed kinds of world in a condition; they are split here.")
    headline, refuted = _headline(told), sum(cell["verdict_in_units"] in _REFUTED for cell in told)
    if refuted:
        tests = f"{refuted} of {len(told)} tests"
        headline = f"Breakages and failures of the threads are not independent in {tests}. {headline}"
    return Answer(headline, [*sentences, _chance(analysis), _limits(results)], analysis["kinds_of_world"])


def confirmed(cells: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The confirmatory of some judged cells; all of them where none was named."""
    return [cell for cell in cells if cell["confirmatory"]] or cells


def _headline(told: list[dict[str, Any]]) -> str:
    """What the forecast of Eq. 1 is worth."""
    counts, total = Counter(cell["verdict_forecast"] for cell in told), len(told)
    wrong = [
        f"too {few} failures in {counts[verdict]}"
        for verdict, few in zip(_REFUTED, ("few", "many"), strict=True)
        if counts[verdict]
    ]
    if wrong:
        return f"Eq. 1 predicted {listed(wrong)} of {plural(total, 'test')}."
    tests = plural(total, "test")
    if counts["consistent"]:
        return f"Eq. 1 agrees in {counts['consistent']} of {tests}, and in none it is refuted."
    if counts["undecided"]:
        rest = " The others could not be tested." if counts["undecided"] < total else ""
        return f"Undecided: too few worlds in {counts['undecided']} of {tests}.{rest}"
    if counts["saturated"]:
        some = f"in {plural(counts['saturated'], 'test')} any formula is right, and {counts['untested']}"
        why = f"{some} could not be made" if counts["untested"] else "where all fails, any formula is right"
        return f"No verdict on Eq. 1: {why}."
    most = max(cell["worlds"] for cell in told)
    if most < LEAST_WORLDS:
        takes = f"a test takes {LEAST_WORLDS} worlds that break and fail to recover"
        return f"Untested: {takes}; {most} were run."
    return f"Untested: in no condition did {LEAST_WORLDS} worlds both break and fail to recover."


def _crossings(results: dict[str, Any]) -> Iterable[str]:
    """What the threads cross in a run without the free arm."""
    yield "Asked: which recovery thread carries the new map back over the stress, broken tracking or not?"
    yield _tried(results)
    of = {
        name: [s for s in results["analysis"]["thread_shares"] if s["thread"] == number]
        for number, name in enumerate(thread_names(results), 1)
    }
    failed = [f"{name} in {_range(s['failed'] for s in shares)}" for name, shares in of.items() if shares]
    if failed:
        yield f"Failed, of the trials of a condition: {listed(failed)}."
    for name, shares in list(of.items())[1:]:
        if added := [share for share in shares if share["adds"] is not None]:
            crossed = _range(share["adds"] for share in added)
            needed = plural(sum(share["needed"] for share in added), "trial")
            yield f"Where all before it fail, in {needed}, {name} crosses {crossed} of a condition's."
    yield _certainty(results)
    yield _limits(results)


def _range(shares: Iterable[dict[str, Any]]) -> str:
    values = [share["value"] for share in shares]
    return " to ".join(percent(value) for value in dict.fromkeys((min(values), max(values))))


def _tried(results: dict[str, Any]) -> str:
    analysis = results["analysis"]
    kinds = listed(list(results["worlds_of_kinds"]))
    worlds = plural(analysis["worlds"], "rendered world") + (f" ({kinds})" if kinds else "")
    found = results["conditions"]
    stress = list(dict.fromkeys(condition["kind"] for condition in found if condition["dose"] != "none"))
    few = len(stress) <= _KINDS_WITH_DOSES
    tried = listed([describe_stress(found, kind) if few else describe_label(kind) for kind in stress])
    return (
        f"Tried: {tried}, in {plural(analysis['units'], 'trial')} in {worlds}, with "
        f"the recovery threads {', then '.join(thread_names(results))}."
    )


def _verdicts(results: dict[str, Any], told: list[dict[str, Any]]) -> Iterable[str]:
    names = thread_names(results)
    for n in dict.fromkeys(cell["n"] for cell in told):
        counts = Counter(cell["verdict_forecast"] for cell in told if cell["n"] == n)
        total = plural(sum(counts.values()), "condition")
        each = [f"{counts[v]} {v} ({text})" for v, text in MEANINGS.items() if counts[v]]
        yield f"With {' and '.join(names[:n])}, of {total}: {'; '.join(each)}."


def _readings(results: dict[str, Any], told: list[dict[str, Any]]) -> Iterable[str]:
    """Both readings over all conditions, with the numbers of threads that decide."""
    numbers = {cell["n"] for cell in told}
    all_of = [r for r in results["analysis"]["readings"] if r["cell"] is None and r["n"] in numbers]
    known = [r for r in all_of if r["of_sequences"] is not None]
    if known:
        names = thread_names(results)
        measured, own, averages = (
            listed([percent(share) for share in shares])
            for shares in zip(
                *((r["measured"]["value"], *(r[of]["predicted"] for of in _READINGS)) for r in known),
                strict=True,
            )
        )
        threads = listed([" and ".join(names[: r["n"]]) for r in known])
        yield (
            f"Over all conditions, weighted alike, {measured} failed with {threads}: Eq. 1 with each "
            f"sequence's own p₀ and pr predicts {own}, with averages over sequences {averages}."
        )


def _certainty(results: dict[str, Any]) -> str:
    worlds = results["worlds_of_kinds"]
    each = listed([f"{plural(count, 'world')} of kind {world}" for world, count in worlds.items()])
    few = " So few worlds decide little." if min(worlds.values(), default=0) < 3 * LEAST_WORLDS else ""
    return f"How sure: all rests on {each}, as the trials of one world succeed and fail together.{few}"


def _chance(analysis: dict[str, Any]) -> str:
    if not analysis["chance"]:
        return (
            "Chance could not be told from the difficulty of the sequences: that takes repeats, three worlds "
            "and breakages that vary."
        )
    each = [f"{interval_of_share(share)} in kind {world}" for world, share in analysis["chance"].items()]
    return (
        f"Chance, not the difficulty of the sequence, makes {listed(each)} of what varies in the breakages."
    )


def _limits(results: dict[str, Any]) -> str:
    aside, units = results["set_aside"], results["units"]
    void = dict.fromkeys(record["cell"].rpartition("/")[2] for record in aside["void"])
    whose = f"of {listed(list(void))} " if results["systems"] is not None else ""
    left_out = (
        (aside["void_lead_ins"], "lead-in", f"{whose}that ended without a healthy map"),
        (units["unexposed"], "trial", "whose stress did not act"),
        (units["errors"], "trial", "that ended in an error of the machine"),
    )
    without = listed([f"{plural(count, noun)} {what}" for count, noun, what in left_out if count])
    return (
        "Not said: anything about real footage, other cameras, or worlds and doses that were not tried."
        + (f" Left out: {without}." if without else "")
    )
