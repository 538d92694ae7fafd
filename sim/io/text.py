"""Text files of numbers; every fault is one line with file, line, field and remedy."""

import io
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Sized
from decimal import Decimal
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from dslab.scenarios.errors import InputError, notice
from dslab.scenarios.input_files import TABLE_BYTES, read_text

StampT = TypeVar("StampT", int, float, Decimal)

_MOST_ROWS, _LONGEST_ROW = 4_000_000, 100_000
# Two thousand years: more are no seconds, but micro- or nanoseconds.
_MOST_STAMP_S = 6e10


def read_rows(
    path: Path, remedy: str, separator: str | None = None, most_bytes: int = TABLE_BYTES
) -> Iterator[tuple[str, list[str]]]:
    """Yield ``file:line`` and the words of every line that is neither empty nor a comment.

    Args:
        path: the file.
        remedy: advice if the file does not exist.
        separator: between words; None for white space.
        most_bytes: largest size of the file.

    Raises:
        InputError: the file cannot be read, or is too long for a table.
    """
    rows = 0
    text = read_text(path, most_bytes, remedy)
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            rows += 1
            if len(line) > _LONGEST_ROW or rows > _MOST_ROWS:
                problem = f"is too long for a table, at most {_MOST_ROWS} rows of {_LONGEST_ROW} characters"
                raise InputError(f"{path}:{number}", problem, "check that it is the right file")
            yield f"{path}:{number}", [word.strip() for word in line.split(separator)]


def data_rows(path: Path, rows: Iterable[tuple[str, list[str]]]) -> Iterator[tuple[str, list[str]]]:
    """Leave out a header, which has no digit, and lines that repeat the one before, and say so."""
    before: list[str] | None = None
    left_out = 0
    for where, words in rows:
        if before is None and len(words) > 1 and not any(map(str.isdigit, "".join(words))):
            notice(where, "is taken for a header")
        elif words == before:
            left_out += 1
        else:
            yield where, words
        before = words
    if left_out:
        notice(str(path), f"{left_out} lines that repeat the one before are left out")


def check_words(where: str, words: list[str], names: list[str]) -> None:
    """Raise InputError unless a line has one word per name."""
    if len(words) != len(names):
        problem = f"{len(words)} numbers where {len(names)} belong"
        raise InputError(where, problem, f"write `{' '.join(names)}`; the file may be cut short")


def to_numbers(where: str, words: list[str], names: list[str]) -> list[float]:
    """Finite numbers of a line. Raises InputError with the field of any other word."""
    values = []
    for word, name in zip(words, names, strict=True):
        try:
            # Python also takes 1_000 and digits of other scripts.
            value = float(word) if word.isascii() and "_" not in word else np.nan
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise InputError(f"{where}: {name}", f"{word!r} is not a finite number", "correct it")
        values.append(value)
    return values


def to_stamp(where: str, word: str) -> float:
    """A stamp in seconds. Raises InputError for any other word."""
    stamp_s = to_numbers(where, [word], ["stamp"])[0]
    if abs(stamp_s) > _MOST_STAMP_S:
        raise InputError(f"{where}: stamp", f"{word} is no time in seconds", "give stamps in seconds")
    return stamp_s


def to_decimal(where: str, word: str) -> Decimal:
    """A stamp in seconds with all of its digits. Raises InputError for any other word."""
    to_stamp(where, word)
    return Decimal(word)


def to_nanoseconds(where: str, word: str) -> int:
    """A stamp in whole nanoseconds. Raises InputError for any other word."""
    if not re.fullmatch(r"[0-9]{1,19}", word):
        raise InputError(f"{where}: timestamp", f"{word!r} is no stamp in nanoseconds", "write whole numbers")
    return int(word)


def to_frame_number(where: str, word: str) -> int:
    """The number of a frame, with any leading zeros. Raises InputError for any other word."""
    if not re.fullmatch(r"[0-9]{1,18}", word):
        raise InputError(where, f"{word!r} is no number of a frame", "number frames and images from 0")
    return int(word)


