"""``dslab degrade``: add degradations to a sequence folder."""

from pathlib import Path
from typing import Annotated

import typer
from rich.padding import Padding

from dslab.experiments.cli.console import (
    CameraOption,
    FolderOption,
    ForceOption,
    FormName,
    SeedOption,
    TruthFormOption,
    TruthOption,
    out,
    print_segments,
    progress_bars,
    say,
    single_threaded_opencv,
)
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_folder


def _print_kinds(requested: bool) -> None:
    """The kinds that recorded frames can have, with their keys."""
    if not requested:
        return
    from dslab.scenarios.describe_fields import described_fields
    from dslab.scenarios.segments import SEGMENT_KINDS, ImageSegment
    from dslab.sim.degradations.recorded_kinds import recorded_sequence_kinds
    from dslab.sim.degradations.registry import DEGRADATIONS

    kinds, of_all = recorded_sequence_kinds(depth=True), ("start_s", "duration_s", "ramp_s", "fall_s")
    for kind in kinds:
        model = SEGMENT_KINDS[kind]
        about = " ".join((model.__doc__ or "").split("\n\n")[-1].split()).removeprefix("In recordings: ")
        out.print(f"{kind}: {about}")
        for name, span, meaning in described_fields(model, ("kind", *of_all)):
            out.print(Padding(f"{name} ({span}) {meaning}".replace("`", ""), (0, 0, 0, 2)))
    plain = [kind for kind in kinds if not issubclass(SEGMENT_KINDS[kind], ImageSegment)]
    out.print(
        "Every kind has start_s and duration_s, in seconds from the first frame, and all but "
        f"{', '.join(plain)} have ramp_s, the time in which the severity rises and falls (fall_s, if it "
        "falls in another). In rendered scenarios only: "
        f"{', '.join(kind for kind in DEGRADATIONS if kind not in kinds)}."
    )
    raise typer.Exit


def degrade_command(
    source: Annotated[
        Path, typer.Argument(help="A sequence folder, recorded or rendered; with --camera images or a video.")
    ],
    segment: Annotated[
        list[str],
        typer.Option(
            help="kind:key=value,..., a list as key=[1,2]; repeatable. Times count from the first frame.",
            show_default=False,
        ),
    ],
    out_dir: FolderOption,
    _listed: Annotated[
        bool,
        typer.Option(
            "--list", callback=_print_kinds, is_eager=True, help="Print the kinds with their keys and exit."
        ),
    ] = False,
    form: Annotated[
        FormName | None,
        typer.Option(
            "--format",
            help="Form to write; default: that of the folder, TUM where that is only read.",
            show_default=False,
        ),
    ] = None,
    seed: SeedOption = None,
    camera: CameraOption = None,
    truth: TruthOption = None,
    truth_form: TruthFormOption = "tum",
    force: ForceOption = False,
) -> None:
    """Degrade recorded frames: a sequence folder of any form, a ROS bag, images or a video.

    Writes the frames with ground truth and calibration, depth images (TUM and VSLAM-LAB form) and inertial
    readings (EuRoC form) if present, and segments.json and frame_truth.csv with the true times and strengths
    of the segments. Segments of different kinds may overlap; `dslab degrade --list` prints the kinds. Motion
    blur averages light along the optical flow between the frames. Low texture fades detail and leaves shading
    and noise. Fast rotation turns the images and the ground truth, and crops all frames to what every turn
    sees.

    For example:

    `dslab degrade office --segment "motion_blur:start_s=2,duration_s=1,exposure_s=0.1" --out out/blurred`

    `dslab degrade office --segment "covered_lens:start_s=5,duration_s=1,transmission=0"
    --segment "jpeg:start_s=4.5,duration_s=2,quality=8" --out out/office-hard`
    """
    from dslab.experiments.runs.sources import open_imu
    from dslab.scenarios.segment_text import parse_segment
    from dslab.sim.degradations.recorded_kinds import check_recorded_sequence
    from dslab.sim.degradations.recorded_sequences import degrade_sequence
    from dslab.sim.io.folders import check_free, scratch_beside
    from dslab.sim.io.forms import (
        READ_ONLY,
        WITH_DEPTH,
        Form,
        detect_form,
        load_sequence,
        sequence_folder,
        write_sequence,
    )
    from dslab.sim.room import check_room, images_need
    from dslab.sim.sequence import is_coloured

    segments = [parse_segment(text) for text in segment]
    with progress_bars(kernels=False) as show:
        sequence = load_sequence(source, camera, show, force, truth, truth_form)
    check_recorded_sequence(sequence, segments)
    found = detect_form(sequence_folder(source)) if camera is None and is_folder(source) else Form.TUM
    target = Form(form) if form else Form.TUM if found in READ_ONLY else found
    readings = open_imu(str(source), sequence.stamps_s) if found is target is Form.EUROC else None
    if readings and any(segment.kind == "fast_rotation" for segment in segments):
        problem = "fast_rotation turns the images, not the inertial readings of the folder"
        raise InputError(str(source), problem, "add --format tum, which has none")
    check_free(out_dir)
    # The degraded frames twice: as stacks, in colour beside one in gray, then as images.
    colour, size_px = is_coloured(sequence.frames), (sequence.camera.width_px, sequence.camera.height_px)
    needs = [images_need(out_dir, len(sequence), size_px, sequence.depths is not None, colour)]
    needs += [images_need(out_dir, len(sequence), size_px, colour=each) for each in {False, colour}]
    check_room(str(source), len(sequence), needs, force)
    single_threaded_opencv()
    # Beside the result: the temporary disk may be too small.
    with scratch_beside(out_dir) as scratch, progress_bars(kernels=False) as show:
        degraded = degrade_sequence(sequence, segments, seed or 0, scratch, show)
        with_depth = target in WITH_DEPTH and degraded.depths is not None
        write_sequence(degraded, out_dir, target, readings, with_depth, show)
    print_segments(degraded.segments)
    say(f"{out_dir}: {len(degraded)} frames in {target} form" + (", with imu0" if readings else ""))
