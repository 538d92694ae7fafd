"""``dslab export``: a sequence or a scenario as a folder in another form."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.console import out, progress_bars


class FormatChoice(StrEnum):
    """The forms that can be written."""

    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"


def export_command(
    source: Annotated[str, typer.Argument(help="A sequence folder, a scenario's name or its YAML file.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder to make; absent or empty.")],
    form: Annotated[FormatChoice, typer.Option("--format", help="The form to write.")],
    seed: Annotated[
        int | None, typer.Option(min=0, help="Root seed; default: the scenario's own.", show_default=False)
    ] = None,
    imu: Annotated[
        bool, typer.Option("--imu", help="Also write gyro and accelerometer (EuRoC form, scenarios only).")
    ] = False,
) -> None:
    """Write a sequence or a scenario in TUM, KITTI or EuRoC form, with its ground truth.

    Sequences are read in those forms and in TUM-mono form; `dslab run` takes any of them.

    For example:

    `dslab export stressed --seed 3 --format euroc --imu --out out/stressed-euroc`

    `dslab export path/to/mav --format tum --out out/mav`
    """
    from experiments.sources import open_sequence, record_scenario_imu
    from scenarios.errors import InputError
    from sim.io.folders import claim_output_dir
    from sim.io.forms import Form, write_sequence

    if imu and form is not FormatChoice.EUROC:
        raise InputError("--imu", f"the form {form} has no inertial readings", "use --format euroc")
    claim_output_dir(out_dir)
    with progress_bars() as show:
        sequence = open_sequence(source, seed, show)
        readings = record_scenario_imu(source, sequence.stamps_s, seed, show) if imu else None
        write_sequence(sequence, out_dir, Form(form.value), readings, show)
    out.print(f"{out_dir}: {len(sequence)} frames in {form} form" + (", with imu0" if readings else ""))
