"""Guard of a program: a process that starts it in a session of its own and ends all that comes of it.

    python guard.py REPORT FILE_BYTES COMMAND...

Standard input is a pipe of the parent: when it closes, whatever has ended the parent, the program is killed.
What the program has started ends with it, also what has left its group or its session (Linux): the guard is
the subreaper, and inherits what has lost its parent. The report is a JSON file: exit code (negative for a
signal), CPU seconds and peak memory (KiB) of the program itself, or the error of a program that cannot be
started. It needs nothing but Python, and starts in a hundredth of a second.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress

_SET_CHILD_SUBREAPER = 36
_KILL_S = 5.0


def main(report: str, file_bytes: int, command: list[str]) -> None:
    """Run a command to its end, end what is left of it and write the report."""
    _limit_files(file_bytes)
    _inherit_orphans()
    try:
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    except (OSError, ValueError) as error:
        _write(report, {"error": getattr(error, "strerror", None) or str(error)})
        return
    threading.Thread(target=_end_with_parent, args=(child.pid,), daemon=True).start()
    ended, status, usage = os.wait4(-1, 0)
    while ended != child.pid:  # it was an orphan
        ended, status, usage = os.wait4(-1, 0)
    _end_all(child.pid)
    cpu_s = usage.ru_utime + usage.ru_stime
    exit_code = os.waitstatus_to_exitcode(status)
    _write(report, {"exit_code": exit_code, "cpu_s": cpu_s, "peak_kb": usage.ru_maxrss})


def _end_with_parent(group: int) -> None:
    while os.read(0, 4096):
        pass
    _end_all(group)
    os._exit(1)


def _end_all(group: int) -> None:
    """Kill the group of the program and all descendants, until none is alive."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, signal.SIGKILL)
    until_s = time.monotonic() + _KILL_S
    while (alive := _descendants()) and time.monotonic() < until_s:
        for pid in alive:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.005)


def _descendants() -> list[int]:
    """Processes that come of this one and are alive, of the tables of Linux; elsewhere none."""
    parents = {}
    with suppress(OSError):
        for name in filter(str.isdecimal, os.listdir("/proc")):
            with suppress(OSError), open(f"/proc/{name}/stat", "rb") as file:
                state, parent = file.read().rpartition(b")")[2].split()[:2]
                if state not in (b"Z", b"X"):
                    parents[int(name)] = int(parent)
    found, new = [], [os.getpid()]
    while new:
        new = [pid for pid, parent in parents.items() if parent in new]
        found += new
    return found


def _inherit_orphans() -> None:
    if sys.platform == "linux":
        with suppress(ImportError, OSError, AttributeError):
            import ctypes

            ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _limit_files(file_bytes: int) -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _write(report: str, content: dict) -> None:
    with open(f"{report}.part", "w", encoding="utf-8") as file:
        json.dump(content, file)
    os.replace(f"{report}.part", report)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3:])
