"""Viewer of recordings."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from dslab.experiments.recording.lanes import BREAKAGES, BROKEN, SYSTEMS
from dslab.experiments.recording.stories import CUT


def recorded_breakage_s(path: Path) -> float:
    """Time of the first breakage in a recording, else of its first cut; 0 without either or if damaged."""
    from rerun.chunk import RrdReader

    times_s: dict[str, list[float]] = {}
    try:
        for chunk in RrdReader(path).stream():
            under, _, lane = chunk.entity_path.rpartition("/")
            if under.startswith(f"/{SYSTEMS}/") and lane == BREAKAGES and not chunk.is_static:
                columns = chunk.to_record_batch().to_pydict()
                for time, states in zip(columns["time"], columns["StateChange:state"], strict=True):
                    times_s.setdefault(states[0], []).append(time.total_seconds())
    except RuntimeError:  # the viewer says what is wrong
        return 0.0
    return min(times_s.get(BROKEN) or times_s.get(CUT) or [0.0])


def open_viewer(path: Path, stamp_s: float) -> None:
    """Open a recording in the viewer, paused at a time; the viewer outlives this process.

    Raises:
        ConnectionError: the viewer does not start, usually without a display.
    """
    from rerun.experimental import ViewerClient

    try:
        with _silent_children():
            viewer = ViewerClient.spawn(
                port=_free_port(),
                executable_path=str(Path(sys.executable).with_name("rerun")),
                detach_process=True,
            )
        viewer.open(str(path.resolve()))
        viewer.set_time("time", duration=stamp_s, play_state="paused")
    except RuntimeError as error:
        raise ConnectionError(str(error)) from error


@contextmanager
def served_viewer(path: Path) -> Iterator[tuple[str, subprocess.Popen]]:
    """Serve a recording and rerun's viewer to browsers of this machine; yields the address and the server."""
    pages, data = _free_port(), _free_port()
    rerun = Path(sys.executable).with_name("rerun")
    ports = ("--bind", "127.0.0.1", "--web-viewer-port", str(pages), "--port", str(data))
    server = subprocess.Popen(
        [rerun, path, "--serve-web", *ports],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield f"http://127.0.0.1:{pages}?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{data}%2Fproxy", server
    finally:
        # The command starts the server itself in a process of its own.
        with suppress(ProcessLookupError):
            os.killpg(server.pid, signal.SIGTERM)
        server.wait()


@contextmanager
def _silent_children() -> Iterator[None]:
    """Processes started meanwhile write no errors to the terminal: the viewer's are not for users."""
    stderr, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
