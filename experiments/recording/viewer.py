"""Viewer of recordings."""

import socket
import sys
from pathlib import Path


def open_viewer(path: Path, stamp_s: float) -> None:
    """Open a recording in the viewer, paused at a time; the viewer outlives this process.

    Raises:
        ConnectionError: the viewer does not start, usually without a display.
    """
    from rerun.experimental import ViewerClient

    try:
        viewer = ViewerClient.spawn(
            port=_free_port(),
            executable_path=str(Path(sys.executable).with_name("rerun")),
            detach_process=True,
        )
        viewer.open(str(path.resolve()))
        viewer.set_time("time", duration=stamp_s, play_state="paused")
    except RuntimeError as error:
        raise ConnectionError(str(error)) from error


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
