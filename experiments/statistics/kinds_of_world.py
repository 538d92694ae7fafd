"""Eq. 1 per kind of world, with worlds as the sample."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from experiments.eq1.records import Outcome, dual_column, thread_column
from experiments.statistics.products import product_of_distinct


@dataclass(frozen=True)
class WorldShare:
    """A share over units whose interval rests on worlds.

    Attributes:
        value: mean over worlds of the share within a world.
        low, high: ends of the interval; None for fewer than two worlds.
        units, worlds: number of rows and of their worlds.
    """

    value: float
    low: float | None
    high: float | None
    units: int
    worlds: int


@dataclass(frozen=True)
class KindOfWorld:
    """Counts of one cell in one kind of world.

    Attributes:
        cell: name of the cell.
        world: kind of the world.
        units, worlds: number of completed rows, and of their worlds.
        breakages: units with a breakage.
        crossing_failures: per thread, units in which it failed to cross.
        dual_failures: per n, units with a dual failure.
        silent: units with a silent failure.
    """

    cell: str
    world: str
    units: int
    worlds: int
    breakages: int
    crossing_failures: tuple[int, ...]
    dual_failures: tuple[int, ...]
    silent: int


@dataclass(frozen=True)
class PooledLevel:
    """Eq. 1 with n threads over all cells, cells weighted by their units.

    Attributes:
        n: number of recovery threads.
        measured: share of units with a dual failure in the free arm.
        predicted_by_cell: p0 · Π pr of each cell, over distinct rows; None if a cell has too few.
        predicted_by_kind: the same of each cell and kind of world.
        predicted_interval: ends of the interval of predicted_by_kind; None where the worlds do not give one.
    """

    n: int
    measured: WorldShare
    predicted_by_cell: float | None
    predicted_by_kind: float | None
    predicted_interval: tuple[float, float] | None


@dataclass(frozen=True)
class KindsOfWorld:
    """Figures of a table by kind of world.

    Attributes:
        kinds: kinds of world in the table.
        mixed: cells with more than one kind of world.
        worlds, units: number of worlds, and of completed rows.
        levels: per n.
        failed_or_silent: share of units with a dual failure of all threads or a silent failure.
        silent: share of unbroken units with a silent failure.
        rows: per cell and kind.
    """

    kinds: tuple[str, ...]
    mixed: tuple[str, ...]
    worlds: int
    units: int
    levels: tuple[PooledLevel, ...]
    failed_or_silent: WorldShare | None
    silent: WorldShare | None
    rows: tuple[KindOfWorld, ...]


def kinds_of_world(table: pd.DataFrame, threads: int, confidence: float = 0.95) -> KindsOfWorld:
    """Analyse a table by kind of world.

    Args:
        table: records, with the columns of ``records.columns``.
        threads: number of recovery threads.
        confidence: of the intervals.
    """
    done = table[table["outcome"] == Outcome.COMPLETED]
    truths = _truths(done, threads)
    kinds_in = done.groupby("cell", sort=False)["world"].nunique()
    last = truths[f"d{threads}"] if threads else np.zeros(len(done), bool)
    unbroken = ~truths["b"]
    return KindsOfWorld(
        kinds=tuple(sorted(done["world"].dropna().unique())),
        mixed=tuple(str(cell) for cell in kinds_in.index[kinds_in > 1]),
        worlds=int(done["world_seed"].nunique()),
        units=len(done),
        levels=tuple(_level(done, truths, n, confidence) for n in range(1, threads + 1)) if len(done) else (),
        failed_or_silent=share_by_world(last | truths["silent"], done["world_seed"], confidence),
        silent=share_by_world(truths["silent"][unbroken], done["world_seed"][unbroken], confidence),
        rows=tuple(
            _counts(str(of_cell["cell"].iloc[0]), str(of_cell["world"].iloc[0]), of_cell, threads)
            for _, of_cell in done.groupby(["cell", "world"], sort=False)
        ),
    )


def share_by_world(
    happened: np.ndarray | pd.Series, world: pd.Series, confidence: float = 0.95
) -> WorldShare | None:
    """A share with worlds as the sample: Wilson's interval at the effective number of units.

    Args:
        happened: (R,) bool.
        world: (R,) the world of each row.
        confidence: of the interval.

    Returns:
        None without rows.

    Source: Wilson 1927; the effective sample size of a cluster sample, Kish, "Survey sampling", 1965.
    """
    flags = np.asarray(happened, float)
    if not len(flags):
        return None
    means = pd.Series(flags).groupby(np.asarray(world)).mean().to_numpy()
    worlds, value = len(means), float(means.mean())
    if worlds < 2:
        return WorldShare(value, None, None, len(flags), worlds)
    variance = float(means.var(ddof=1))
    effective = value * (1 - value) * worlds / variance if variance > 0 else float(worlds)
    z = float(stats.t.ppf((1 + confidence) / 2, worlds - 1))
    centre = (value + z**2 / (2 * effective)) / (1 + z**2 / effective)
    half = z * np.sqrt(value * (1 - value) / effective + z**2 / (4 * effective**2)) / (1 + z**2 / effective)
    # The ends at a share of 0 or 1 are exact but for rounding.
    low, high = min(max(0.0, float(centre - half)), value), max(min(1.0, float(centre + half)), value)
    return WorldShare(value, low, high, len(flags), worlds)


def _truths(done: pd.DataFrame, threads: int) -> dict[str, np.ndarray]:
    names = {"b": "breakage", "silent": "silent_failure"}
    for n in range(1, threads + 1):
        names |= {f"r{n}": thread_column("cross", n, "failed"), f"d{n}": dual_column(n)}
    return {name: done[column].fillna(False).to_numpy(bool) for name, column in names.items()}


def _level(done: pd.DataFrame, truths: dict[str, np.ndarray], n: int, confidence: float) -> PooledLevel:
    columns = np.stack([truths["b"], *(truths[f"r{j}"] for j in range(1, n + 1))], axis=1)
    measured = share_by_world(truths[f"d{n}"], done["world_seed"], confidence)
    if measured is None:
        raise ValueError("no completed unit")
    by_cell, by_kind = (_predicted(done, columns, keys) for keys in (["cell"], ["cell", "world"]))
    return PooledLevel(n, measured, by_cell, by_kind, _jackknife(done, columns, by_kind, confidence))


def _jackknife(
    done: pd.DataFrame, columns: np.ndarray, by_kind: float | None, confidence: float
) -> tuple[float, float] | None:
    """Interval of Eq. 1 of each cell and kind of world, each world left out in turn.

    Returns:
        None for fewer than two worlds, or where leaving one out leaves too few rows or changes nothing.

    Source: Tukey, "Bias and confidence in not quite large samples", Annals of Mathematical Statistics 1958.
    """
    world = done["world_seed"].to_numpy()
    worlds = np.unique(world)
    if by_kind is None or len(worlds) < 2:
        return None
    left = [_predicted(done[world != w], columns[world != w], ["cell", "world"]) for w in worlds]
    if any(value is None for value in left):
        return None
    pseudo = len(worlds) * by_kind - (len(worlds) - 1) * np.array(left, float)
    half = float(
        stats.t.ppf((1 + confidence) / 2, len(worlds) - 1) * pseudo.std(ddof=1) / np.sqrt(len(worlds))
    )
    if half == 0:
        return None
    return min(max(by_kind - half, 0.0), by_kind), max(min(by_kind + half, 1.0), by_kind)


def _predicted(done: pd.DataFrame, columns: np.ndarray, keys: list[str]) -> float | None:
    """Eq. 1 of each group, weighted by its units."""
    total = 0.0
    for places in done.groupby(keys, sort=False).indices.values():
        product = float(product_of_distinct(columns[places].T.astype(float)))
        if np.isnan(product):
            return None
        total += len(places) * product
    return total / len(done)


def _counts(cell: str, kind: str, rows: pd.DataFrame, threads: int) -> KindOfWorld:
    truths = _truths(rows, threads)
    return KindOfWorld(
        cell=cell,
        world=kind,
        units=len(rows),
        worlds=int(rows["world_seed"].nunique()),
        breakages=int(truths["b"].sum()),
        crossing_failures=tuple(int(truths[f"r{j}"].sum()) for j in range(1, threads + 1)),
        dual_failures=tuple(int(truths[f"d{j}"].sum()) for j in range(1, threads + 1)),
        silent=int(truths["silent"].sum()),
    )
