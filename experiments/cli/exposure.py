"""Cells whose stress seldom acts, told before a run."""

from pathlib import Path
from typing import TYPE_CHECKING

from dslab.experiments.cli.console import err, progress_bars

if TYPE_CHECKING:
    from dslab.experiments.eq1.spec import ExperimentSpec


def tell_idle_cells(spec: "ExperimentSpec", folder: Path) -> None:
    """Draw some worlds of an experiment that has not begun, and name the cells whose stress seldom acts."""
    from dslab.experiments.campaign.exposure import draw_exposure
    from dslab.experiments.jobs.ledger import LEDGER_FILE

    if (folder / LEDGER_FILE).exists():
        return
    with progress_bars(kernels=False) as progress:
        drawn = draw_exposure(spec, progress)
    for cell in drawn:
        if not cell.is_exposed:
            err.print(
                f"{cell.cell}: the stress acts in {cell.acted} of {cell.drawn} sequences drawn, the others "
                "would not count; give a stronger dose, or low_texture a view_share",
                soft_wrap=True,
                markup=False,
            )