def check_order(where: str, earlier: list[Any], stamp: float) -> None:
    """Raise InputError unless a stamp comes after the last of the earlier ones."""
    if earlier and stamp <= earlier[-1]:
        shown, last = (f"{s}" if isinstance(s, int) else f"{s:.6f}" for s in (stamp, earlier[-1]))
        problem = f"{shown} does not come after {last}"
        raise InputError(f"{where}: stamp", problem, "sort the lines by stamp and remove doubles")


def read_list(
    path: Path, separator: str | None, to_stamp: Callable[[str, str], StampT]
) -> tuple[list[StampT], list[str]]:
    """Stamps and names of a list of frames. Raises InputError without a frame, or for any other line."""
    between = separator or " "
    stamps: list[StampT] = []
    names: list[str] = []
    rows = read_rows(path, f"give the list of frames, `stamp{between}filename` per line", separator)
    for where, words in data_rows(path, rows):
        if len(words) < 2 or (separator and len(words) > 2):
            problem = f"{len(words)} words where stamp and filename belong"
            raise InputError(where, problem, f"write `stamp{between}filename`; the file may be cut short")
        stamp = to_stamp(where, words[0])
        check_order(where, stamps, stamp)
        stamps.append(stamp)
        names.append(" ".join(words[1:]))  # a name may have spaces
    check_frames(path, stamps)
    return stamps, names


def check_frames(path: Path, stamps: Sized) -> None:
    """Raise InputError for a list without a frame."""
    if not stamps:
        raise InputError(str(path), "lists no frame", "give a folder with at least one frame")


def stamped_numbers(
    rows: Iterable[tuple[str, list[str]]],
    names: list[str],
    to_stamp: Callable[[str, str], StampT],
    check: Callable[[str, list[float]], None] = lambda where, numbers: None,
) -> tuple[list[StampT], np.ndarray]:
    """Increasing stamps, of the first of the named columns, and (M, C) numbers of the others.

    Raises:
        InputError: a line has other words, or ``check`` raises it of a line's numbers.
    """
    stamps: list[StampT] = []
    table: list[list[float]] = []
    for where, words in rows:
        check_words(where, words, names)
        stamp = to_stamp(where, words[0])
        check_order(where, stamps, stamp)
        stamps.append(stamp)
        table.append(to_numbers(where, words[1:], names[1:]))
        check(where, table[-1])
    return stamps, np.array(table)


def check_present(images: list[Path], listed_in: str) -> None:
    """Raise InputError if images are missing or empty; it names the first."""
    lacking = [image for image in images if not _has_content(image)]
    if lacking:
        more = f" and {len(lacking) - 1} more" if len(lacking) > 1 else ""
        problem = f"is missing or empty{more}, of {len(images)} listed in {listed_in}"
        raise InputError(str(lacking[0]), problem, "copy the folder again, it is cut short")


def _has_content(path: Path) -> bool:
    """Return True for a regular file that is not empty."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return False
    return stat.S_ISREG(status.st_mode) and status.st_size > 0


def to_number(where: str, value: Any) -> float:
    """One finite number of a YAML file. Raises InputError for anything else."""
    try:
        number = np.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        raise InputError(where, f"{value!r} is not a finite number", "correct it")
    return float(number)


def number_at(path: Path | str, values: dict[Any, Any], key: str) -> float:
    """The finite number under a key of a YAML file. Raises InputError otherwise."""
    if key not in values:
        raise InputError(f"{path}: {key}", "is missing", "add it")
    return to_number(f"{path}: {key}", values[key])


def numbers_at(where: Path | str, values: dict[Any, Any], key: str, lengths: tuple[int, ...]) -> list[float]:
    """The numbers of a list under a key of a YAML file. Raises InputError unless it has an allowed length."""
    place = f"{where}: {key}"
    if key not in values:
        raise InputError(place, "is missing", "add it")
    listed = values[key]
    if not isinstance(listed, list) or len(listed) not in lengths:
        wanted = " or ".join(str(length) for length in sorted(set(lengths)))
        raise InputError(place, f"{listed!r} is no list of {wanted} numbers", "correct it")
    return [to_number(place, value) for value in listed]
