"""Is pr = p0, or less: the base forward against the threads of Algorithm 1 backward, by worlds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dslab.experiments.eq1.records import thread_column
from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.from_records import HomogeneousCell
from dslab.experiments.statistics.outcomes import Floats
from dslab.experiments.statistics.pooled import by_world
from dslab.experiments.statistics.verdicts import holm
from dslab.experiments.statistics.world_intervals import Interval, difference_interval, share_interval


@dataclass(frozen=True)
class BothWays:
    """An event of the base forward and one of a thread backward, over the same units.

    Attributes:
        forward, backward: their shares, means over worlds.
        difference: of the two, forward minus backward.
        p: two-sided, that it is 0, by Holm over all kinds, kinds of world and threads.
    """

    forward: Interval
    backward: Interval
    difference: Interval
    p: float


@dataclass(frozen=True)
class Direction:
    """pr against p0 in one kind of degradation and of world, by two readings of what fails.

    Attributes:
        thread: its number.
        kind, world: which ones.
        worlds: their number.
        declared: B, and that the thread gets lost on its way.
        with_silent: B or a silent failure, and that the thread fails in any way: on its way, in the fusion or
            by the audit.
    """

    thread: int
    kind: str
    world: str
    worlds: int
    declared: BothWays
    with_silent: BothWays


def directions(cells: Sequence[HomogeneousCell], threads: Sequence[int]) -> tuple[Direction, ...]:
    """Compare p0 and pr over the doses of each kind; a unit without a new map to go back from is left out."""
    found = [each for thread in threads for each in _of_thread(cells, thread)]
    told = [_both_ways([each[name] for *_, each in found]) for name in ("declared", "with_silent")]
    return tuple(Direction(*of, *readings) for (*of, _), *readings in zip(found, *told, strict=True))


def _both_ways(means: Sequence[tuple[Floats, Floats]]) -> list[BothWays]:
    """(W,) means of worlds forward and backward, each with intervals and its corrected p."""
    differences = [Figure.mean(forward - backward) for forward, backward in means]
    corrected = holm([figure.p for figure in differences])
    return [
        BothWays(share_interval(forward), share_interval(backward), difference_interval(figure), float(p))
        for (forward, backward), figure, p in zip(means, differences, corrected, strict=True)
    ]


def _of_thread(
    cells: Sequence[HomogeneousCell], thread: int
) -> list[tuple[int, str, str, int, dict[str, tuple[Floats, Floats]]]]:
    failed, stage = (thread_column("cross", thread, name) for name in ("failed", "stage"))
    found = []
    for kind, world in dict.fromkeys((c.kind, c.world) for c in cells if c.says(failed)):
        own = [cell for cell in cells if (cell.kind, cell.world) == (kind, world)]
        events: dict[str, list[Floats]] = {}
        for cell in own:
            stages = cell.rows[stage].fillna("").astype(str).to_numpy()
            begun = cell.grid(np.where(stages == "no_reinit", np.nan, 1.0))
            for name, event in {
                "breaks": cell.outcomes.breakage,
                "breaks or is wrong": np.maximum(cell.outcomes.breakage, cell.events("silent_failure")),
                "gets lost": cell.grid((stages == "propagation").astype(float)),
                "fails": cell.events(failed),
            }.items():
                events.setdefault(name, []).append(event * begun)
        means = {name: by_world(own, grids) for name, grids in events.items()}
        if (worlds := len(means["breaks"])) > 2:
            readings = {
                "declared": (means["breaks"], means["gets lost"]),
                "with_silent": (means["breaks or is wrong"], means["fails"]),
            }
            found.append((thread, kind, world, worlds, readings))
    return found
