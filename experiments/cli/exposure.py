"""``dslab experiment exposure``."""

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.console import out, progress_bars


def exposure_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with an exported table alone.")],
) -> None:
    """Find out in which units of an exported table the stress acted, where the table does not say.

    A unit counts for its cell only if its stress reached its own threshold on a frame. Tables of earlier
    versions do not say whether it did: their plans are made again, without any SLAM. For example:

    `dslab experiment exposure docs/eq1`
    """
    from experiments.campaign.exposure import fill_exposed

    with progress_bars() as progress:
        found = fill_exposed(folder, progress)
    unknown = f", of {found.unknown} it cannot be known" if found.unknown else ""
    out.print(
        f"the stress acted in {found.acted} units, in {found.idle} it did not{unknown}; "
        f"{found.looked} plans were made again",
        soft_wrap=True,
    )
