"""Order of the trials of a boundary search: shams, then batches whose doses earlier batches decide.

A batch starts when all trials before it have ended, so that doses depend neither on the number of workers nor
on who ends first; a resumed search goes on with the doses that it would have chosen.
"""

from collections import Counter
from collections.abc import Sequence

from dslab.experiments.campaign.schedule import Record, UnitOrder
from dslab.experiments.eq1.boundary_plan import BoundaryPlan
from dslab.experiments.eq1.records import Outcome
from dslab.experiments.eq1.units import UnitSpec
from dslab.experiments.statistics.boundary import SHAM, CurveGrid, Floats, curve_grid
from dslab.scenarios.errors import InputError


class BoundarySchedule(UnitOrder):
    """The trials of a search that are left.

    A trial that was recorded keeps its dose. A void one, one that was given up, and one whose stress did not
    act say nothing of their dose.

    Args:
        plan: of the search.
        done: existing records; those beyond the number of trials do not count.

    Raises:
        InputError: a record is of a unit that no search chooses, or the shams leave no dose to find.
    """

    first_cells = 1
    """Cells with which it begins: the sham."""

    def __init__(self, plan: BoundaryPlan, done: Sequence[Record] = ()) -> None:
        super().__init__()
        self.plan, self.total = plan, plan.trials
        self.grid: CurveGrid = curve_grid(plan.strengths)
        self._place = {cell: place for place, cell in enumerate(plan.dose_cells)} | {plan.sham_cell: SHAM}
        self._started: set[int] = set()
        self._chosen: tuple[int, list[int]] = (-1, [])
        for record in sorted(done, key=lambda r: r["index"]):
            if record["index"] in self._ended or (record["index"] < plan.shams) != (
                record["cell"] == plan.sham_cell
            ):
                raise InputError(
                    f"{record['cell']}:{record['index']}",
                    "is a unit of the ledger that no search chooses",
                    "choose a new folder",
                )
            self.finish(record)
        self._check_shams()

    def next(self, worker: str = "") -> UnitSpec | None:
        """The next trial; None while all of its batch run, and at the end.

        Raises:
            InputError: so many shams fail that the level is reached without stress, whatever the others do;
                or all are void.
        """
        self._check_shams()
        first = next((t for t in range(self.total) if t not in self._ended), None)
        if first is None:
            return None
        start, size = self._batch(first)
        for trial in range(start, min(start + size, self.total)):
            if trial not in self._ended and trial not in self._started:
                self._started.add(trial)
                place = self._places(start, size)[trial - start]
                cell = self.plan.sham_cell if place == SHAM else self.plan.dose_cells[place]
                return self.plan.spec.unit(cell, trial)
        return None

    def finish(self, record: Record) -> None:
        if record["index"] < self.total:
            self._ended[record["index"]] = record

    def outcomes(self, until: int | None = None) -> tuple[list[int], list[bool]]:
        """Dose and failure of every trial that has an outcome, of the first ``until`` or of all.

        Returns:
            Numbers of the doses, or SHAM, and whether it failed.
        """
        judged = [
            (self._place[record["cell"]], bool(record[self.plan.column]))
            for record in self.records()
            if record[self.plan.column] is not None
            and record["exposed"] is not False
            and (until is None or record["index"] < until)
        ]
        return [place for place, _ in judged], [failed for _, failed in judged]

    def posterior(self, until: int | None = None) -> Floats:
        """(G,) probability of every curve after the first ``until`` trials, or after all."""
        return self.grid.posterior(*self.outcomes(until))

    def _batch(self, trial: int) -> tuple[int, int]:
        """First trial and size of the batch of a trial."""
        shams, batch = self.plan.shams, self.plan.batch
        if trial < shams:
            return 0, shams
        return shams + (trial - shams) // batch * batch, batch

    def _places(self, start: int, size: int) -> list[int]:
        """Doses of a batch."""
        if start < self.plan.shams:
            return [SHAM] * size
        if self._chosen[0] != start:
            self._chosen = start, self.grid.choose(self.posterior(start), size)
        return self._chosen[1]

    def _check_shams(self) -> None:
        """Refuse the search as soon as its shams tell that no dose can be its answer."""
        plan = self.plan
        ended = [self._ended[trial] for trial in range(plan.shams) if trial in self._ended]
        places, failed = self.outcomes(plan.shams)
        look = f"see one by `dslab experiment replay DIR {plan.sham_cell}:0 --rerun unit.rrd`"
        if sum(r["outcome"] == Outcome.VOID for r in ended) == plan.shams:
            problem = f"all {plan.shams} trials without stress are void: {_commonest(ended, 'void_reason')}"
            remedy = f"{look}; mend the system, or search in another --spec or --world"
            raise InputError(plan.system, problem, remedy)
        # Those that may still be judged could all hold.
        if failed and sum(failed) >= plan.level * (plan.shams - len(ended) + len(places)):
            rate, why = sum(failed) / len(failed), _commonest(ended, "breakage_reason", "mission_cause")
            problem = f"{sum(failed)} of {len(failed)} trials fail without stress{why and f' ({why})'}"
            above = "" if rate == 1 else f"give --fail above {rate:.2g}, or "
            remedy = f"{above}mend the system or search in another --spec or --world; {look}"
            raise InputError(plan.system, problem, remedy)


def _commonest(records: Sequence[Record], *columns: str) -> str:
    """What most records say in the first of some columns that says anything."""
    for column in columns:
        if said := Counter(r[column] for r in records if r[column]):
            return said.most_common(1)[0][0].replace("_", " ")
    return ""
