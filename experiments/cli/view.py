"""``dslab view``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.console import err
from scenarios.errors import InputError


def view_command(
    path: Annotated[Path, typer.Argument(help="A result folder, or its recording.rrd.")],
    at: Annotated[float | None, typer.Option(min=0, help="Opening time in seconds.")] = None,
) -> None:
    """Open a recording in the rerun viewer at its first breakage.

    Example: `dslab view out/demo`
    """
    recording = path / "recording.rrd" if path.is_dir() else path
    if not recording.is_file():
        raise InputError(str(recording), "no such recording", "make one with dslab run --rerun")
    stamp_s = at if at is not None else _first_breakage_s(recording.parent)
    from experiments.recording import open_viewer

    try:
        open_viewer(recording, stamp_s)
    except ConnectionError as error:
        remedy = f"it needs a display; on a machine that has one: rerun {recording}"
        raise InputError("rerun viewer", "does not start", remedy) from error
    err.print(f"opened {recording} at {stamp_s:.2f} s")


def _first_breakage_s(folder: Path) -> float:
    """Time of the first breakage in the summaries beside the recording, else 0."""
    from experiments.demo import MARKER_FILE
    from experiments.result_folder import SUMMARY_FILE

    summaries = [_read(folder / SUMMARY_FILE), *_read(folder / MARKER_FILE).values()]
    found = [b["stamp_s"] for s in summaries if isinstance(s, dict) for b in s.get("breakage_list", ())]
    return float(min(found, default=0.0))


def _read(file: Path) -> dict:
    """Object in a JSON file, else an empty one."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
