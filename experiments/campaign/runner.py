"""Run the units of an experiment that its ledger lacks, on a worker pool.

The rows of the ledger do not depend on the number of workers: a unit is a pure function of its spec, and
their records in order decide which units are run (see :mod:`experiments.campaign.schedule`).
"""

import re
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dslab.experiments.campaign.folder import (
    ERROR_COLUMNS,
    SPEC_FILE,
    claim_folder,
    open_ledger,
    owner_of,
    write_spec,
)
from dslab.experiments.campaign.schedule import Record, Schedule, UnitOrder
from dslab.experiments.eq1.record_table import normalise, record_fault, storable
from dslab.experiments.eq1.records import (
    SHAM,
    Outcome,
    dual_column,
    empty_record,
    failure_column,
    thread_column,
)
from dslab.experiments.eq1.spec import ExperimentSpec
from dslab.experiments.eq1.units import RECOVERING, UnitSpec
from dslab.experiments.jobs.ledger import Ledger, renew_ledger, sole_driver
from dslab.experiments.jobs.pool import Ended, Pool
from dslab.scenarios.errors import InputError, MachineError

TRIES = 4
"""Attempts per unit: the first, and three more after infrastructure errors."""


@dataclass(frozen=True)
class SystemTally:
    """Shares of one system so far: of units whose stress acted, as shams only show false alarms.

    Attributes:
        system: its name.
        completed: units whose free arm was completed.
        breakages: those with a breakage (B).
        failures: those in which it failed with all threads (D_n), or, if it has none, as a system (S).
        has_threads: whether it has recovery threads.
        crossing, uncrossed: of a run without the free arm: completed units, and those that no thread crosses.
    """

    system: str
    completed: int
    breakages: int
    failures: int
    has_threads: bool = True
    crossing: int = 0
    uncrossed: int = 0


@dataclass(frozen=True)
class Tally:
    """Progress of a run.

    Attributes:
        done, total: units that have ended, and all units.
        void, errors: units by outcome.
        retries: attempts in this run that ended in an infrastructure error.
        ended_here: units that ended in this run.
        workers: number of busy workers.
        systems: shares of each system, in the order of the cells.
        cause: the most frequent message of the units given up; empty if there are none.
    """

    done: int
    total: int
    void: int
    errors: int
    retries: int
    ended_here: int
    workers: int
    systems: tuple[SystemTally, ...] = ()
    cause: str = ""


Show = Callable[[Tally], None]
_ALIKE = 2
_VARYING = re.compile(r"[0-9a-f]{8,}|[0-9.]+")
"""Hashes and measured numbers, in which messages of one fault differ."""


def run_experiment(
    experiment: ExperimentSpec,
    folder: Path,
    open_pool: Callable[[], AbstractContextManager[Pool]],
    retry_errors: bool = False,
    rerun_damaged: bool = False,
    show: Show | None = None,
    order: Callable[[ExperimentSpec, Sequence[Record]], UnitOrder] = Schedule,
    digests: Mapping[str, str] | None = None,
) -> Tally:
    """Run all units of an experiment that its folder lacks.

    Args:
        experiment: its spec.
        folder: absent, empty, or that of an earlier run of the same spec, which is continued.
        open_pool: opens workers that take units and return records; called only if units are left.
        retry_errors: retry units that were given up after infrastructure errors.
        rerun_damaged: drop damaged rows of the ledger and run their units again.
        show: called with the progress, at least after each unit.
        order: makes what decides which unit comes next, from the experiment and the existing records.
        digests: of the systems that are not ours, by name, whose records must be of the same.

    Raises:
        InputError: the folder holds something else or is in use, or the disk is full. The ledger keeps its
            rows.
        MachineError: the scheduler is gone, no worker lives, unit after unit fails in the same way, or all
            units were given up. The ledger keeps its rows.
    """
    claim_folder(folder)
    with sole_driver(folder):
        begun = (folder / SPEC_FILE).is_file()  # it is written after the ledger's tables
        renew_ledger(folder, owner_of(experiment), begun, rerun_damaged)
        with open_ledger(folder, experiment) as ledger:
            rows, _ = ledger.rows(), ledger.errors()
            write_spec(folder, experiment)
            if retry_errors:
                ledger.drop(filter(is_infrastructure_error, rows))
                rows = ledger.rows()
            check_units(experiment, rows, folder)
            check_digests(rows, digests or {}, folder)
            run = _Run(ledger, order(experiment, rows), len(experiment.threads), show)
            if not run.schedule.complete:
                with open_pool() as pool:
                    run.work(pool)
            tally = run.tally(0)
    if 0 < tally.errors == tally.done:
        problem = f"all {tally.done} units were given up: {tally.cause}"
        raise MachineError(str(folder), problem, "mend it and run the same command again with --retry-errors")
    return tally


