"""Outcomes of the cells of a table of records."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from experiments.eq1.records import SHAM, Outcome, dual_column, failure_column, thread_column
from experiments.statistics.outcomes import Floats, Outcomes


@dataclass(frozen=True)
class HomogeneousCell:
    """One cell of the table in one kind of world.

    Attributes:
        name: of the cell.
        world: kind of the world.
        worlds: (W,) seeds of the worlds, increasing.
        outcomes: of its units; a unit that is void or missing is NaN.
        silent: (W, S, K) silent failure of each unit.
        system_failures, mission_failures: (n, W, S, K) S_J and M_J for the first 1 to n threads; None where
            the records do not say.
        base_missions: (W, S, K) mission failure of the base; None likewise.
        units, void: number of completed and of void units.
    """

    name: str
    world: str
    worlds: np.ndarray
    outcomes: Outcomes
    silent: Floats
    system_failures: Floats | None
    mission_failures: Floats | None
    base_missions: Floats | None
    units: int
    void: int


def cells_of(table: pd.DataFrame, threads: int) -> list[HomogeneousCell]:
    """The cells of a table, each split by kind of world, in the order of the table.

    Records of earlier versions do not say of which sequence they are: of these the units of a world count as
    sequences of one replicate, in the order of their numbers, which are the same lead-ins in every cell.
    Sham cells are left out.

    Args:
        table: records, with the columns of ``records.columns``.
        threads: number n of recovery threads.
    """
    found = []
    numbers = range(1, threads + 1)
    counted = (table["outcome"] != Outcome.INFRASTRUCTURE_ERROR) & (table["kind"] != SHAM)
    table = table.loc[counted.fillna(False).to_numpy(bool)]
    table = table.sort_values(["world_seed", "index"], kind="stable")
    names = table[["cell", "world"]].loc[table.index.sort_values()].drop_duplicates()
    for cell, world in names.itertuples(index=False):
        rows = table[(table["cell"] == cell) & (table["world"] == world)]
        seeds = np.unique(rows["world_seed"])
        place = np.searchsorted(seeds, rows["world_seed"])
        sequence, repeat = rows.groupby("world_seed").cumcount().to_numpy(), np.zeros(len(rows), int)
        if "sequence" in rows and bool(rows["sequence"].notna().to_numpy().all()):
            sequence, repeat = (rows[name].to_numpy(int) for name in ("sequence", "repeat"))
        completed = (rows["outcome"] == Outcome.COMPLETED).to_numpy()
        shape = (len(seeds), int(sequence.max()) + 1, int(repeat.max()) + 1)

        def outcome(
            column: str, rows=rows, at=(place, sequence, repeat), done=completed, shape=shape
        ) -> Floats:
            values = np.full(shape, np.nan)
            values[at] = np.where(done, rows[column].fillna(False).astype(float), np.nan)
            return values

        outcomes = Outcomes(
            outcome("breakage"),
            np.stack([outcome(thread_column("cross", n, "failed")) for n in numbers]),
            np.stack([outcome(dual_column(n)) for n in numbers]),
        )

        def failures(failure: Literal["s", "m"], rows=rows, of=outcome) -> Floats | None:
            columns = [failure_column(failure, n) for n in numbers]
            said = all(name in rows and bool(rows[name].notna().to_numpy().any()) for name in columns)
            return np.stack([of(name) for name in columns]) if said else None

        base = "base_mission_failure"
        units = int(completed.sum())
        found.append(
            HomogeneousCell(
                str(cell),
                str(world),
                seeds,
                outcomes,
                outcome("silent_failure"),
                failures("s"),
                failures("m"),
                outcome(base) if base in rows and bool(rows[base].notna().to_numpy().any()) else None,
                units,
                len(rows) - units,
            )
        )
    return found
