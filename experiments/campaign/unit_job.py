"""A unit in a worker process: libraries settled, watched over, whatever happens turned into data.

The name of this module is also that of the preload of the workers of an embedded cluster.
"""

import faulthandler
import gc
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from experiments.eq1.record_table import normalise
from experiments.eq1.records import Outcome, empty_record
from experiments.eq1.units import UnitSpec

Job = Callable[..., dict[str, Any]]
"""A unit in, with ``cache_dir`` and ``recording``, its record out: a function of a module, by name."""


def run_job(
    job: Job,
    unit: UnitSpec,
    timeout_s: float,
    cache_dir: Path | None = None,
    recording: Path | None = None,
    report: Path | None = None,
) -> dict[str, Any]:
    """Run a unit and give its normalised record. Never raises; a process that takes too long ends itself.

    The end comes from a thread that needs nothing of the interpreter: a unit that is caught in compiled code
    ends as well.

    Args:
        job: what runs a unit.
        unit: what to run.
        timeout_s: the longest that it may take.
        cache_dir: of rendered sequences, None for the default one.
        recording: file for its recording, None for none.
        report: file that tells, should the process die, where its threads were; None for standard error.
    """
    threads = len(unit.threads)
    try:
        single_threaded()
        with _watchdog(timeout_s, report):
            return normalise(job(unit, cache_dir=cache_dir, recording=recording), threads)
    except Exception as error:  # whatever it is, it ends this attempt and nothing more
        at = traceback.extract_tb(error.__traceback__)[-1]
        message = f"{type(error).__name__}: {error} ({Path(at.filename).name}:{at.lineno})"
        return normalise(empty_record(unit) | {"message": message}, threads)
    finally:
        # Systems and renderers refer to themselves in rings: few objects with much memory behind them. Left
        # to itself the collector, which counts objects, lets tens of megabytes per unit pile up.
        gc.collect()


def is_infrastructure_error(record: Mapping[str, Any]) -> bool:
    """Whether a unit failed for reasons that are none of the SLAM's."""
    return record["outcome"] == Outcome.INFRASTRUCTURE_ERROR.value


def single_threaded() -> None:
    """Workers share a machine core by core, and sums taken by several threads differ in their last bits."""
    import cv2

    cv2.setNumThreads(1)


def dask_setup(worker: Any) -> None:
    """Called by Dask as a worker process starts.

    An interruption is for the driver to handle: it reaches every process of the terminal. The end that the
    nanny puts to a process is no fault, though libraries have handlers that print it as one.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    single_threaded()


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
