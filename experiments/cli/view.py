"""``dslab view``."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from dslab.experiments.cli.console import err, say
from dslab.scenarios.errors import InputError, MachineError


def view_command(
    path: Annotated[Path, typer.Argument(help="A result folder, or its recording.rrd.")],
    at: Annotated[
        float | None, typer.Option(min=0, help="Opening time in seconds from the first frame.")
    ] = None,
    web: Annotated[
        bool, typer.Option("--web", help="Serve it to a browser of this machine until Ctrl+C.")
    ] = False,
) -> None:
    """Open a recording in the rerun viewer at its first breakage.

    Examples: `dslab view out/demo`, `dslab view out/demo --web`
    """
    from dslab.scenarios.input_files import is_folder, open_file

    recording = path / "recording.rrd" if is_folder(path) else path
    open_file(recording, if_missing="make a recording with dslab run --rerun").close()
    if web:
        _serve(recording)
        return
    stamp_s = at if at is not None else _first_breakage_s(recording)
    from dslab.experiments.recording import open_viewer

    try:
        open_viewer(recording, stamp_s)
    except ConnectionError as error:
        remedy = f"it needs a display; on a machine that has one: rerun {recording}"
        raise InputError("rerun viewer", "does not start", remedy) from error
    err.print(f"opened {recording} at {stamp_s:.2f} s")


def _serve(recording: Path) -> None:
    from dslab.experiments.recording.viewer import served_viewer

    with served_viewer(recording) as (address, server):
        say(address)
        err.print("open this address in a browser; Ctrl+C ends it")
        if server.wait():
            raise MachineError("rerun viewer", "does not start", f"try: rerun {recording} --serve-web")


def _first_breakage_s(recording: Path) -> float:
    """Time of the first breakage in the summaries beside a recording and one folder below, else in itself."""
    from dslab.experiments.recording import recorded_breakage_s
    from dslab.experiments.result_folder import SUMMARY_FILE
    from dslab.scenarios.input_files import is_given, read_json

    folder = recording.parent
    places = [folder / SUMMARY_FILE, *sorted(folder.glob(f"*/{SUMMARY_FILE}"))]
    if not any(map(is_given, places)):
        return recorded_breakage_s(recording)
    summaries = {str(path): read_json(path, dict) for path in places if is_given(path)}
    found = [stamp_s for where, summary in summaries.items() for stamp_s in _breakages_s(where, summary)]
    return float(min(found, default=0.0))


def _breakages_s(where: str, summary: Any) -> Iterator[float]:
    """Times of the breakages in a summary. Raises InputError if it does not list them so."""
    listed = summary.get("breakage_list", []) if isinstance(summary, dict) else None
    for index, breakage in enumerate(listed if isinstance(listed, list) else [None]):
        time_s = breakage.get("time_s") if isinstance(breakage, dict) else None
        if isinstance(time_s, bool) or not isinstance(time_s, int | float):
            at = f"{where}: breakage_list[{index}]"
            raise InputError(at, "has no time_s", "give --at, or run again with --rerun")
        yield time_s