def is_infrastructure_error(record: Record) -> bool:
    """True if a unit failed for reasons other than the SLAM."""
    return record["outcome"] == Outcome.INFRASTRUCTURE_ERROR.value


def check_units(experiment: ExperimentSpec, rows: Sequence[Record], folder: Path) -> None:
    """Check that the rows belong to the units that the spec draws now.

    Raises:
        InputError: a unit differs, because the code that draws scenarios has changed.
    """
    for row in rows:
        unit = experiment.unit(row["cell"], row["index"])
        if unit.unit_id != row["unit_id"]:
            raise InputError(
                str(folder),
                f"the code now makes {row['cell']}:{row['index']} another unit, {unit.unit_id}",
                f"choose a new folder, or go back to commit {row['commit']}",
            )


def check_digests(rows: Sequence[Record], digests: Mapping[str, str], folder: Path) -> None:
    """Check that the rows of systems that are not ours are of these systems as they are now.

    Raises:
        InputError: a system was changed since.
    """
    for row in rows:
        now = digests.get(row["system"], "")
        if row["system_digest"] and now and row["system_digest"] != now:
            problem = f"{row['system']} was changed since it ran here"
            raise InputError(str(folder), problem, "choose a new folder, or undo the change")


def record_of(ended: Ended) -> dict[str, Any]:
    """The normalised record of a unit, whatever became of it in its worker."""
    unit, message = ended.item, ended.message
    if ended.value is not None:
        try:
            record = normalise(ended.value, len(unit.threads))
            # The writer checks what readers demand.
            fault = record_fault(record, len(unit.threads))
            if fault is None:
                return record
        except ValueError as error:
            fault = str(error)
        message = f"its record is wrong: {fault}"
    return normalise(empty_record(unit) | {"message": message}, len(unit.threads))


def _of_system(name: str, records: Sequence[Record], threads: int) -> SystemTally:
    tried = [
        r
        for r in records
        if r["outcome"] == Outcome.COMPLETED and r["kind"] != SHAM and r["exposed"] is not False
    ]
    completed = [r for r in tried if r["breakage"] is not None]
    crossing = [r for r in tried if r["breakage"] is None]
    crossed = [thread_column("cross", thread, "failed") for thread in range(1, threads + 1)]
    failed = dual_column(threads) if name in RECOVERING else failure_column("s", threads)
    return SystemTally(
        system=name,
        completed=len(completed),
        breakages=sum(bool(r["breakage"]) for r in completed),
        failures=sum(bool(r[failed]) for r in completed),
        has_threads=name in RECOVERING,
        crossing=len(crossing),
        uncrossed=sum(all(r[failed] for failed in crossed) for r in crossing),
    )


