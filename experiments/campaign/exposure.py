"""Trial draws of an experiment before it runs: does the stress of its units act?"""

from collections.abc import Callable
from dataclasses import dataclass

from dslab.experiments.eq1.spec import ExperimentSpec

Progress = Callable[[str, int, int], None]

DRAWN_WORLDS = 10
"""Worlds of a trial draw: with fewer in a cell nothing is tested."""
LEAST_EXPOSED = 0.9
"""Share of a cell's draws in which its stress should act."""


@dataclass(frozen=True)
class Drawn:
    """A trial draw of one cell.

    Attributes:
        cell: its name.
        acted, drawn: sequences whose stress acts, and all that were drawn.
    """

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
    worlds = range(DRAWN_WORLDS if spec.worlds >= DRAWN_WORLDS else 0)
    acted = dict.fromkeys(cells.values(), 0)
    for world in worlds:
        for number, cell in enumerate(cells.values()):
            acted[cell] += stress_acts(spec.unit(cell, world * spec.replicates_per_world).scenario)
            progress("drawing", world * len(cells) + number + 1, len(worlds) * len(cells))
    return [Drawn(cell, acted[cell], len(worlds)) for cell in acted] if worlds else []
