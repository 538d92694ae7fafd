"""The boundary where files become data: every file that the lab reads is opened here.

Only regular files are opened, up to a size that fits their kind, so that a pipe, a device or a wrong file can
neither hang the lab nor fill its memory. Whatever a name or its file can do wrong is one ``InputError``.
"""

import hashlib
import json
import math
import os
import re
import stat
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from dslab.scenarios.errors import InputError

SETTINGS_BYTES = 2 * 10**6
"""Largest file that people write: a scenario, an experiment, a camera, settings."""
RECORD_BYTES = 16 * 10**6
"""Largest JSON file that programs write."""
TABLE_BYTES = 256 * 10**6
"""Largest table of numbers."""
IMAGE_BYTES = 256 * 10**6
"""Largest image file, packed or not."""

ContentT = TypeVar("ContentT", dict, list)

_MOST_DEPTH, _MOST_PARTS = 60, 1_000_000
_WHOLE_BITS = 64
_PART_BYTES = 2**20
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
# A string, which may end with the text, or a mark that opens, closes or separates parts.
_JSON_MARK = re.compile(r'"(?:[^"\\]++|\\.?)*+"?|[\[\]{},]', re.DOTALL)


def is_given(path: str | Path) -> bool:
    """Return True if something has this name, even a broken link; False for an impossible name.

    Unlike pathlib's own, this and ``is_folder`` never raise.
    """
    return os.path.lexists(path)


def is_folder(path: str | Path) -> bool:
    """Return True if a name is that of a folder; False for an impossible name."""
    return os.path.isdir(path)


def is_text(name: str) -> bool:
    """Return True if a name is Unicode: those of files may be other bytes, kept as surrogates."""
    return name.isascii() or not any("\ud800" <= letter <= "\udfff" for letter in name)


def file_names(folder: Path) -> list[str]:
    """Names in a folder, sorted. Raises InputError if it cannot be listed."""
    try:
        return sorted(os.listdir(folder))
    except (OSError, ValueError) as error:
        raise _unreadable(folder, error, "check the path") from None


def open_file(path: Path, most_bytes: int | None = None, if_missing: str = "check the path") -> BinaryIO:
    """Open a regular file for reading.

    Args:
        path: the file.
        most_bytes: its largest size; None for any.
        if_missing: advice if there is no such file.

    Raises:
        InputError: it is missing, no regular file, too large, or cannot be opened.
    """
    try:
        _check_regular(path, os.stat(path), most_bytes)
        # The name may stand for something else by now: a pipe would wait for its writer.
        file = os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb")
    except (OSError, ValueError) as error:
        raise _unreadable(path, error, if_missing) from None
    try:
        _check_regular(path, os.fstat(file.fileno()), most_bytes)
    except InputError:
        file.close()
        raise
    return file


def file_digest(path: Path) -> bytes:
    """SHA-256 of the content of a file of any size. Raises InputError as ``open_file``."""
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").digest()


def read_bytes(path: Path, most_bytes: int, if_missing: str = "check the path") -> bytes:
    """The content of a file. Arguments and errors as ``open_file``."""
    with open_file(path, most_bytes, if_missing) as file:
        try:
            content = _read(file, most_bytes + 1)
        except OSError as error:
            raise _unreadable(path, error, if_missing) from None
    if len(content) > most_bytes:
        raise _too_large(path, len(content), most_bytes)
    return content


def read_text(path: Path, most_bytes: int, if_missing: str = "check the path") -> str:
    """The text of a UTF-8 file, without a byte-order mark. Arguments and errors as ``open_file``."""
    content = read_bytes(path, most_bytes, if_missing)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(str(path), "is not UTF-8 text", "save it as UTF-8, or copy it again") from None


def read_json(path: Path, kind: type[ContentT], if_missing: str = "check the path") -> ContentT:
    """The object or list in a JSON file: bounded in size and depth, no key twice, only finite numbers.

    Args:
        path: the file.
        kind: ``dict`` or ``list``.
        if_missing: advice if there is no such file.

    Raises:
        InputError: the file cannot be read, or holds anything else.
    """
    text = read_text(path, RECORD_BYTES, if_missing)
    try:
        _check_json_bounds(text)
        content = json.loads(
            text,
            object_pairs_hook=_without_doubles,
            parse_constant=_checked_number,
            parse_float=_checked_number,
            parse_int=_checked_number,
        )
    except ValueError as error:
        raise InputError(str(path), f"is no valid JSON ({error})", "correct it or delete it") from None
    if not isinstance(content, kind):
        noun = "object" if kind is dict else "list"
        raise InputError(str(path), f"holds no {noun}", "correct it or delete it")
    return content


def number_fault(value: Any) -> str:
    """What makes a number one that no file may hold; empty for any other value.

    Files hold finite numbers, and whole ones of at most 64 bits.
    """
    if isinstance(value, float) and not math.isfinite(value):
        return "is not a finite number"
    if isinstance(value, int) and value.bit_length() > _WHOLE_BITS:
        return f"is a whole number of more than {_WHOLE_BITS} bits"
    return ""


def _read(file: BinaryIO, most_bytes: int) -> bytes:
    """The first bytes of a file, in parts: Python takes the memory of all that is asked for at once."""
    parts, left = [], most_bytes
    while left and (part := file.read(min(left, _PART_BYTES))):
        parts.append(part)
        left -= len(part)
    return b"".join(parts)


def _check_regular(path: Path, status: os.stat_result, most_bytes: int | None) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), "something else")
        raise InputError(str(path), f"is {kind}, not a file", "give a regular file")
    if most_bytes is not None and status.st_size > most_bytes:
        raise _too_large(path, status.st_size, most_bytes)


def _too_large(path: Path, size: int, most_bytes: int) -> InputError:
    problem = f"has {size / 1e6:.1f} MB, more than the {most_bytes / 1e6:g} MB of such a file"
    return InputError(str(path), problem, "check that it is the right file")


def _unreadable(path: Path, error: OSError | ValueError, if_missing: str) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(str(path), "no such file", if_missing)
    # A name with a zero byte is a ValueError.
    problem = error.strerror if isinstance(error, OSError) else "is no possible name of a file"
    return InputError(str(path), problem or "cannot be read", "give a readable file")


def _check_json_bounds(text: str) -> None:
    """Raise ValueError for too many or too deeply nested parts, before any is made."""
    depth = parts = 0
    for mark in _JSON_MARK.finditer(text):
        first = mark[0][0]
        depth += (first in "[{") - (first in "]}")
        parts += first in "[{,"
        if depth > _MOST_DEPTH:
            raise ValueError(f"more than {_MOST_DEPTH} levels deep")
        if parts > _MOST_PARTS:
            raise ValueError(f"more than {_MOST_PARTS} parts")


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"key {next(key for key in keys if keys.count(key) > 1)!r} appears twice")
    return content


def _checked_number(word: str) -> int | float:
    """The number of a word of JSON. Raises ValueError for one that no file may hold."""
    whole = word.lstrip("-").isdigit()
    # Beyond this many digits, Python refuses with advice that helps nobody.
    value = int(word) if whole and len(word) < 100 else 2**_WHOLE_BITS if whole else float(word)
    if fault := number_fault(value):
        raise ValueError(f"{word[:40]} {fault}")
    return value