class _Run:
    """State of a run."""

    def __init__(self, ledger: Ledger, schedule: UnitOrder, threads: int, show: Show | None) -> None:
        self.schedule = schedule
        self._ledger, self._threads = ledger, threads
        proven = {r["cell"] for r in schedule.records() if not is_infrastructure_error(r)}
        self._faults = _RepeatedFault(schedule.first_cells, proven)
        self._most_busy = 1
        self._show = show or (lambda tally: None)
        self._due: deque[UnitSpec] = deque()
        self._failed: dict[str, int] = {}
        self._retries = self._ended_here = 0

    def work(self, pool: Pool) -> None:
        """Run the units that are left."""
        for ended in pool.run(self._next, self._tick):
            self._record(ended)

    def tally(self, workers: int) -> Tally:
        """Progress of the run."""
        records = self.schedule.records()
        given_up = Counter(r["message"] for r in records if is_infrastructure_error(r))
        return Tally(
            done=self.schedule.done,
            total=self.schedule.total,
            void=sum(r["outcome"] == Outcome.VOID for r in records),
            errors=given_up.total(),
            retries=self._retries,
            ended_here=self._ended_here,
            workers=workers,
            systems=tuple(
                _of_system(name, [r for r in records if r["system"] == name], self._threads)
                for name in dict.fromkeys(r["system"] for r in records)
            ),
            cause=given_up.most_common(1)[0][0] if given_up else "",
        )

    def _next(self, worker: str) -> UnitSpec | None:
        # Failed units come last: their fault may pass, or be found to be that of every unit.
        return self.schedule.next(worker) or (self._due.popleft() if self._due else None)

    def _tick(self, busy: int) -> None:
        self._most_busy = max(self._most_busy, busy)
        self._show(self.tally(busy))

    def _record(self, ended: Ended) -> None:
        """Record the end of a unit; after an infrastructure error, queue it again while tries are left."""
        unit, record = ended.item, record_of(ended)
        tried = self._failed.get(unit.unit_id, 0) + 1
        if is_infrastructure_error(record):
            at, message = datetime.now(UTC).isoformat(timespec="seconds"), record["message"]
            values = (unit.unit_id, unit.cell, unit.index, tried, at, ended.worker, message)
            error = dict(zip(ERROR_COLUMNS, (*values, storable(ended.report)), strict=True))
            self._ledger.add(error, table="errors")
            self._failed[unit.unit_id] = tried
            self._retries += 1
            self._faults.failure(unit, message, self._most_busy)
            if tried < TRIES:
                self._due.append(unit)
                return
        else:
            self._faults.success(unit.cell)
        record["attempts"] = tried
        self._ledger.add(record)
        self.schedule.finish(record)
        self._ended_here += 1


class _RepeatedFault:
    """Infrastructure errors of one kind since the last success.

    They count as a fault of the machine once more units have failed alike than were under way at once, which
    may share a passing fault. Before any success it must be a unit of every cell too; after one, units count
    only if their cell has had success, so that a cell whose units always fail is left to the tries of each.

    Args:
        cells: number of cells.
        proven: cells in which a unit has ended without an infrastructure error.
    """

    def __init__(self, cells: int, proven: set[str]) -> None:
        self._cells = cells
        self._proven = proven
        self._kind = ""
        self._units: dict[str, str] = {}

    def success(self, cell: str) -> None:
        """Note that a unit has ended without an infrastructure error."""
        self._proven.add(cell)
        self._units.clear()

    def failure(self, unit: UnitSpec, message: str, workers: int) -> None:
        """Note an infrastructure error.

        Args:
            unit: the failed unit.
            message: of the error.
            workers: largest number of units under way at once.

        Raises:
            MachineError: the fault is the machine's.
        """
        if self._proven and unit.cell not in self._proven:
            return
        kind = _VARYING.sub("#", message)
        if kind != self._kind:
            self._kind = kind
            self._units.clear()
        self._units[unit.unit_id] = unit.cell
        everywhere = bool(self._proven) or len(set(self._units.values())) == self._cells
        if everywhere and len(self._units) >= workers + _ALIKE:
            problem = f"the last {len(self._units)} units ended in the same error: {message}"
            raise MachineError("the run has stopped", problem, "mend it and run the same command again")
