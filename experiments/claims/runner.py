"""Run the units of a claim's experiment that its ledger lacks, on a worker pool.

A unit's rows depend on spec and unit only, so they are the same for any number of workers. A unit that ends
in an infrastructure error has no row: the next run tries it again.
"""

import time
from collections import Counter, deque
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from dslab.experiments.campaign.folder import SPEC_FILE, claim_folder
from dslab.experiments.campaign.runner import Show, Tally
from dslab.experiments.claims.folder import owner_of, unit_key
from dslab.experiments.claims.kinds import KINDS
from dslab.experiments.claims.spec import ClaimSpec, Row, Unit
from dslab.experiments.jobs.ledger import Ledger, renew_ledger, sole_driver
from dslab.experiments.jobs.pool import PoolSettings, open_pool
from dslab.experiments.runs.files import plain
from dslab.experiments.runs.provenance import code_hash, commit
from dslab.scenarios.errors import MachineError
from dslab.sim.io.folders import write_file

_ALIKE = 2
"""So many failures in a row beyond those under way at once are a fault of the machine, or of the code."""


def run_claim(
    spec: ClaimSpec,
    folder: Path,
    settings: PoolSettings,
    show: Show | None = None,
    last_first: bool = False,
    rerun_damaged: bool = False,
) -> Tally:
    """Run all units of an experiment that its folder lacks.

    Args:
        spec: of the experiment.
        folder: absent, empty, or that of an earlier run of the same spec, which is continued.
        settings: of the workers.
        show: called with the progress, at least after each unit.
        last_first: begin with the last unit.
        rerun_damaged: drop damaged rows of the ledger and run their units again.

    Raises:
        InputError: the folder holds something else or is in use, or the disk is full.
        MachineError: unit after unit fails. The ledger keeps its rows.
    """
    claim_folder(folder)
    owner, kind = owner_of(spec), KINDS[spec.kind]
    units = kind.units(spec)
    with sole_driver(folder):
        renew_ledger(folder, owner, (folder / SPEC_FILE).is_file(), rerun_damaged)
        with Ledger.open(folder, owner) as ledger:
            done = {row["unit"] for row in ledger.rows()}
            write_file(folder / SPEC_FILE, partial(Path.write_text, data=spec.as_yaml(), encoding="utf-8"))
            left = deque(unit for unit in units if unit_key(unit) not in done)
            if last_first:
                left.reverse()
            run = _Run(ledger, len(units) - len(left), len(units), show or (lambda tally: None))
            if left:
                with open_pool(partial(measured, kind.measure, spec), settings) as pool:
                    for ended in pool.run(left, run.tick):
                        run.record(ended.item, ended.value, ended.message)
    return run.tally(0)


def measured(measure: Callable[[Any, Unit], list[Row]], spec: ClaimSpec, unit: Unit) -> Row:
    """Rows of a unit with where they come from; the task of a worker.

    Raises:
        ValueError: a value of a row is neither finite number nor text nor None.
    """
    began_s = time.monotonic()
    rows = [{name: _plain(name, value) for name, value in row.items()} for row in measure(spec, unit)]
    about = {"code": code_hash(), "commit": commit() or ""}
    return {"unit": unit_key(unit), "rows": rows, "wall_s": time.monotonic() - began_s, **about}


def _plain(name: str, value: Any) -> Any:
    made = plain(value)
    if isinstance(made, dict | list) or (made is None) != (value is None):
        raise ValueError(f"{name} is {value!r}, which is no plain value")
    return made


class _Run:
    """State of a run."""

    def __init__(self, ledger: Ledger, done: int, total: int, show: Show) -> None:
        self._ledger, self._done, self._total, self._show = ledger, done, total, show
        self._failed: Counter[str] = Counter()
        self._in_a_row = self._ended_here = self._most_busy = 0

    def tick(self, busy: int) -> None:
        """Show the progress with so many units under way."""
        self._most_busy = max(self._most_busy, busy)
        self._show(self.tally(busy))

    def tally(self, workers: int) -> Tally:
        """Progress of the run."""
        cause = self._failed.most_common(1)[0][0] if self._failed else ""
        errors = self._failed.total()
        return Tally(self._done, self._total, 0, errors, 0, self._ended_here, workers, cause=cause)

    def record(self, unit: Unit, row: Row | None, message: str) -> None:
        """Record the end of a unit.

        Raises:
            MachineError: one more of too many failures in a row.
        """
        if row is not None:
            self._ledger.add(row)
            self._done, self._ended_here, self._in_a_row = self._done + 1, self._ended_here + 1, 0
            return
        at = datetime.now(UTC).isoformat(timespec="seconds")
        self._ledger.add({"unit": unit_key(unit), "at": at, "message": message}, table="errors")
        self._failed[message] += 1
        self._in_a_row += 1
        if self._in_a_row >= self._most_busy + _ALIKE:
            problem = f"the last {self._in_a_row} units ended in an error: {message}"
            raise MachineError("the run has stopped", problem, "mend it and run the same command again")
