"""Systems beside each other in the free arm, on the same units: shares of each, and paired tests."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
import pandas as pd

from dslab.experiments.eq1.records import SHAM, failure_column, thread_column
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.from_records import HomogeneousCell, cells_of
from dslab.experiments.statistics.judged import share_by_world, share_of_part
from dslab.experiments.statistics.outcomes import Floats
from dslab.experiments.statistics.verdicts import holm
from dslab.experiments.statistics.world_intervals import Interval, difference_interval

_EXACT = 13
"""Worlds up to which every exchange is tried; of more, some are drawn."""
_EXCHANGES = 9999
_TINY = 1e-12


@dataclass(frozen=True)
class SystemShares:
    """One system in one condition: a point of its dose-response.

    Attributes:
        system, cell, world, kind, severity: which one; the sham's severity is 0.
        image: the condition, which cells of several systems have in common.
        worlds, units, void, unexposed: their numbers; units are those that the shares are of.
        declares: what its runs say of themselves: with ``nothing`` B is true loss by the audit.
        shares: of the units: ``breakage``, ``system_failure``, ``mission_failure``; of the unbroken ones
            ``silent_failure``. Those that are known.
    """

    system: str
    cell: str
    image: str
    world: str
    kind: str
    severity: float
    worlds: int
    units: int
    void: int
    unexposed: int
    declares: tuple[str, ...]
    shares: dict[str, Interval]


@dataclass(frozen=True)
class PairedDifference:
    """How much more often one system fails than another, of the units that both completed.

    Attributes:
        first, second, world: which.
        failure: by its name in SystemShares; silent ones of all units.
        image: the condition; empty for the mean over all with a dose.
        worlds, units: their numbers.
        left_out: units that only one of the two completed.
        only_first, only_second: units in which only that one failed.
        difference: share of the first minus that of the second, worlds weighted alike.
        interval: of the difference; None with a single world, or where all worlds are alike.
        p: two-sided, that worlds tell no system from the other, by Holm; None for a single condition, which
            is not tested.
    """

    first: str
    second: str
    failure: str
    world: str
    image: str
    worlds: int
    units: int
    left_out: int
    only_first: int
    only_second: int
    difference: float
    interval: Interval | None
    p: float | None = None


@dataclass(frozen=True)
class Gain:
    """What Dual-SLAM over a system gains in one condition.

    Attributes:
        missions: failed missions of the system alone against those with Dual-SLAM over it. Its p is by Holm
            over all gains under stress.
        fails, fails_with: their numbers, alone and with it.
        breakages: of the units with it, and ``rescuable`` those of them that images can recover at all.
        recovered: of the rescuable, by a thread that is right.
        joins: units in which a thread declares success, and ``false`` those in which one is wrong.
    """

    missions: PairedDifference
    fails: int
    fails_with: int
    breakages: int
    rescuable: int
    recovered: int
    joins: int
    false: int


@dataclass(frozen=True)
class Systems:
    """Systems beside each other.

    Attributes:
        shares: per cell and kind of world, shams among them.
        over_doses: per two systems, failure and kind of world, over all conditions with a dose.
        per_condition: likewise in each condition.
        gains: of systems that stand beside Dual-SLAM over them, in each condition.
    """

    shares: tuple[SystemShares, ...]
    over_doses: tuple[PairedDifference, ...]
    per_condition: tuple[PairedDifference, ...]
    gains: tuple[Gain, ...]


def compare_systems(
    table: pd.DataFrame, threads: int, systems: Mapping[str, str], images: Mapping[str, str], seed: int = 0
) -> Systems:
    """Compare the systems of a table of records.

    Args:
        table: records, with the columns of ``records.columns``.
        threads: number of recovery threads of the experiment.
        systems: of each cell.
        images: of each cell, its condition.
        seed: of the exchanges.
    """
    cells = [cell for sham in (False, True) for cell in cells_of(table, threads, sham)]
    columns = _columns(threads)
    rng = np.random.default_rng(seed)
    placed = {(systems[cell.name], images[cell.name], cell.world): cell for cell in cells}
    pooled: list[PairedDifference] = []
    tests: list[float] = []
    single: list[PairedDifference] = []
    gains: list[Gain] = []
    gain_tests: list[float] = []
    names, worlds = dict.fromkeys(systems.values()), dict.fromkeys(cell.world for cell in cells)
    for world, (first, second), failure in product(worlds, combinations(names, 2), columns):
        pairs = []
        for image in dict.fromkeys(images[cell.name] for cell in cells):
            both = [cell for system in (first, second) if (cell := placed.get((system, image, world)))]
            pair = _paired(both, columns[failure]) if len(both) == 2 else pd.DataFrame()
            if len(pair) and pair.difference.notna().any():
                single.append(_difference([pair], first, second, failure, world, image))
                if failure == "mission_failure" and both[0].kind != SHAM and is_over(second, first):
                    gains.append(_gain(single[-1], pair, both[1], threads))
                    gain_tests.append(exchange_test(_by_world([pair]), rng))
                if both[0].kind != SHAM:
                    pairs.append(pair)
        if pairs:
            tests.append(exchange_test(_by_world(pairs), rng))
            pooled.append(_difference(pairs, first, second, failure, world, ""))
    return Systems(
        tuple(
            _shares(cell, systems[cell.name], images[cell.name], columns) for cell in cells if len(cell.rows)
        ),
        tuple(replace(pair, p=float(p)) for pair, p in zip(pooled, holm(tests), strict=True)),
        tuple(single),
        tuple(
            replace(gain, missions=replace(gain.missions, p=float(p)))
            for gain, p in zip(gains, holm(gain_tests), strict=True)
        ),
    )


def is_over(name: str, system: str) -> bool:
    """True if ``name`` is Dual-SLAM over a system, whatever its recoveries are."""
    return name.startswith("dual(") and name[len("dual(") : -1].split(",", maxsplit=1)[0] == system


def exchange_test(by_world: Floats, rng: np.random.Generator) -> float:
    """P-value that two systems are alike: their names are exchanged in whole worlds.

    Args:
        by_world: (W,) mean difference of each world.
        rng: stream of the exchanges, with more than a few worlds.

    Source: Fisher, "The Design of Experiments", 1935, Sec. 21.
    """
    worlds = len(by_world)
    if worlds <= _EXACT:
        signs = 1.0 - 2.0 * (np.arange(2**worlds)[:, None] >> np.arange(worlds) & 1)
    else:
        drawn = rng.choice([-1.0, 1.0], (_EXCHANGES, worlds))
        signs = np.concatenate([np.ones((1, worlds)), drawn])
    sums = np.abs(signs @ by_world)
    return float(np.mean(sums >= sums[0] - _TINY))


def _columns(threads: int) -> dict[str, str]:
    """Columns of the failures, by their names."""
    return {
        "breakage": "breakage",
        "silent_failure": "silent_failure",
        "system_failure": failure_column("s", threads),
        "mission_failure": failure_column("m", threads),
    }


def _shares(cell: HomogeneousCell, system: str, image: str, columns: Mapping[str, str]) -> SystemShares:
    events = {name: cell.values(column) for name, column in columns.items() if cell.says(column)}
    silent = events.pop("silent_failure", None)
    shares = {name: share_by_world(event) for name, event in events.items()}
    if silent is not None:
        shares["silent_failure"] = share_of_part(silent, np.where(cell.events("breakage") == 0, 1.0, 0.0))
    declares = cell.rows.loc[cell.counted, "declares"].dropna()
    return SystemShares(
        system=system,
        cell=cell.name,
        image=image,
        world=cell.world,
        kind=cell.kind,
        severity=0.0 if cell.kind == SHAM else cell.severity,
        worlds=len(cell.worlds),
        units=cell.units,
        void=cell.void,
        unexposed=cell.unexposed,
        declares=tuple(sorted(set(map(str, declares)))),
        shares={name: share for name, share in shares.items() if share is not None},
    )


def _paired(both: Sequence[HomogeneousCell], column: str) -> pd.DataFrame:
    """The units that two cells have in common: world, sequence, difference (NaN where one is not known)."""
    sides = [
        pd.DataFrame(
            {
                "index": cell.rows["index"].to_numpy(int),
                "world": cell.rows["world_seed"].to_numpy(np.int64),
                "sequence": cell.rows["sequence"].to_numpy(int),
                "completed": cell.counted,
                "event": cell.rows[column].astype("Float64").to_numpy(float, na_value=np.nan),
            }
        )
        for cell in both
    ]
    joined = sides[0].merge(sides[1], on=["index", "world", "sequence"], suffixes=("_1", "_2"))
    joined["difference"] = (joined.event_1 - joined.event_2).where(joined.completed_1 & joined.completed_2)
    return joined


def _by_world(pairs: Sequence[pd.DataFrame]) -> Floats:
    """(W,) mean difference of each world: over conditions, sequences and replicates, weighted alike."""
    means = [pair.groupby(["world", "sequence"]).difference.mean() for pair in pairs]
    by_world = pd.concat([mean.groupby("world").mean() for mean in means]).groupby("world").mean()
    return by_world.dropna().to_numpy(float)


def _difference(pairs: Sequence[pd.DataFrame], *about: str) -> PairedDifference:
    by_world = _by_world(pairs)
    figure, units = Figure.mean(by_world), pd.concat(pairs)
    return PairedDifference(
        *about,
        worlds=len(by_world),
        units=int(units.difference.notna().sum()),
        left_out=int((units.completed_1 != units.completed_2).sum()),
        only_first=int((units.difference > 0).sum()),
        only_second=int((units.difference < 0).sum()),
        difference=figure.value,
        interval=difference_interval(figure) if len(by_world) > 1 and figure.error else None,
    )


def _gain(missions: PairedDifference, pair: pd.DataFrame, over: HomogeneousCell, threads: int) -> Gain:
    both = pair[pair.difference.notna()]
    rows = over.rows.loc[over.counted]

    def says(name: str) -> np.ndarray:
        return _true(rows[[thread_column("free", j, name) for j in range(1, threads + 1)]])

    broke, rescuable, joined = _true(rows["breakage"]), _true(rows["rescuable"]), says("declared")
    right = (joined & ~says("failed")).any(axis=1)
    return Gain(
        missions,
        fails=int(both.event_1.sum()),
        fails_with=int(both.event_2.sum()),
        breakages=int(broke.sum()),
        rescuable=int((broke & rescuable).sum()),
        recovered=int((broke & rescuable & right).sum()),
        joins=int(joined.any(axis=1).sum()),
        false=int((joined & says("false")).any(axis=1).sum()),
    )


def _true(known: pd.Series | pd.DataFrame) -> np.ndarray:
    """Where something is known and true."""
    return known.astype("boolean").fillna(value=False).to_numpy(bool)
