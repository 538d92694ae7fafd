"""``dslab footage``."""

from typing import Annotated

import typer

from dslab.experiments.cli.console import (
    FolderOption,
    JsonOption,
    SeedOption,
    print_json_line,
    print_rows,
    progress_bars,
    say,
    single_threaded_opencv,
)


def footage_command(
    sources: Annotated[
        list[str],
        typer.Argument(
            help="Sequence folders, scenarios' names or their YAML files; the first is the reference.",
            metavar="SOURCE...",
        ),
    ],
    out_dir: FolderOption,
    seed: SeedOption = None,
    frames: Annotated[
        int | None, typer.Option(min=10, metavar="N", help="Only the first N frames of each sequence.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare sequences in what the tracker meets: matches, residuals, tracks, images.

    Runs the base over each; writes footage.png with the distributions, and footage.json. They hold statistics
    only, no frame. For example:

    `dslab footage path/to/drive real/drive kitti-like/03 --out out/drives`
    """
    from dslab.experiments.realism.compare import PICTURE_FILE, compare_footage
    from dslab.experiments.realism.measures import MEASURES

    single_threaded_opencv()
    with progress_bars() as show:
        content = compare_footage(sources, out_dir, seed, frames, show)
    if as_json:
        print_json_line(content)
        return

    def cell(source: str, name: str) -> str | None:
        found = content[source]["measures"][name]
        if found["quantiles"] is None:
            return None
        apart = "" if source == sources[0] or found["distance"] is None else f" ({found['distance']:.2f})"
        return f"{found['quantiles'][2]:.3g}{apart}"

    print_rows({"measure": name} | {s: cell(s, name) for s in sources} for name in MEASURES)
    runs = [content[source]["figures"] for source in sources]
    names = [name for name, of in runs[0].items() if not isinstance(of, list)]
    shown = {name: [None if run[name] is None else f"{run[name]:.3g}" for run in runs] for name in names}
    print_rows({"run": name} | dict(zip(sources, shown[name], strict=True)) for name in names)
    say(f"{out_dir / PICTURE_FILE}: medians; in brackets distances of distributions")
