"""Worker side of the pool: a watched, single-threaded task, and the task that runs a unit.

Workers of an embedded cluster preload this module, by its name.
"""

import faulthandler
import gc
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dslab.experiments.eq1.record_table import normalise
from dslab.experiments.eq1.records import Outcome, empty_record, error_message
from dslab.experiments.eq1.units import UnitSpec
from dslab.experiments.plugins import load_plugins

Task = Callable[..., Any]
"""Takes an item and options, returns its result; pickled by name, hence a function of a module."""
Job = Callable[..., dict[str, Any]]
"""Takes a unit, ``cache_dir`` and ``recording``, returns its record; a function of a module."""


def run_task(
    task: Task,
    item: Any,
    timeout_s: float,
    report: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> Any:
    """Return the result of a task; the process ends itself if the task takes too long.

    A thread outside the interpreter ends the process, so that a task stuck in compiled code ends as well.

    Args:
        task: called with the item and the options.
        item: argument of the task.
        timeout_s: longest duration of the task.
        report: file for the stack of every thread if the process dies; None for standard error.
        options: keyword arguments of the task.
    """
    try:
        # Dask goes on without the set-up of a worker that fails; here it is the item's error.
        load_plugins()
        single_threaded()
        with _watchdog(timeout_s, report):
            return task(item, **(options or {}))
    finally:
        # Systems and renderers are in reference cycles: few objects that hold much memory. The collector
        # counts objects, so without this call tens of megabytes per unit pile up.
        gc.collect()


def unit_record(
    job: Job, unit: UnitSpec, cache_dir: Path | None = None, recording: Path | None = None
) -> dict[str, Any]:
    """Run a unit and return its normalised record. Never raises.

    Args:
        job: runs a unit.
        unit: the unit to run.
        cache_dir: folder of rendered sequences; None for the default one.
        recording: file for the unit's recording; None for none.
    """
    threads = len(unit.threads)
    try:
        return normalise(job(unit, cache_dir=cache_dir, recording=recording), threads)
    except Exception as error:  # any error ends this attempt only
        return normalise(empty_record(unit) | {"message": error_message(error)}, threads)


def is_infrastructure_error(record: Mapping[str, Any]) -> bool:
    """True if a unit failed for reasons other than the SLAM."""
    return record["outcome"] == Outcome.INFRASTRUCTURE_ERROR.value


def single_threaded() -> None:
    """Run OpenCV in one thread: workers share the cores, and parallel sums differ in their last bits."""
    import cv2

    cv2.setNumThreads(1)


def dask_setup(worker: Any) -> None:
    """Set signal handlers and threads; Dask calls this as a worker process starts.

    An interrupt reaches every process of the terminal, and only the driver handles it. SIGTERM from the nanny
    is no fault, though handlers of some libraries print it as one.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    load_plugins()
    single_threaded()
    # Imported modules stay: the collection after each task need not visit them.
    gc.collect()
    gc.freeze()


@contextmanager
def _watchdog(timeout_s: float, report: Path | None) -> Iterator[None]:
    file = sys.stderr if report is None else report.open("w")
    try:
        faulthandler.enable(file)
        faulthandler.dump_traceback_later(timeout_s, exit=True, file=file)
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        faulthandler.enable(sys.stderr)
        if report is not None:
            file.close()
            report.unlink(missing_ok=True)
