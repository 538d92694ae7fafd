"""``dslab degrade``: a sequence folder with degradations put into its frames."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.console import FormatChoice, out, progress_bars, single_threaded_opencv


def degrade_command(
    source: Annotated[Path, typer.Argument(help="A sequence folder, real or rendered.")],
    segment: Annotated[
        list[str],
        typer.Option(
            help="kind:key=value,...; may be repeated. Times count from the first frame.", show_default=False
        ),
    ],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder to make; absent or empty.")],
    form: Annotated[
        FormatChoice | None,
        typer.Option(
            "--format", help="The form to write; default: the folder's, TUM for TUM-mono.", show_default=False
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Root seed of what is random in the segments.")] = 0,
) -> None:
    """Degrade a folder in TUM, KITTI, EuRoC or TUM-mono form.

    Written are the frames with ground truth, calibration and what there is of depth images (TUM form) and
    inertial readings (EuRoC form), and segments.json and frame_truth.csv, which say when each segment truly
    acts and how much. Segments of different kinds may lie over one another. Kinds that act on images, stamps
    or the choice of frames work on any folder; fog needs depth images.

    For example:

    `dslab degrade office --segment "low_light:start_s=2,duration_s=1,illumination=0.1" --out out/dark`

    `dslab degrade office --segment "covered_lens:start_s=5,duration_s=1,transmission=0"
    --segment "jpeg:start_s=4.5,duration_s=2,quality=8" --out out/office-hard`

    `dslab degrade MH_01 --segment "rain:start_s=10,duration_s=20,rate_mmph=40,ramp_s=2" --out out/rainy`
    """
    from experiments.runs.sources import open_imu
    from scenarios.segment_text import parse_segment
    from sim.degradations.recorded_sequences import check_recorded_sequence, degrade_sequence
    from sim.io.folders import check_free
    from sim.io.forms import Form, detect_form, load_sequence, sequence_folder, write_sequence

    segments = [parse_segment(text) for text in segment]
    sequence = load_sequence(source)
    check_recorded_sequence(sequence, segments)
    found = detect_form(sequence_folder(source))
    target = Form(form.value) if form else Form.TUM if found is Form.TUM_MONO else found
    readings = open_imu(str(source), sequence.stamps_s) if target is Form.EUROC else None
    check_free(out_dir)
    single_threaded_opencv()
    # Beside the result, where there is room for it.
    with (
        tempfile.TemporaryDirectory(prefix=".dslab-", dir=out_dir.resolve().parent) as scratch,
        progress_bars() as show,
    ):
        degraded = degrade_sequence(sequence, segments, seed, Path(scratch), show)
        with_depth = target is Form.TUM and degraded.depths is not None
        write_sequence(degraded, out_dir, target, readings, with_depth, show)
    for truth in degraded.segments:
        span = f"frames {truth.first_frame} to {truth.last_frame}"
        typer.echo(f"  {truth.kind}: {span if truth.first_frame >= 0 else 'acts on no frame'}")
    out.print(f"{out_dir}: {len(degraded)} frames in {target} form" + (", with imu0" if readings else ""))
