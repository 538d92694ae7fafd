"""Worker side of a pool: one task on one item after another, each under a watch."""

import faulthandler
import gc
import os
import pickle
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread
from typing import Any

from dslab.experiments.plugins import load_plugins
from dslab.scenarios.errors import InputNotice

Task = Callable[[Any], Any]
"""Takes an item and returns its result; pickled by name: a function of a module, or a partial of one."""


def serve(connection: Connection, task: Task, time_s: float | None, report: Path) -> None:
    """Send back result or exception of every item that comes; the main function of a worker process.

    An interrupt reaches every process of the terminal, and only the parent handles it. SIGTERM is no fault,
    though handlers of some libraries print it as one.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # What is noticed of an input is said once, by the parent, which opens it before there are jobs.
    warnings.simplefilter("ignore", InputNotice)
    Thread(target=_end_with_parent, daemon=True).start()
    gc.freeze()  # imported modules stay: the collection after each item need not visit them
    while True:
        try:
            item = connection.recv()
        except EOFError:
            return
        try:
            answer = run_watched(task, item, time_s, report), None
        except Exception as error:
            answer = None, _sendable(error)
        try:
            connection.send(answer)
        except Exception as fault:  # what cannot be pickled is told in words
            connection.send((None, RuntimeError(f"{type(fault).__name__}: {fault}")))
        del item, answer


def run_watched(task: Task, item: Any, time_s: float | None, report: Path | None = None) -> Any:
    """Return the result of a task; the process ends itself if the task takes too long.

    A thread outside the interpreter ends the process, so that a task stuck in compiled code ends as well.

    Args:
        task: called with the item.
        item: argument of the task.
        time_s: longest duration of the task; None for no limit.
        report: file for the stack of every thread if the process dies; None for standard error.
    """
    try:
        load_plugins()
        single_threaded()
        with _watchdog(time_s, report):
            return task(item)
    finally:
        # Systems and renderers are in reference cycles: few objects that hold much memory. The collector
        # counts objects, so without this call tens of megabytes per unit pile up.
        gc.collect()


def single_threaded() -> None:
    """Run OpenCV in one thread: workers share the cores, and parallel sums differ in their last bits."""
    import cv2

    cv2.setNumThreads(1)


@contextmanager
def _watchdog(time_s: float | None, report: Path | None) -> Iterator[None]:
    file = sys.stderr if report is None else report.open("w")
    try:
        faulthandler.enable(file)
        if time_s is not None:
            faulthandler.dump_traceback_later(time_s, exit=True, file=file)
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        faulthandler.enable(sys.stderr)
        if report is not None:
            file.close()
            report.unlink(missing_ok=True)


def _sendable(error: Exception) -> Exception:
    """The exception, or its words if it cannot be rebuilt elsewhere."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
