"""``dslab view``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.console import err
from scenarios.errors import InputError


def view_command(
    path: Annotated[Path, typer.Argument(help="A result folder, or its recording.rrd.")],
    at: Annotated[float | None, typer.Option(min=0, help="Time to open at, seconds.")] = None,
) -> None:
    """Open a recording in the rerun viewer at its first breakage.

    Example: `dslab view out/demo/dual`
    """
    recording = path / "recording.rrd" if path.is_dir() else path
    if not recording.is_file():
        raise InputError(str(recording), "no such recording", "make one with dslab run --rerun")
    stamp_s = at if at is not None else _first_breakage_s(recording.with_name("summary.json"))
    from experiments.recording import open_viewer

    try:
        open_viewer(recording, stamp_s)
    except ConnectionError as error:
        remedy = f"it needs a display; on a machine that has one: rerun {recording}"
        raise InputError("rerun viewer", "does not start", remedy) from error
    err.print(f"opened {recording} at {stamp_s:.2f} s")


def _first_breakage_s(summary_file: Path) -> float:
    """The first breakage that the summary beside the recording tells of, else the start."""
    try:
        breakages = json.loads(summary_file.read_text(encoding="utf-8"))["breakage_list"]
    except (OSError, ValueError, KeyError):
        return 0.0
    return float(breakages[0]["stamp_s"]) if breakages else 0.0
