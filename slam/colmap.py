"""pycolmap, as the rest of the packages import it."""

import signal
from contextlib import suppress

import pycolmap

__all__ = ["pycolmap"]

# Its logging takes SIGTERM over and would answer it with a stack of native calls. For the 30 ms of the import
# it does so: a signal blocked here would only go to the threads of BLAS.
if (_handler := signal.getsignal(signal.SIGTERM)) is not None:
    with suppress(ValueError):  # not in the main thread, where alone handlers can be set
        signal.signal(signal.SIGTERM, _handler)
