"""Status of an experiment, from its folder alone."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dslab.experiments.campaign.folder import read_errors, read_rows
from dslab.experiments.campaign.schedule import Schedule
from dslab.experiments.eq1.records import Outcome, dual_column


@dataclass(frozen=True)
class CellStatus:
    """Status of a cell.

    Attributes:
        cell: its name.
        budget: number of units.
        units: number of units that have ended.
        completed, unexposed, void, errors: of these, by outcome; unexposed: completed, but the stress did not
            act.
        breakages, failures: completed units with B, and with failure of all threads (D_n).
    """

    cell: str
    budget: int
    units: int
    completed: int
    unexposed: int
    void: int
    errors: int
    breakages: int
    failures: int


@dataclass(frozen=True)
class ExperimentStatus:
    """Status of an experiment.

    Attributes:
        name, spec_hash: of its spec.
        done, total: units that have ended, and all units.
        cells: status of each cell.
        failed_attempts: number of infrastructure errors.
        given_up: id and message of the units given up after such errors.
        codes: hashes of the sources that ran the units; with more than one, results may not be comparable.
        wall_s: worker time of the units.
    """

    name: str
    spec_hash: str
    done: int
    total: int
    cells: tuple[CellStatus, ...]
    failed_attempts: int
    given_up: tuple[tuple[str, str], ...]
    codes: tuple[str, ...]
    wall_s: float


def experiment_status(folder: Path) -> ExperimentStatus:
    """Read the status of the experiment in a folder, also during a run, or of its exported tables.

    Raises:
        InputError: it is not an experiment's folder.
    """
    spec, rows = read_rows(folder)
    errors = read_errors(folder)
    schedule = Schedule(spec, rows)
    whole = dual_column(len(spec.threads))
    return ExperimentStatus(
        name=spec.name,
        spec_hash=spec.content_hash,
        done=schedule.done,
        total=schedule.total,
        cells=tuple(
            _cell(cell, spec.units_of(cell), [r for r in rows if r["cell"] == cell], whole)
            for cell in spec.cell_names()
        ),
        failed_attempts=len(errors),
        given_up=tuple(
            (r["unit_id"], r["message"]) for r in rows if r["outcome"] == Outcome.INFRASTRUCTURE_ERROR
        ),
        codes=tuple(sorted({r["code"] for r in rows if r["code"]})),
        wall_s=sum(r["wall_s"] or 0.0 for r in rows),
    )


def _cell(cell: str, budget: int, rows: list[dict[str, Any]], whole: str) -> CellStatus:
    outcomes = Counter(row["outcome"] for row in rows)
    done = [row for row in rows if row["outcome"] == Outcome.COMPLETED]
    completed = [row for row in done if row["exposed"] is not False]
    return CellStatus(
        cell=cell,
        budget=budget,
        units=len(rows),
        completed=len(completed),
        unexposed=len(done) - len(completed),
        void=outcomes[Outcome.VOID],
        errors=outcomes[Outcome.INFRASTRUCTURE_ERROR],
        breakages=sum(bool(row["breakage"]) for row in completed),
        failures=sum(bool(row[whole]) for row in completed),
    )
