"""Units of an experiment that are worth seeing, for who does not know their names."""

import shlex
from pathlib import Path

from dslab.experiments.cli.console import say
from dslab.scenarios.errors import InputError

MOST_LISTED = 20


def unit_to_replay(folder: Path, outcome: str | None) -> str | None:
    """The first unit with an outcome; without one a list of units is printed.

    Args:
        folder: of the experiment.
        outcome: a part of the words for what happened; None to list the first failure of each condition.

    Returns:
        CELL:INDEX; None if units were listed.

    Raises:
        InputError: nothing of that kind happened.
    """
    from dslab.experiments.campaign.folder import read_experiment
    from dslab.experiments.report.outcomes import happened

    spec, table = read_experiment(folder)
    found = happened(table, len(spec.threads))
    if outcome is not None:
        for unit in found:
            if any(outcome.lower() in words.lower() for words in unit["words"]):
                return f"{unit['cell']}:{unit['index']}"
        known = dict.fromkeys(words.partition(" (")[0] for unit in found for words in unit["words"])
        remedy = f"use a part of: {', '.join(known)}" if known else "run some units first"
        raise InputError("--outcome", f"{outcome!r} is of no unit that was run", remedy)
    first: dict[str, dict] = {}
    for unit in found:
        if unit["rank"] > first.setdefault(unit["cell"], unit)["rank"]:
            first[unit["cell"]] = unit
    for unit in [*first.values()][:MOST_LISTED]:
        name = shlex.quote(f"{unit['cell']}:{unit['index']}")
        say(f"dslab experiment replay {shlex.quote(str(folder))} {name}  # {', '.join(unit['words'])}")
    if len(first) > MOST_LISTED:
        say(f"and one in each of {len(first) - MOST_LISTED} further cells: --outcome TEXT picks one")
    if not first:
        say("no unit has ended: any can be replayed as CELL:INDEX, cells are in `dslab experiment show DIR`")
    return None
