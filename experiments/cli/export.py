"""``dslab render`` and ``dslab export``: a scenario or a sequence as a folder of some form."""

from contextlib import nullcontext
from pathlib import Path
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
    TruthFormName,
    TruthFormOption,
    TruthOption,
    print_segments,
    progress_bars,
    say,
)
from dslab.scenarios.errors import InputError

DepthOption = Annotated[
    bool, typer.Option("--depth", help="Depth images too (TUM and VSLAM-LAB form, 16 bit, 5000/m).")
]


def render_command(
    scenario: Annotated[
        str, typer.Argument(help="Name of a scenario (see `dslab scenarios list`) or a .yaml file.")
    ],
    out_dir: FolderOption,
    seed: SeedOption = None,
    form: Annotated[
        FormName, typer.Option("--format", help="Form to write; EuRoC includes the IMU of the scenario.")
    ] = "tum",
    depth: DepthOption = False,
    renderer: RendererOption = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Render without using or filling the cache.")
    ] = False,
    force: ForceOption = False,
) -> None:
    """Render a scenario in TUM, KITTI, EuRoC or VSLAM-LAB form: frames, exact ground truth, segments.

    For example:

    `dslab render clean-room --out out/room`

    `dslab render mine.yaml --format euroc --no-cache --out out/mine`
    """
    from dslab.scenarios.loading import load_scenario

    spec = load_scenario(scenario, seed)
    extras = _write(scenario, out_dir, form, seed, depth, None, None, force, renderer, no_cache)
    if spec.imu and "imu0" not in extras:
        say("  inertial readings are left out, use --format euroc")


def export_command(
    source: SourceArgument,
    out_dir: FolderOption,
    form: Annotated[FormName, typer.Option("--format", help="Form to write.")],
    seed: SeedOption = None,
    depth: DepthOption = False,
    imu: Annotated[
        bool,
        typer.Option("--imu", help="Gyro and accelerometer (EuRoC form) if the scenario itself names none."),
    ] = False,
    camera: CameraOption = None,
    truth: TruthOption = None,
    truth_form: TruthFormOption = "tum",
    force: ForceOption = False,
) -> None:
    """Write a sequence or scenario in TUM, KITTI, EuRoC or VSLAM-LAB form, with ground truth.

    Sequences are read in those forms and in TUM-mono and TartanAir form; `dslab run` takes any of them. Depth
    images and inertial readings of a folder are kept where the form has them.

    For example:

    `dslab export stressed --seed 3 --format euroc --imu --out out/stressed-euroc`

    `dslab export path/to/images --camera cam.yaml --format vslam-lab --out out/walk`
    """
    _write(source, out_dir, form, seed, depth, imu or None, camera, force, truth=truth, truth_form=truth_form)


def _write(
    source: str,
    out_dir: Path,
    form: FormName,
    seed: int | None,
    depth: bool,
    imu: bool | None,
    camera: Path | None,
    force: bool,
    renderer: str | None = None,
    no_cache: bool = False,
    truth: Path | None = None,
    truth_form: TruthFormName = "tum",
) -> list[str]:
    """Write the folder; what it has beside frames."""
    from dslab.experiments.runs.sources import open_imu, open_sequence
    from dslab.sim.io.folders import check_free, scratch_beside
    from dslab.sim.io.forms import WITH_DEPTH, Form, write_sequence

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
            readings = open_imu(source, sequence.stamps_s, seed, imu)
        with_depth = Form(form) in WITH_DEPTH and sequence.depths is not None
        write_sequence(sequence, out_dir, Form(form), readings, with_depth, show)
    print_segments(sequence.segments)
    extras = [name for name, there in (("depth", with_depth), ("imu0", readings)) if there]
    say(f"{out_dir}: " + ", ".join([f"{len(sequence)} frames in {form} form", *extras]))
    if sequence.depths is not None and not with_depth:
        say("  depth images are left out")
    return extras
