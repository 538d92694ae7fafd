"""``dslab export``: write a sequence or a scenario as a folder in another form."""

from typing import Annotated

import typer

from dslab.experiments.cli.console import (
    CameraOption,
    FolderOption,
    ForceOption,
    FormatChoice,
    SourceArgument,
    out,
    progress_bars,
)


def export_command(
    source: SourceArgument,
    out_dir: FolderOption,
    form: Annotated[FormatChoice, typer.Option("--format", help="Form to write.")],
    seed: Annotated[
        int | None, typer.Option(min=0, help="Root seed; default: that of the scenario.", show_default=False)
    ] = None,
    depth: Annotated[
        bool | None,
        typer.Option(
            "--depth/--no-depth",
            help="Depth images (TUM and VSLAM-LAB form); default: if the folder has them.",
            show_default=False,
        ),
    ] = None,
    imu: Annotated[
        bool | None,
        typer.Option(
            "--imu/--no-imu",
            help="Gyro and accelerometer (EuRoC form); default: if the scenario or folder has them.",
            show_default=False,
        ),
    ] = None,
    camera: CameraOption = None,
    force: ForceOption = False,
) -> None:
    """Write a sequence or scenario in TUM, KITTI, EuRoC or VSLAM-LAB form, with ground truth.

    Sequences are read in those forms and in TUM-mono and TartanAir form; `dslab run` takes any of them.

    For example:

    `dslab export stressed --seed 3 --format euroc --imu --out out/stressed-euroc`

    `dslab export clean-room --depth --format tum --out out/room-rgbd`

    `dslab export path/to/mav --format tum --out out/mav`

    `dslab export path/to/images --camera cam.yaml --format vslam-lab --out out/walk`
    """
    from dslab.experiments.runs.sources import open_imu, open_sequence
    from dslab.scenarios.errors import InputError
    from dslab.sim.io.folders import check_free
    from dslab.sim.io.forms import WITH_DEPTH, Form, write_sequence

    if imu and form is not FormatChoice.EUROC:
        raise InputError("--imu", f"the form {form} has no inertial readings", "use --format euroc")
    if imu and camera is not None:
        raise InputError("--imu", "images and videos have no inertial readings", "leave out --imu")
    has_depth = Form(form.value) in WITH_DEPTH
    if depth and not has_depth:
        raise InputError("--depth", f"the form {form} has no depth images", "use --format tum")
    check_free(out_dir)
    with progress_bars(kernels=False) as show:
        sequence = open_sequence(
            source, seed, show, depth=bool(depth), out_dir=out_dir, force=force, camera=camera
        )
        readings = None
        if form is FormatChoice.EUROC and camera is None:
            readings = open_imu(source, sequence.stamps_s, seed, imu)
        with_depth = has_depth and depth is not False and sequence.depths is not None
        if depth and not with_depth:
            raise InputError(f"--depth: {source}", "the folder has no depth images", "leave out --depth")
        write_sequence(sequence, out_dir, Form(form.value), readings, with_depth, show)
    extras = [name for name, there in (("depth", with_depth), ("imu0", readings)) if there]
    out.print(f"{out_dir}: " + ", ".join([f"{len(sequence)} frames in {form} form", *extras]), soft_wrap=True)
    if sequence.depths is not None and not with_depth:
        out.print("  depth images are left out")
