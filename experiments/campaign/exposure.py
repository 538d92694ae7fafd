"""Trial draws of an experiment before it runs: does the stress of its units act?"""

from collections.abc import Callable
from typing import NamedTuple

from dslab.experiments.eq1.spec import ExperimentSpec

Progress = Callable[[str, int, int], None]

DRAWN_WORLDS = 10
"""Worlds of a trial draw: with fewer in a cell nothing is tested."""
LEAST_EXPOSED = 0.9
"""Share of a cell's draws in which its stress should act."""


class Drawn(NamedTuple):
    """A trial draw of one cell: its name, sequences whose stress acts, and all that were drawn."""

    cell: str
    acted: int
    drawn: int

    @property
    def is_exposed(self) -> bool:
        """True if its stress acts often enough."""
        return self.acted >= LEAST_EXPOSED * self.drawn


def draw_exposure(spec: ExperimentSpec, progress: Progress = lambda step, done, total: None) -> list[Drawn]:
    """Draw the first sequence of the first worlds of every cell with a stress, and see whether it acts.

    Nothing is drawn of an experiment with fewer worlds: whatever acts, it tests nothing.

    Args:
        spec: of the experiment.
        progress: called with a name, sequences drawn and sequences to draw.
    """
    from dslab.sim.stress_check import stress_acts

    cells = {cell.image: name for name, cell in spec.cells.items() if cell.dose is not None}
    if spec.worlds < DRAWN_WORLDS:
        return []
    acted = dict.fromkeys(cells.values(), 0)
    for number in range(DRAWN_WORLDS * len(cells)):
        world, cell = number // len(cells), list(acted)[number % len(cells)]
        acted[cell] += stress_acts(spec.unit(cell, world * spec.replicates_per_world).scenario)
        progress("drawing", number + 1, DRAWN_WORLDS * len(cells))
    return [Drawn(cell, count, DRAWN_WORLDS) for cell, count in acted.items()]
