"""``dslab experiment exposure``, and what is told before a run of cells whose stress seldom acts."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dslab.experiments.cli.console import err, out, progress_bars

if TYPE_CHECKING:
    from dslab.experiments.eq1.spec import ExperimentSpec


def exposure_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with an exported table alone.")],
) -> None:
    """Find out in which units of an exported table the stress acted, where the table does not say.

    A unit counts for its cell only if its stress reached its own threshold on a frame. Tables of earlier
    versions do not say whether it did: their plans are made again, without any SLAM. For example:

    `dslab experiment exposure docs/eq1`
    """
    from dslab.experiments.campaign.exposure import fill_exposed

    with progress_bars() as progress:
        found = fill_exposed(folder, progress)
    unknown = f", of {found.unknown} it cannot be known" if found.unknown else ""
    out.print(
        f"the stress acted in {found.acted} units, in {found.idle} it did not{unknown}; "
        f"{found.looked} plans were made again",
        soft_wrap=True,
    )


def tell_idle_cells(spec: "ExperimentSpec", folder: Path) -> None:
    """Draw some worlds of an experiment that has not begun, and name the cells whose stress seldom acts."""
    from dslab.experiments.campaign.exposure import draw_exposure
    from dslab.experiments.jobs.ledger import LEDGER_FILE

    if (folder / LEDGER_FILE).exists():
        return
    with progress_bars() as progress:
        drawn = draw_exposure(spec, progress)
    for cell in drawn:
        if not cell.is_exposed:
            err.print(
                f"{cell.cell}: the stress acts in {cell.acted} of {cell.drawn} sequences drawn, the others "
                "would not count; give a stronger dose, or low_texture a view_share",
                soft_wrap=True,
                markup=False,
            )
