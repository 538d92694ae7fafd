"""``dslab vocabulary``."""

from pathlib import Path
from typing import Annotated

import typer

from dslab.experiments.cli.console import err, out, progress_bars, single_threaded_opencv

app = typer.Typer(help="Train and show the vocabulary of place recognition.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Train and show the vocabulary of place recognition."""


@app.command("train")
def train_command(
    file: Annotated[Path, typer.Option("--out", help="The .npz file to write.", show_default=False)],
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of each training scenario.")] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the clustering.")] = 0,
    cache: Annotated[
        Path | None,
        typer.Option(help="Folder that keeps the rendered frames; default: none.", show_default=False),
    ] = None,
) -> None:
    """Render the training frames and train the vocabulary of the package.

    For example: `dslab vocabulary train --out vocabulary.npz`
    """
    from dslab.experiments.vocabulary import train, training_scenarios
    from dslab.scenarios.errors import InputError
    from dslab.scenarios.input_files import is_folder

    if file.suffix != ".npz" or not is_folder(file.parent):
        raise InputError(f"--out {file}", "not an .npz file in an existing folder", "name one")
    single_threaded_opencv()
    with progress_bars() as show:
        vocabulary = train(training_scenarios(), seeds, seed, cache_dir=cache, progress=show)
    vocabulary.save(file)
    facts = vocabulary.provenance
    err.print(f"trained on {facts['descriptors']} descriptors of {facts['frames']} frames")
    out.print(f"{vocabulary.n_words} words, {file.stat().st_size / 1e6:.2f} MB in {file}")


@app.command("show")
def show_command(
    file: Annotated[
        Path | None, typer.Argument(help="An .npz file; default: the one of the package.")
    ] = None,
) -> None:
    """Print the training data of a vocabulary as JSON.

    Example: `dslab vocabulary show`
    """
    from dslab.experiments.cli.console import print_json_line
    from dslab.scenarios.errors import InputError
    from dslab.scenarios.input_files import open_file
    from dslab.slam.places.recognition import VOCABULARY_FILE, Vocabulary

    path = file or VOCABULARY_FILE
    open_file(path).close()
    try:
        vocabulary = Vocabulary.load(path)
    except (OSError, ValueError) as error:
        raise InputError(str(path), "not a vocabulary", "make one: dslab vocabulary train") from error
    print_json_line({"words": vocabulary.n_words, **vocabulary.provenance})
