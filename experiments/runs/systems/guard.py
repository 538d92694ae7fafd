"""Guard of a program: a process that starts it in a group of its own and ends the group with its parent.

    python guard.py REPORT FILE_BYTES COMMAND...

Standard input is a pipe of the parent: when it closes, whatever has ended the parent, the group is killed.
The report is a JSON file: exit code (negative for a signal), CPU seconds and peak memory (KiB) of the
program itself, or the error of a program that cannot be started. It needs nothing but Python, and starts in
a hundredth of a second.
"""

import json
import os
import signal
import subprocess
import sys
import threading


def main(report: str, file_bytes: int, command: list[str]) -> None:
    """Run a command to its end, write the report and end what is left of the group."""
    _limit_files(file_bytes)
    try:
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    except (OSError, ValueError) as error:
        _write(report, {"error": getattr(error, "strerror", None) or str(error)})
        return
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _, status, usage = os.wait4(child.pid, 0)
    cpu_s = usage.ru_utime + usage.ru_stime
    exit_code = os.waitstatus_to_exitcode(status)
    _write(report, {"exit_code": exit_code, "cpu_s": cpu_s, "peak_kb": usage.ru_maxrss})
    os.killpg(0, signal.SIGKILL)


def _end_with_parent() -> None:
    while os.read(0, 4096):
        pass
    os.killpg(0, signal.SIGKILL)


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
