"""Replay of one unit in a process like those of the run, compared with its row of the ledger or table."""

import re
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dslab.experiments.campaign.folder import read_rows, release_of
from dslab.experiments.campaign.runner import is_infrastructure_error, record_of
from dslab.experiments.campaign.workers import UnitWorkers
from dslab.experiments.eq1.records import reproduced
from dslab.experiments.eq1.spec import ExperimentSpec
from dslab.experiments.eq1.trial import record_unit
from dslab.experiments.eq1.units import UnitSpec
from dslab.scenarios.errors import InputError, MachineError


@dataclass(frozen=True)
class Replay:
    """A unit run again.

    Attributes:
        unit: its spec.
        record: the new record.
        recorded: its row; None if it has none yet.
        release: the release that replays its row, if it is of an exported table.
        differing: columns in which the two differ, except those of cost and of the code; empty if the unit is
            reproduced.
    """

    unit: UnitSpec
    record: dict[str, Any]
    recorded: dict[str, Any] | None
    release: str | None
    differing: tuple[str, ...]

    @property
    def origin(self) -> str:
        """A line about the code that replays its row; empty if it is the code at hand."""
        if self.recorded is None or self.record["code"] == self.recorded["code"]:
            return ""
        known = self.release or self.recorded["commit"]
        return f"this code is not the row's: lab@{known} replays it (`dslab systems install lab@{known}`)"


def replay(folder: Path, name: str, workers: UnitWorkers, recording: Path | None = None) -> Replay:
    """Run a unit of an experiment again.

    Args:
        folder: of the experiment, with its ledger or with only the exported table.
        name: its id or a unique beginning of it, or ``cell:index``, also of a unit not run yet.
        workers: one that runs the unit.
        recording: file for its recording; None for none.

    Raises:
        InputError: no such folder or unit.
        MachineError: the unit ended in an infrastructure error.
    """
    spec, known = read_rows(folder)
    rows = {(row["cell"], row["index"]): row for row in known}
    unit = _find_unit(spec, known, name)
    with workers.open() as pool:
        (ended,) = pool.run(deque([unit]))
    record = record_of(ended)
    if is_infrastructure_error(record):
        raise MachineError(f"unit {unit.unit_id}", record["message"], "see `dslab experiment status`")
    if recording is not None:
        record_unit(unit, recording, workers.folders)
    recorded = rows.get((unit.cell, unit.index))
    changed = ()
    if recorded is not None:
        changed = tuple(name for name, value in reproduced(record).items() if value != recorded[name])
    return Replay(unit, record, recorded, release_of(folder), changed)


def _find_unit(spec: ExperimentSpec, rows: Sequence[Mapping[str, Any]], name: str) -> UnitSpec:
    if match := re.fullmatch(r"(.+):(\d+)", name):
        return spec.unit(match[1], int(match[2]))
    found = [row for row in rows if row["unit_id"].startswith(name.lower())]
    if not found:
        problem = "no unit that was run has an id that begins so"
        raise InputError(name, problem, "give CELL:INDEX for any other")
    if len(found) > 1:
        problem, more = f"{len(found)} units have ids that begin so", found[0]["unit_id"]
        raise InputError(name, problem, f"give more of it, as {more}")
    return spec.unit(found[0]["cell"], found[0]["index"])
