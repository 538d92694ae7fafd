"""``dslab vocabulary``."""

from pathlib import Path
from typing import Annotated

import typer

from dslab.experiments.cli.console import progress_bars, say, single_threaded_opencv
from dslab.scenarios.errors import InputError

app = typer.Typer(no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Train the vocabulary of place recognition."""


@app.command("train")
def train_command(
    file: Annotated[Path, typer.Option("--out", help="The .npz file to write.", show_default=False)],
) -> None:
    """Render the training frames and train the vocabulary of the package.

    For example: `dslab vocabulary train --out vocabulary.npz`
    """
    from dslab.experiments.vocabulary import train
    from dslab.scenarios.input_files import is_folder

    if file.suffix != ".npz" or not is_folder(file.parent):
        raise InputError(f"--out {file}", "not an .npz file in an existing folder", "name one")
    single_threaded_opencv()
    with progress_bars() as show:
        vocabulary = train(progress=show)
    vocabulary.save(file)
    facts = vocabulary.provenance
    words = f"{vocabulary.n_words} words of {facts['descriptors']} descriptors of {facts['frames']} frames"
    say(f"{file}: {words}, {file.stat().st_size / 1e6:.2f} MB")
