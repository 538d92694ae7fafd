"""SIGTERM and SIGHUP end a command as Ctrl-C does: by an exception that clears up on its way."""

import math
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer, current_thread, main_thread
from typing import Any

_ENDING = ("SIGINT", "SIGTERM", "SIGHUP")
_SOON_S = 0.01
_AGAIN_S = 2.0
"""Time during which further signals are taken for the same wish, so that they do not cut the clearing up."""


@contextmanager
def signals_as_interrupts() -> Iterator[list[signal.Signals]]:
    """Raise KeyboardInterrupt on a signal to end; yields the list of those received.

    Signals that are ignored, as under ``nohup``, stay ignored. Outside of the main thread nothing changes.
    """
    received: list[signal.Signals] = []
    last_s = -math.inf

    def interrupt(number: int, frame: object) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        received.append(signal.Signals(number))
        if now_s - last_s >= _AGAIN_S:
            last_s = now_s
            raise KeyboardInterrupt

    def swallowed(unraisable: Any) -> None:
        """A callback of compiled code lets no exception through: the signal is sent again."""
        nonlocal last_s
        if not (received and isinstance(unraisable.exc_value, KeyboardInterrupt)):
            return hook(unraisable)
        last_s = -math.inf
        return Timer(_SOON_S, os.kill, (os.getpid(), received[0])).start()

    handlers = {}
    if current_thread() is main_thread():
        known = [getattr(signal, name) for name in _ENDING if hasattr(signal, name)]
        handlers = {n: signal.getsignal(n) for n in known}
    for number, handler in handlers.items():
        if handler not in (None, signal.SIG_IGN):
            signal.signal(number, interrupt)
    hook, sys.unraisablehook = sys.unraisablehook, swallowed
    try:
        yield received
    finally:
        sys.unraisablehook = hook
        for number, handler in handlers.items():
            if handler is not None:
                signal.signal(number, handler)
