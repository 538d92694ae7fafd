"""A process with the lab imported, which runs each command in a forked child of its own, under limits.

A fork costs milliseconds where a start of Python costs seconds, and keeps hangs, memory and damage of one
command from the next. Reads one job per line of JSON, answers with one line.
"""

import atexit
import ctypes
import json
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

import cv2
import psutil

MEMORY_BYTES = 3 << 30
"""Address space that a command may take beyond what the server has."""
FILE_BYTES = 256 << 20
"""Largest file that a command may write."""
_SET_CHILD_SUBREAPER = 36


def serve() -> None:
    # What a command leaves running becomes a child of this process, and is seen.
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    # A pool of threads would be missing in the children.
    cv2.setNumThreads(1)
    for line in sys.stdin:
        job = json.loads(line)
        if job.get("here"):
            _call(job["argv"])
            answer = {}
        else:
            answer = _run_forked(job)
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _run_forked(job: dict) -> dict:
    started_s = time.monotonic()
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        try:
            _enter(job)
            code = _call(job["argv"])
            atexit._run_exitfuncs()
        except BaseException:
            traceback.print_exc()
            code = 99
        os._exit(code)
    _, status, usage = os.wait4(pid, 0)
    return {
        "code": os.waitstatus_to_exitcode(status),
        "wall_s": time.monotonic() - started_s,
        "peak_mb": usage.ru_maxrss / 1024,
        "left": _end_descendants(),
    }


def _enter(job: dict) -> None:
    """Take the folder, the environment, the files and the limits of a job."""
    from dslab.experiments.plugins import load_plugins

    os.setsid()
    os.chdir(job["cwd"])
    os.environ.update(job["env"])
    load_plugins.cache_clear()
    tempfile.tempdir = None
    for descriptor, name in ((1, job["stdout"]), (2, job["stderr"])):
        os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644), descriptor)
    if encoding := job["env"].get("PYTHONIOENCODING"):
        name, _, errors = encoding.partition(":")
        for stream in (sys.stdout, sys.stderr):
            stream.reconfigure(encoding=name, errors=errors or None)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_BYTES, FILE_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for name, most in job["limits"]:
        resource.setrlimit(getattr(resource, f"RLIMIT_{name}"), (most, most))
    signal.alarm(job["seconds"])


def _call(argv: list[str]) -> int:
    """Run the command as the interpreter would; its exit code."""
    from dslab.experiments import cli

    if argv[0] == "view":
        from dslab.experiments import recording

        # The viewer needs a display, and outlives the command.
        recording.open_viewer = lambda path, stamp_s: None
    sys.argv = ["dslab", *argv]
    try:
        cli.main()
        code = 0
    except SystemExit as exit_:
        code = exit_.code if isinstance(exit_.code, int) else int(exit_.code is not None)
    except BaseException:
        traceback.print_exc()
        code = 1
    signal.alarm(0)
    sys.stdout.flush()
    sys.stderr.flush()
    return code


def _end_descendants() -> list[str]:
    """End the processes that a command has left; their command lines.

    Those that end when the command's pipes close, as multiprocessing's resource tracker does, get the time.
    """
    _, left = psutil.wait_procs(psutil.Process().children(recursive=True), timeout=5)
    words = []
    for process in left:
        try:
            words.append(" ".join(process.cmdline())[:200])
            process.kill()
            process.wait(5)
        except psutil.NoSuchProcess:
            continue
    return words


if __name__ == "__main__":
    serve()
