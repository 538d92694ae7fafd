"""``dslab experiment merge``."""

from pathlib import Path
from typing import Annotated

import typer

from dslab.experiments.cli.console import out


def merge_command(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="Folders of one experiment, or of its exported table."),
    ],
    out_dir: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder that gets their units.")],
) -> None:
    """Add the units of other folders to the ledger of a folder, which a run goes on from.

    For an experiment that several machines run, one from the first world on and one from the last
    (`--last-first`), or of which only the exported table is left. A unit that two of them hold must have the
    same outcome in both. For example:

    `dslab experiment merge out/theirs --out out/mine`

    `dslab experiment merge docs/eq1 --out out/eq1`
    """
    from dslab.experiments.campaign.merge import merge

    done = merge(out_dir, sources)
    known = f", {done.known} were known with the same outcome" if done.known else ""
    out.print(f"{done.added} units added{known}: {done.done} of {done.total} in {out_dir}", soft_wrap=True)
