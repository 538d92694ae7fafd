"""``dslab picture``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dslab.experiments.cli.console import say
from dslab.scenarios.errors import InputError, notice

if TYPE_CHECKING:
    from dslab.experiments.runs.execution import RunRecord


def picture_command(
    path: Annotated[Path, typer.Argument(help="A result folder, of one system or of several.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The PNG file.")],
    at: Annotated[
        str | None,
        typer.Option(
            metavar="MOMENT",
            help="breakage or fusion, the first, or seconds from the start; default: the first breakage, "
            "or the end of a run without one.",
        ),
    ] = None,
) -> None:
    """Draw a moment of a run as a PNG: the frame with its features, the path so far, inliers over time.

    It needs no display. The frame is that of recording.rrd, so of a run with --rerun.

    Examples: `dslab picture out/demo --out breakage.png`, `dslab picture out/run --at 7.5 --out moment.png`
    """
    from dslab.experiments.pictures.moment_picture import frame_at, moment_figure
    from dslab.experiments.recording.recorded_frame import recorded_frame
    from dslab.experiments.result_folder import RECORDING_FILE, SUMMARY_FILE
    from dslab.experiments.runs.read_back import read_record
    from dslab.scenarios.input_files import is_given
    from dslab.sim.io.folders import write_file

    if out.suffix != ".png":
        raise InputError(f"--out: {out}", "is no name of a PNG file", "give a name that ends in .png")
    if not out.parent.is_dir():
        raise InputError(f"--out: {out}", "its folder does not exist", "make it, or choose another place")
    several = [] if is_given(path / SUMMARY_FILE) else sorted(path.glob(f"*/{SUMMARY_FILE}"))
    records = [read_record(file.parent) for file in several] or [read_record(path)]
    names = list(dict.fromkeys(record.sequence.name for record in records))
    if len(names) > 1:
        problem = f"holds runs over several sequences ({', '.join(names[:3])})"
        raise InputError(str(path), problem, "give the folder of one")
    stamp_s = _stamp_at(at, records)
    frame = frame_at(records[0], stamp_s)
    recording = next((f for f in (path / RECORDING_FILE, path.parent / RECORDING_FILE) if is_given(f)), None)
    shown = None
    if recording is None:
        notice(str(path), "has no recording.rrd: the picture has no frame; run with --rerun for one")
    else:
        shown = recorded_frame(recording, [record.system_kind for record in records], frame)
    figure = moment_figure({record.system_kind: record for record in records}, stamp_s, shown)
    write_file(out, figure.savefig)
    stamps_s = records[0].sequence.stamps_s
    say(f"{out}: frame {frame}, {stamps_s[frame] - stamps_s[0]:.2f} s")


def _stamp_at(at: str | None, records: "list[RunRecord]") -> float:
    """The stamp of a moment. Raises InputError if there is none."""
    from dslab.slam.core.events import Breakage, Fusion

    events = [(record.sequence.stamps_s[event.frame], event) for record in records for event in record.events]
    found = {
        "breakage": [stamp_s for stamp_s, event in events if isinstance(event, Breakage)],
        "fusion": [stamp_s for stamp_s, event in events if isinstance(event, Fusion) and event.accepted],
    }
    if at is None:
        return min(found["breakage"], default=float(records[0].sequence.stamps_s[-1]))
    if at in found:
        if not found[at]:
            raise InputError(f"--at {at}", f"there is no {at} in this run", "give seconds, such as --at 5")
        return min(found[at])
    first_s, last_s = records[0].sequence.stamps_s[[0, -1]]
    try:
        time_s = float(at)
    except ValueError:
        raise InputError(f"--at {at}", "is no moment", "give breakage, fusion or seconds") from None
    if not 0 <= time_s <= last_s - first_s + 1:
        raise InputError(f"--at {at}", f"the run is {last_s - first_s:.2f} s long", "give a time in it")
    return first_s + time_s
