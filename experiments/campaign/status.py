"""Status of an experiment, from its folder alone."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dslab.experiments.campaign.folder import read_errors, read_rows
from dslab.experiments.campaign.schedule import Schedule
from dslab.experiments.eq1.boundary_plan import is_search
from dslab.experiments.eq1.records import Outcome, dual_column, failure_column


@dataclass(frozen=True)
class CellStatus:
    """Status of a cell.

    Attributes:
        cell: its name.
        budget: number of units; None in a boundary search, which chooses its doses.
        units: number of units that have ended.
        completed, unexposed, void, errors: of these, by outcome; unexposed: completed, but the stress did not
            act.
        breakages, dual_failures, system_failures: completed units with B, with failure of all threads (D_n),
            and in which the system failed (S); None where it is known of none, as D_n of a system without
            threads.
    """

    cell: str
    budget: int | None
    units: int
    completed: int
    unexposed: int
    void: int
    errors: int
    breakages: int | None
    dual_failures: int | None
    system_failures: int | None


@dataclass(frozen=True)
class ExperimentStatus:
    """Status of an experiment.

    Attributes:
        name, spec_hash: of its spec.
        is_search: whether it is a boundary search.
        done, total: units that have ended, and all units; of a search its trials.
        cells: status of each cell.
        failed_attempts: number of infrastructure errors.
        given_up: id and message of the units given up after such errors.
        codes: hashes of the sources that ran the units; with more than one, results may not be comparable.
        wall_s: worker time of the units.
    """

    name: str
    spec_hash: str
    is_search: bool
    done: int
    total: int
    cells: tuple[CellStatus, ...]
    failed_attempts: int
    given_up: tuple[tuple[str, str], ...]
    codes: tuple[str, ...]
    wall_s: float

    @property
    def finished(self) -> bool:
        """True if all units have ended."""
        return self.done == self.total


def experiment_status(folder: Path) -> ExperimentStatus:
    """Read the status of the experiment in a folder, also during a run, or of its exported tables.

    Raises:
        InputError: it is not an experiment's folder.
    """
    spec, rows = read_rows(folder)
    errors = read_errors(folder)
    search = is_search(spec)
    if search:
        done, total = len({r["index"] for r in rows if r["index"] < spec.worlds}), spec.worlds
    else:
        schedule = Schedule(spec, rows)
        done, total = schedule.done, schedule.total
    of_cell = {cell: [r for r in rows if r["cell"] == cell] for cell in spec.cell_names()}
    return ExperimentStatus(
        name=spec.name,
        spec_hash=spec.content_hash,
        is_search=search,
        done=done,
        total=total,
        cells=tuple(
            _cell(cell, None if search else spec.units_of(cell), own, len(spec.threads))
            for cell, own in of_cell.items()
            if own or not search
        ),
        failed_attempts=len(errors),
        given_up=tuple(
            (r["unit_id"], r["message"]) for r in rows if r["outcome"] == Outcome.INFRASTRUCTURE_ERROR
        ),
        codes=tuple(sorted({r["code"] for r in rows if r["code"]})),
        wall_s=sum(r["wall_s"] or 0.0 for r in rows),
    )


def _cell(cell: str, budget: int | None, rows: list[dict[str, Any]], threads: int) -> CellStatus:
    outcomes = Counter(row["outcome"] for row in rows)
    done = [row for row in rows if row["outcome"] == Outcome.COMPLETED]
    completed = [row for row in done if row["exposed"] is not False]

    def with_event(column: str) -> int | None:
        known = [row[column] for row in completed if row[column] is not None]
        return sum(known) if known else None

    return CellStatus(
        cell=cell,
        budget=budget,
        units=len(rows),
        completed=len(completed),
        unexposed=len(done) - len(completed),
        void=outcomes[Outcome.VOID],
        errors=outcomes[Outcome.INFRASTRUCTURE_ERROR],
        breakages=with_event("breakage"),
        dual_failures=with_event(dual_column(threads)),
        system_failures=with_event(failure_column("s", threads)),
    )
