"""Outcomes of homogeneous cells from a table of records: one kind of world per cell, worlds kept apart."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from dslab.experiments.eq1.records import SHAM, Outcome, dual_column, thread_column
from dslab.experiments.statistics.outcomes import Floats, Outcomes


@dataclass(frozen=True)
class HomogeneousCell:
    """One cell of the table in one kind of world.

    Attributes:
        name: of the cell.
        world: kind of the world.
        worlds: (W,) seeds of the worlds, increasing.
        threads: number n of recovery threads.
        rows: its records, completed or void.
        place: (rows,) world, sequence and replicate of each row.
        shape: W, S, K.
        exposed: its figures are of the units whose stress acted; False: of the others.
    """

    name: str
    world: str
    worlds: np.ndarray
    threads: int
    rows: pd.DataFrame
    place: tuple[np.ndarray, np.ndarray, np.ndarray]
    shape: tuple[int, int, int]
    exposed: bool = True

    @property
    def kind(self) -> str:
        """Kind of its degradation, ``sham`` for none."""
        return str(self.rows["kind"].iloc[0])

    @property
    def setting(self) -> str:
        """What of its name is neither degradation nor dose: base and system, empty with one of each."""
        parts = self.name.split("/")
        at = parts.index(self.kind) if self.kind in parts else 0
        return "/".join([*parts[:at], *parts[at + (1 if self.kind == SHAM else 2) :]])

    @property
    def severity(self) -> float:
        """Its dose, in the measure of the records."""
        return float(self.rows["severity"].iloc[0])

    @cached_property
    def counted(self) -> np.ndarray:
        """(rows,) units that its figures are of: not void, and exposed as the cell is."""
        return self._completed & (self._exposed == self.exposed)

    @property
    def units(self) -> int:
        """Number of counted units."""
        return int(self.counted.sum())

    @property
    def void(self) -> int:
        """Number of void units."""
        return int((~self._completed).sum())

    @property
    def unexposed(self) -> int:
        """Number of units that are not void, whose stress did not act."""
        return int((self._completed & ~self._exposed).sum())

    @cached_property
    def _completed(self) -> np.ndarray:
        return (self.rows["outcome"] == Outcome.COMPLETED).to_numpy(bool)

    @cached_property
    def _exposed(self) -> np.ndarray:
        """(rows,) false where the stress is known not to have acted."""
        return is_exposed(self.rows).to_numpy(bool)

    def says(self, *columns: str) -> bool:
        """True if the counted records know each of these columns."""
        rows = self.rows.loc[self.counted]
        return all(name in rows and bool(rows[name].notna().any()) for name in columns)

    def values(self, column: str) -> Floats:
        """(W, S, K) a column of numbers or booleans; NaN for null, not counted or missing."""
        return self.grid(pd.to_numeric(self.rows[column]).to_numpy(float, na_value=np.nan))

    def events(self, column: str) -> Floats:
        """(W, S, K) an event of 0 or 1, null counting as 0; NaN for a unit that is not counted or missing."""
        return self.grid(self.rows[column].fillna(False).to_numpy(float))

    def events_said(self, column: str) -> Floats | None:
        """The same; None where the records do not say."""
        return self.events(column) if self.says(column) else None

    def grid(self, by_row: Floats) -> Floats:
        """(W, S, K) values of the counted among the (rows,), NaN elsewhere."""
        found = np.full(self.shape, np.nan)
        found[self.place] = np.where(self.counted, by_row, np.nan)
        return found

    @cached_property
    def outcomes(self) -> Outcomes:
        """The outcomes that Eq. 1 relates."""
        numbers = range(1, self.threads + 1)
        return Outcomes(
            self.events("breakage"),
            np.stack([self.events(thread_column("cross", n, "failed")) for n in numbers]),
            np.stack([self.events(dual_column(n)) for n in numbers]),
            [(self.world, int(seed)) for seed in self.worlds],
        )

    def usable(self, n: int) -> Outcomes:
        """Outcomes with the first n threads, of the sequences with enough replicates and their worlds."""
        return self.outcomes.of_first(n).with_units()


def is_exposed(table: pd.DataFrame) -> pd.Series:
    """False for the records whose stress is known not to have acted: another population than its cell's."""
    return pd.Series(table["exposed"].astype("boolean").fillna(True).to_numpy(bool), index=table.index)


def cells_of(
    table: pd.DataFrame, threads: int, sham: bool = False, exposed: bool = True
) -> list[HomogeneousCell]:
    """The cells of a table, each split by kind of world, in the order of the table.

    Args:
        table: records, with the columns of ``records.columns``.
        threads: number n of recovery threads.
        sham: the sham cells instead of those with a dose.
        exposed: of the units whose stress acted, or has none; False: of those whose stress did not.
    """
    counted = (table["outcome"] != Outcome.INFRASTRUCTURE_ERROR) & ((table["kind"] == SHAM) == sham)
    table = table.loc[counted.fillna(False).to_numpy(bool)]
    names = table[["cell", "world"]].drop_duplicates()
    table = table.sort_values(["world_seed", "index"], kind="stable")
    found = []
    for cell, world in names.itertuples(index=False):
        rows = table[(table["cell"] == cell) & (table["world"] == world)]
        seeds, place = np.unique(rows["world_seed"].to_numpy(np.int64), return_inverse=True)
        sequence, repeat = (rows[name].to_numpy(int) for name in ("sequence", "repeat"))
        shape = (len(seeds), int(sequence.max()) + 1, int(repeat.max()) + 1)
        at = (place, sequence, repeat)
        found.append(HomogeneousCell(str(cell), str(world), seeds, threads, rows, at, shape, exposed))
    return found
