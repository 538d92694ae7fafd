"""A program with all that comes of it, within limits of time and memory: its end is always known."""

import json
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import psutil

from dslab.experiments.runs.ending import Ending, EndKind
from dslab.scenarios.errors import InputError
from dslab.sim.unfinished import scratch_folder

_GUARD = Path(__file__).with_name("guard.py")
_LOOK_S = 0.05
_FILE_BYTES = 2 * 10**9
_LOG_BYTES, _LAST_BYTES = 2 * 10**6, 4096
_KILL_S = 10.0
_MIB = 2**20


@dataclass(frozen=True)
class GuardedRun:
    """The end of a program.

    Attributes:
        ending: finished, crashed, timed out or out of memory.
        wall_s: from its start to its end.
        cpu_s: of all its processes that it waited for; None if it was ended.
        peak_rss_mb: largest resident memory of all its processes together, MiB, as far as it was seen;
            at least that of the program itself.
    """

    ending: Ending
    wall_s: float
    cpu_s: float | None
    peak_rss_mb: float


def run_guarded(words: list[str], log: Path, time_s: float, memory_mb: float, cwd: Path) -> GuardedRun:
    """Run a program to its end, or end it with all of its processes.

    Args:
        words: of its command line.
        log: file of what it prints, of which the first megabytes are kept.
        time_s: longest duration.
        memory_mb: most resident memory of all its processes, MiB.
        cwd: folder in which it is started.

    Raises:
        InputError: it cannot be started.
    """
    with scratch_folder() as folder:
        report = folder / "report.json"
        guarded = [sys.executable, "-S", str(_GUARD), str(report), str(_FILE_BYTES), *words]
        started_s = time.perf_counter()
        process = subprocess.Popen(
            guarded,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=cwd,
            start_new_session=True,
        )
        try:
            printed = _Printed(process.stdout, log)
            broken, peak_mb = _watched(process, report, started_s + time_s, memory_mb)
        finally:
            _end_all(process)
        wall_s = time.perf_counter() - started_s
        last = printed.last_line()
        found = json.loads(report.read_text()) if report.exists() else {}
    if "error" in found:
        raise InputError(words[0], f"cannot be run ({found['error']})", "check the command of the system")
    if broken is EndKind.TIMED_OUT:
        ending = Ending(broken, f"not done after {time_s:.0f} s: {last}", "see its log, or raise limits")
    elif broken is EndKind.OUT_OF_MEMORY:
        ending = Ending(broken, f"took more than {memory_mb:g} MiB: {last}", "see its log, or raise limits")
    else:
        ending = _ending(found.get("exit_code"), last)
    return GuardedRun(ending, wall_s, found.get("cpu_s"), max(peak_mb, found.get("peak_kb", 0) / 1024))


def _watched(
    process: subprocess.Popen, report: Path, until_s: float, memory_mb: float
) -> tuple[EndKind | None, float]:
    """Wait for the end; the limit that was passed, or None, and the peak of memory, MiB."""
    peak_mb = 0.0
    while process.poll() is None and not report.exists():
        used_mb = _resident_mb(process.pid)
        peak_mb = max(peak_mb, used_mb)
        if used_mb > memory_mb:
            return EndKind.OUT_OF_MEMORY, peak_mb
        if time.perf_counter() > until_s:
            return EndKind.TIMED_OUT, peak_mb
        time.sleep(_LOOK_S)
    return None, peak_mb


def _ending(exit_code: int | None, last: str) -> Ending:
    if exit_code == 0:
        return Ending()
    how = "its process has vanished" if exit_code is None else f"ended with exit code {exit_code}"
    if exit_code is not None and exit_code < 0:
        with suppress(ValueError):
            how = f"ended by {signal.Signals(-exit_code).name}"
    says_so = any(word in last for word in ("MemoryError", "std::bad_alloc"))
    kind = EndKind.OUT_OF_MEMORY if says_so else EndKind.CRASHED
    return Ending(kind, f"{how}: {last}", "see its log, or run it by hand")


def _descendants(pid: int) -> list[psutil.Process]:
    with suppress(psutil.Error):
        return psutil.Process(pid).children(recursive=True)
    return []


def _resident_mb(pid: int) -> float:
    total = 0
    for process in _descendants(pid):
        with suppress(psutil.Error):
            total += process.memory_info().rss
    return total / _MIB


def _end_all(process: subprocess.Popen) -> None:
    """Close the pipe of the guard, which ends the program with all that came of it; then the guard."""
    left = _descendants(process.pid)
    if process.stdin is not None:
        process.stdin.close()
    with suppress(subprocess.TimeoutExpired):
        process.wait(_KILL_S)
        return
    for other in (*left, process):
        with suppress(psutil.Error, OSError):
            other.kill()
    process.wait()


class _Printed:
    """What a program prints: its beginning in a file, its end in memory, the rest nowhere."""

    def __init__(self, stream: IO[bytes] | None, log: Path) -> None:
        self._stream, self._log, self._end = stream, log, b""
        self._thread = threading.Thread(target=self._copy, daemon=True)
        self._thread.start()

    def last_line(self) -> str:
        """The last line that is not empty, after the end of the program."""
        self._thread.join(_KILL_S)
        lines = self._end.decode(errors="replace").strip().splitlines()
        plain = "".join(letter if letter.isprintable() else " " for letter in lines[-1]) if lines else ""
        return plain.strip()[-300:] or "no message"

    def _copy(self) -> None:
        assert self._stream is not None
        written = 0
        with self._log.open("wb") as file, suppress(OSError, ValueError):
            while part := self._stream.read1(65536):  # type: ignore[attr-defined]
                file.write(part[: max(0, _LOG_BYTES - written)])
                written += len(part)
                self._end = (self._end + part)[-_LAST_BYTES:]
