"""The ``dslab`` command."""

import os
import signal
import sys
import warnings
from typing import Any

from dslab.experiments.cli.machine import check_folder, keep_from_others, refused
from dslab.experiments.cli.signals import signals_as_interrupts
from dslab.experiments.cli.streams import safe_streams
from dslab.scenarios.errors import InputError, InputNotice


def main() -> None:
    """Entry point: bad input is one line and exit code 2, a signal 128 + its number."""
    # OpenCV's own warnings would stand beside the one line.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    # With several threads, linear algebra adds up in another order, and workers contend for the cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with safe_streams(), signals_as_interrupts() as received:
        warnings.showwarning = _show_warning
        try:
            keep_from_others()
            check_folder()
            _check_environment()
            # Imported here, so that a signal meanwhile is heeded too.
            from dslab.experiments.cli.commands import run_app
            from dslab.experiments.plugins import load_plugins

            load_plugins()
            run_app()
        except BaseException as ending:
            if isinstance(ending, SystemExit) and not ending.code:
                raise
            # Once a signal has come, what else goes wrong comes of it: processes of the group end as well.
            if received or _is_interrupt(ending):
                number = received[0] if received else signal.SIGINT
                _clear_up()
                how = "interrupted" if number == signal.SIGINT else f"ended by {number.name}"
                _say(f"{how}: nothing half-written is left")
                sys.exit(128 + number)
            fault = ending if isinstance(ending, InputError) else refused(ending)
            if fault is None:
                raise
            _say(f"error: {fault}")
            sys.exit(fault.exit_code)


def _check_environment() -> None:
    """Raise InputError for what numba would end with a traceback at."""
    threads = os.environ.get("NUMBA_NUM_THREADS", "1")
    if not threads.isdecimal() or int(threads) < 1:
        problem = f"{threads!r} is no number of threads"
        raise InputError("NUMBA_NUM_THREADS", problem, "unset it, or give a whole number of at least 1")


def _is_interrupt(ending: BaseException) -> bool:
    """An interrupt, as Typer passes it on."""
    return isinstance(ending, KeyboardInterrupt) or (
        isinstance(ending, SystemExit) and ending.code == 128 + signal.SIGINT
    )


def _clear_up() -> None:
    """Remove what this process and its workers, which were killed, had no time to."""
    from dslab.sim.cache import UNFINISHED, default_cache_dir
    from dslab.sim.unfinished import remove_own, sweep, sweep_scratch

    remove_own()
    sweep_scratch()
    sweep(default_cache_dir(), UNFINISHED)


_python_shows = warnings.showwarning


def _show_warning(message: Warning | str, category: type[Warning], *rest: Any) -> None:
    """A notice about input is one line; other warnings are as Python shows them."""
    if issubclass(category, InputNotice):
        _say(f"note: {message}")
    else:
        _python_shows(message, category, *rest)


def _say(line: str) -> None:
    from dslab.experiments.cli.console import print_error_line

    print_error_line(line)
