"""Standard output and error: whatever is in a name can be printed, and a failure to print is an ending."""

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

_CLOSED_PIPE = 141
"""128 + SIGPIPE: what a program ends with whose reader has left."""


@contextmanager
def safe_streams() -> Iterator[None]:
    """Print what the encoding lacks as escapes; end the program if standard output cannot be written.

    Its reader has left: quietly, with exit code 141. Else, as on a full disk: one line, exit code 1. What
    cannot be written to standard error is dropped: it must not end the work.
    """
    _open_closed()
    before: Any = sys.stdout, sys.stderr
    # Closed ones are None.
    out, err = (stream or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w") for stream in before)
    sys.stdout, sys.stderr = _Stream(out, _end), _Stream(err, _drop)
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
    finally:
        sys.stdout, sys.stderr = before


class _Stream:
    """A text stream with another answer to errors of the system."""

    def __init__(self, stream: TextIO, fail: Any) -> None:
        self._stream, self._fail = stream, fail
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except OSError as error:
            self._fail(self._stream, error)
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            self._fail(self._stream, error)

    def close(self) -> None:
        """Leave it open: a class or a plug-in may close what it is given, and the lab has more to say."""
        self.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _end(stream: TextIO, error: OSError) -> None:
    _drop(stream, error)
    if error.errno in (errno.EPIPE, errno.ECONNRESET):
        raise SystemExit(_CLOSED_PIPE)
    problem = error.strerror or error
    print(f"error: standard output: cannot be written ({problem}); send it elsewhere", file=sys.stderr)
    raise SystemExit(1)


def _drop(stream: TextIO, error: OSError) -> None:
    """Send the rest nowhere: it would fail again, at the latest when the interpreter ends."""
    with suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def _open_closed() -> None:
    """Open what was closed by the caller: the next file of the program would take its place."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
