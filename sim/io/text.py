"""Text files of numbers; every fault is one line with file, line, field and remedy."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from scenarios.errors import InputError


def read_rows(path: Path, remedy: str, separator: str | None = None) -> list[tuple[str, list[str]]]:
    """Read ``file:line`` and the words of every line that is neither empty nor a comment.

    Args:
        path: the file.
        remedy: advice if the file does not exist.
        separator: between words; None for white space.

    Raises:
        InputError: the file is missing or no text.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise InputError(str(path), "no such file", remedy) from None
    except (OSError, UnicodeDecodeError):
        raise InputError(str(path), "is no readable text", "copy the folder again") from None
    rows = []
    for number, line in enumerate(lines, start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            rows.append((f"{path}:{number}", [word.strip() for word in line.split(separator)]))
    return rows


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
            value = float(word)
        except ValueError:
            value = float("nan")
        if not np.isfinite(value):
            raise InputError(f"{where}: {name}", f"{word!r} is not a finite number", "correct it")
        values.append(value)
    return values


def to_nanoseconds(where: str, word: str) -> int:
    """A stamp in whole nanoseconds. Raises InputError for any other word."""
    if not re.fullmatch(r"\d{1,19}", word):
        raise InputError(f"{where}: timestamp", f"{word!r} is no stamp in nanoseconds", "write whole numbers")
    return int(word)


def check_order(where: str, earlier: list[Any], stamp: float) -> None:
    """Raise InputError unless a stamp comes after the last of the earlier ones."""
    if earlier and stamp <= earlier[-1]:
        shown, last = (f"{s}" if isinstance(s, int) else f"{s:.6f}" for s in (stamp, earlier[-1]))
        problem = f"{shown} does not come after {last}"
        raise InputError(f"{where}: stamp", problem, "sort the lines by stamp and remove doubles")


def check_present(images: list[Path], listed_in: str) -> None:
    """Raise InputError if images are missing or empty; it names the first."""
    lacking = [image for image in images if not image.is_file() or image.stat().st_size == 0]
    if lacking:
        more = f" and {len(lacking) - 1} more" if len(lacking) > 1 else ""
        problem = f"is missing or empty{more}, of {len(images)} listed in {listed_in}"
        raise InputError(str(lacking[0]), problem, "copy the folder again, it is cut short")


def read_json(path: Path, kind: type) -> Any:
    """The content of a JSON file, None without it. Raises InputError for another type."""
    if not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(str(path), f"is no valid JSON ({error})", "correct it or delete it") from None
    if not isinstance(content, kind):
        raise InputError(str(path), f"holds no {kind.__name__}", "correct it or delete it")
    return content


def read_yaml(path: Path, keys: str) -> dict[Any, Any]:
    """Read the mapping of a YAML file.

    Args:
        path: the file; OpenCV's ``%YAML:1.0`` line is skipped.
        keys: the keys it should hold, for the remedy.

    Raises:
        InputError: the file is missing, no YAML, or no mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
        values = yaml.safe_load(re.sub(r"^%YAML.*$", "", text, flags=re.MULTILINE))
    except FileNotFoundError:
        raise InputError(str(path), "no such file", f"add it with the keys {keys}") from None
    except (OSError, UnicodeDecodeError, ValueError, yaml.YAMLError):
        raise InputError(str(path), "is no readable YAML", "correct it or copy it again") from None
    if not isinstance(values, dict):
        raise InputError(str(path), "holds no intrinsics", f"add the keys {keys}")
    return values


def to_number(where: str, value: Any) -> float:
    """One finite number of a YAML file. Raises InputError for anything else."""
    try:
        number = np.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        raise InputError(where, f"{value!r} is not a finite number", "correct it")
    return float(number)


def number_at(path: Path, values: dict[Any, Any], key: str) -> float:
    """The finite number under a key of a YAML file. Raises InputError otherwise."""
    if key not in values:
        raise InputError(f"{path}: {key}", "is missing", "add it")
    return to_number(f"{path}: {key}", values[key])
