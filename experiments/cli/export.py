"""``dslab export``: a scenario or a sequence as a folder of some form."""

from contextlib import nullcontext
from typing import Annotated

import typer

from dslab.experiments.cli.console import (
    CameraOption,
    FolderOption,
    ForceOption,
    FormName,
    RendererOption,
    SeedOption,
    SourceArgument,
    TruthFormOption,
    TruthOption,
    print_segments,
    progress_bars,
    say,
)
from dslab.scenarios.errors import InputError


def export_command(
    source: SourceArgument,
    out_dir: FolderOption,
    form: Annotated[FormName, typer.Option("--format", help="Form to write.")] = "tum",
    seed: SeedOption = None,
    depth: Annotated[
        bool, typer.Option("--depth", help="Depth images too (TUM and VSLAM-LAB form, 16 bit, 5000/m).")
    ] = False,
    imu: Annotated[
        bool,
        typer.Option("--imu", help="Gyro and accelerometer (EuRoC form) if the scenario itself names none."),
    ] = False,
    rectify: Annotated[
        bool,
        typer.Option("--rectify", help="Images of a pinhole camera, without lens distortion."),
    ] = False,
    renderer: RendererOption = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Render without using or filling the cache.")
    ] = False,
    camera: CameraOption = None,
    truth: TruthOption = None,
    truth_form: TruthFormOption = "tum",
    force: ForceOption = False,
) -> None:
    """Write a scenario or sequence in TUM, KITTI, EuRoC or VSLAM-LAB form: frames, ground truth, segments.

    Scenarios are rendered, sequences read in any form that `dslab run` takes. Colour, depth images and
    inertial readings are kept where the form has them. orbslam3.yaml is for ORB-SLAM3's own programs.

    For example:

    `dslab export clean-room --out out/room`

    `dslab export stressed --seed 3 --format euroc --imu --out out/stressed-euroc`

    `dslab export path/to/images --camera cam.yaml --format kitti --rectify --out out/walk`
    """
    from dslab.experiments.runs.sources import open_imu, open_sequence
    from dslab.scenarios.input_files import is_folder
    from dslab.sim.io.folders import check_free, scratch_beside
    from dslab.sim.io.forms import WITH_DEPTH, Form, write_sequence
    from dslab.sim.io.wide_lens import rectified

    if imu and form != "euroc":
        raise InputError("--imu", f"the form {form} has no inertial readings", "use --format euroc")
    if imu and camera is not None:
        raise InputError("--imu", "images and videos have no inertial readings", "leave out --imu")
    if depth and Form(form) not in WITH_DEPTH:
        raise InputError("--depth", f"the form {form} has no depth images", "use --format tum")
    check_free(out_dir)
    # Beside the result: the temporary disk may be too small.
    scratch = scratch_beside(out_dir) if no_cache else nullcontext()
    with scratch as cache_dir, progress_bars(kernels=False) as show:
        sequence = open_sequence(
            source, seed, show, depth, renderer, out_dir, force, camera, cache_dir=cache_dir, truth=truth,
            truth_form=truth_form,
        )  # fmt: skip
        if depth and sequence.depths is None:
            raise InputError(f"--depth: {source}", "the folder has no depth images", "leave out --depth")
        readings = None
        if form == "euroc" and camera is None:
            readings = open_imu(source, sequence.stamps_s, seed, imu or None)
        sequence = rectified(sequence) if rectify else sequence
        with_depth = Form(form) in WITH_DEPTH and sequence.depths is not None
        write_sequence(sequence, out_dir, Form(form), readings, with_depth, show)
    print_segments(sequence.segments)
    extras = [name for name, there in (("depth", with_depth), ("imu0", readings)) if there]
    say(f"{out_dir}: " + ", ".join([f"{len(sequence)} frames in {form} form", *extras]))
    if sequence.depths is not None and not with_depth:
        say("  depth images are left out")
    if not readings and not is_folder(source) and sequence.meta.get("spec", {}).get("imu"):
        say("  inertial readings are left out, use --format euroc")
