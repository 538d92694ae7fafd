"""Which runs are repeats of each other, and names by which the others differ visibly."""

import json
from collections.abc import Mapping
from collections.abc import Sequence as Many
from itertools import chain, count
from typing import Any

from dslab.experiments.comparison.left_runs import LeftRun
from dslab.experiments.result_folder import SUMMARY_FILE
from dslab.scenarios.describe import describe_field, describe_kind
from dslab.scenarios.errors import InputError

_SPAN = ("start_s", "end_s")


def by_input(runs: Many[LeftRun]) -> dict[str, list[LeftRun]]:
    """Runs of one input, whatever its name: images, times, camera, truth and stress; by a name of their own.

    Raises:
        InputError: a run does not say what it was given.
    """
    for run in runs:
        if not run.summary.get("input"):
            problem, remedy = "does not say what the run was given", "run it again, or leave it out"
            raise InputError(f"{run.folder / SUMMARY_FILE}: input", problem, remedy)
    return _named(runs, lambda run: run.summary["input"], lambda run: run.sequence, input_facts)


def by_system(runs: Many[LeftRun]) -> dict[str, list[LeftRun]]:
    """Runs of one system with one set of settings, by a name of their own."""
    return _named(runs, lambda run: [run.system, _settings(run)], lambda run: run.system, _settings)


def input_facts(run: LeftRun) -> dict[str, str]:
    """What tells inputs of one name apart, the most telling first."""
    summary = run.summary
    facts = {"source": summary.get("source", "")}
    if (seed := summary.get("scenario_seed")) is not None:
        facts["seed"] = f"seed {seed}"
    for place, segment in enumerate(segments := summary["segments"]):
        kind = describe_kind(str(segment["kind"]))
        about = f"{kind} " if len(segments) > 1 else ""
        fields = {name: segment[name] for name in _SPAN} | segment["severity"]
        facts |= {f"{place}.{name}": about + describe_field(name, value) for name, value in fields.items()}
    return facts | {part: f"{part} {digest[:6]}" for part, digest in summary["input"].items()}


def told_apart(names: Many[str], facts: Many[Mapping[str, str]]) -> list[str]:
    """Names, where several are equal with facts in which they differ, as few as make all different.

    Where facts do not suffice, names are numbered.
    """
    labels = list(names)
    for name in dict.fromkeys(names):
        own = [place for place, other in enumerate(names) if other == name]
        for key in dict.fromkeys(key for place in own for key in facts[place]):
            if len({labels[place] for place in own}) == len(own):
                break
            values = [facts[place].get(key, "") for place in own]
            if len(set(values)) > 1:
                for place, value in zip(own, values, strict=True):
                    labels[place] += f", {value}" if value else ""
    for place, stem in enumerate(labels):
        numbered = (f"{stem} ({number})" for number in count(2))
        labels[place] = next(name for name in chain([stem], numbered) if name not in labels[:place])
    return labels


def _named(runs: Many[LeftRun], content: Any, name: Any, facts: Any) -> dict[str, list[LeftRun]]:
    groups: dict[str, list[LeftRun]] = {}
    for run in runs:
        groups.setdefault(json.dumps(content(run), sort_keys=True), []).append(run)
    firsts = [own[0] for own in groups.values()]
    labels = told_apart([name(run) for run in firsts], [facts(run) for run in firsts])
    return dict(zip(labels, groups.values(), strict=True))


def _settings(run: LeftRun) -> dict[str, str]:
    """Every setting of a system, and the code that it was run by."""
    found: dict[str, str] = {}

    def add(value: Any, at: str) -> None:
        if isinstance(value, dict):
            for name, part in value.items():
                add(part, f"{at}.{name}" if at else str(name))
        else:
            found[at] = f"{at} {value}"

    add(run.summary["config"], "")
    return found | {"code": f"code {run.summary.get('code', '')[:6]}"}
