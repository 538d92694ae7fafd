"""``dslab render``: write frames and ground truth of a scenario."""

import time
from contextlib import nullcontext
from typing import Annotated

import typer

from dslab.experiments.cli.console import (
    FolderOption,
    ForceOption,
    FormatChoice,
    RendererOption,
    out,
    print_segments,
    progress_bars,
)

ScenarioArgument = Annotated[
    str, typer.Argument(help="Name of a scenario (see `dslab scenarios list`) or a .yaml file.")
]


def render_command(
    scenario: ScenarioArgument,
    out_dir: FolderOption,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Root seed; default: that of the scenario.", show_default=False)
    ] = None,
    form: Annotated[
        FormatChoice, typer.Option("--format", help="Form to write; EuRoC includes the IMU of the scenario.")
    ] = FormatChoice.TUM,
    depth: Annotated[
        bool,
        typer.Option("--depth", help="Also write depth images (TUM and VSLAM-LAB form, 16 bit, 5000/m)."),
    ] = False,
    renderer: RendererOption = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Render without using or filling the cache.")
    ] = False,
    force: ForceOption = False,
) -> None:
    """Render a scenario in TUM, KITTI, EuRoC or VSLAM-LAB form: frames, exact ground truth, segments.

    For example:

    `dslab render clean-room --out out/room`

    `dslab render stressed --seed 3 --depth --out out/stressed-3`

    `dslab render kitti-like/07 --seed 1 --out out/kitti-like-07`

    `dslab render mine.yaml --format euroc --no-cache --out out/mine`
    """
    from dslab.experiments.runs.sources import open_imu
    from dslab.scenarios.errors import InputError
    from dslab.scenarios.loading import load_scenario
    from dslab.sim.io.folders import check_free, scratch_beside
    from dslab.sim.io.forms import WITH_DEPTH, Form, write_sequence
    from dslab.sim.rendering.renderers import DEFAULT_RENDERER
    from dslab.sim.sequence_rendering import images_need_of, render_backend, render_sequence

    spec = load_scenario(scenario, seed)
    if depth and Form(form.value) not in WITH_DEPTH:
        raise InputError("--depth", f"the form {form} has no depth images", "use --format tum")
    backend = render_backend(renderer or DEFAULT_RENDERER)
    check_free(out_dir)
    started_s = time.monotonic()
    # Beside the result: the temporary disk may be too small.
    scratch = scratch_beside(out_dir) if no_cache else nullcontext()
    with scratch as cache_dir, progress_bars(kernels=False) as show:
        sequence = render_sequence(
            spec,
            cache_dir=cache_dir,
            depth=depth,
            progress=show,
            backend=backend,
            needs=[images_need_of(spec, out_dir, depth)],
            force=force,
        )
        readings = open_imu(scenario, sequence.stamps_s, seed) if form is FormatChoice.EUROC else None
        write_sequence(sequence, out_dir, Form(form.value), readings, depth, show)
    print_segments(sequence.segments)
    took_s = time.monotonic() - started_s
    frames = f"{len(sequence)} frames{', imu0' if readings else ''}"
    out.print(f"{out_dir}: {frames} in {took_s:.1f} s", soft_wrap=True)
    if spec.imu and not readings:
        out.print("  inertial readings are left out, use --format euroc")
