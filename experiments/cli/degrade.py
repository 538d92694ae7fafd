"""``dslab degrade``: a sequence folder with degradations put into its frames."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.console import out, progress_bars, single_threaded_opencv


def degrade_command(
    source: Annotated[Path, typer.Argument(help="A sequence folder, real or rendered.")],
    segment: Annotated[
        list[str],
        typer.Option(
            help="kind:key=value,...; may be repeated. Times count from the first frame.", show_default=False
        ),
    ],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder to make; absent or empty.")],
    seed: Annotated[int, typer.Option(min=0, help="Root seed of what is random in the segments.")] = 0,
) -> None:
    """Degrade a sequence folder and write it in TUM form, with segments.json and frame_truth.csv.

    Kinds that act on images, stamps or the choice of frames work on any folder; fog needs depth images.

    For example:

    `dslab degrade office --segment "low_light:start_s=2,duration_s=1,illumination=0.1" --out out/dark`

    `dslab degrade office --segment "covered_lens:start_s=5,duration_s=1,transmission=0"
    --segment "jpeg:start_s=9,duration_s=2,quality=8" --out out/office-hard`
    """
    from scenarios.segment_text import parse_segment
    from sim.degradations.footage import check_footage, degrade_sequence
    from sim.io.tum import claim_output_dir, load_sequence, write_tum

    segments = [parse_segment(text) for text in segment]
    sequence = load_sequence(source)
    check_footage(sequence, segments)
    claim_output_dir(out_dir)
    single_threaded_opencv()
    # Beside the result, where there is room for it.
    with (
        tempfile.TemporaryDirectory(prefix=".dslab-", dir=out_dir.resolve().parent) as scratch,
        progress_bars() as show,
    ):
        degraded = degrade_sequence(sequence, segments, seed, Path(scratch), show)
        write_tum(degraded, out_dir, depth=degraded.depths is not None, progress=show)
    for truth in degraded.segments:
        span = f"frames {truth.first_frame} to {truth.last_frame}"
        typer.echo(f"  {truth.kind}: {span if truth.first_frame >= 0 else 'acts on no frame'}")
    out.print(f"{out_dir}: {len(degraded)} frames")
