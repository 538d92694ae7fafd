"""What a program has left: its poses and the figures of its frames, assigned to the frames of a sequence."""

import csv
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dslab.experiments.runs.ending import Ending, EndKind
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import TABLE_BYTES, is_given, read_text
from dslab.sim.io.text import read_rows
from dslab.sim.io.truth import MOST_POSITION_M, half_interval_s, nearest, poses_of
from dslab.sim.sequence import Sequence
from dslab.slam.core.results import MapTrajectory

_COLUMNS = {
    "tum": "stamp tx ty tz qx qy qz qw",
    "euroc": "timestamp_ns px py pz qw qx qy qz",
    "kitti": "12 numbers of rows 1 to 3 of the matrix",
}
NUMBERS = {"ms": float, "cpu_ms": float, "map_id": int, "mapping_cpu_ms": float, "loop_cpu_ms": float}
"""Columns of the table of frames, as the fields of a ``TrackingResult``; times over all stages."""
_MOST_FIGURE = 1e9  # milliseconds of a frame, or number of a map
_MOST_SKEW = 1e-2


class LeftFaultError(Exception):
    """What is wrong with a file; ``ending`` says it."""

    def __init__(self, kind: EndKind, message: str, remedy: str) -> None:
        super().__init__(message)
        self.ending = Ending(kind, message, remedy)


@contextmanager
def noted(faults: list[Ending], file: str, remedy: str) -> Iterator[None]:
    """Note what is wrong with a file that a program has left, whatever it is."""
    try:
        yield
    except LeftFaultError as fault:
        faults.append(fault.ending)
    except InputError as error:
        faults.append(Ending(EndKind.UNREADABLE, f"{error.where}: {error.problem}", error.remedy))
    except (ValueError, TypeError, KeyError, RecursionError, csv.Error) as error:
        faults.append(Ending(EndKind.UNREADABLE, " ".join(f"{file}: {error}".split()), remedy))


def read_maps(
    folder: Path, name: str, form: str, sequence: Sequence, faults: list[Ending]
) -> tuple[MapTrajectory, ...]:
    """Read the poses of one map or, with a ``*`` in the name, the number of a map, of every map.

    Args:
        folder: of the program's files.
        name: of its files of poses; if there is none, no frame has a pose.
        form: ``tum``, ``kitti`` (a row per frame, in order) or ``euroc``.
        sequence: the frames that the program was given.
        faults: gets what is wrong with the files.

    Returns:
        The maps with poses, that with most first. Rows that are not finite are left out and the first is
        named; of a file that is malformed or has stamps of no frame nothing is kept.
    """
    pattern = re.compile(re.escape(name).replace(r"\*", r"(\d{1,9})"))
    named = ((pattern.fullmatch(file.relative_to(folder).as_posix()), file) for file in folder.glob(name))
    files = (
        sorted((int(match[1]), file) for match, file in named if match)
        if "*" in name
        else [(0, folder / name)]
    )
    found = []
    for map_id, file in files:
        if is_given(file):
            with noted(faults, file.name, f"write `{_COLUMNS[form]}`"):
                frames, T = _poses(file, form, sequence, faults)
                if len(frames):
                    found.append(MapTrajectory(map_id, frames, sequence.stamps_s[frames], T))
    return tuple(sorted(found, key=lambda path: -len(path.frames)))


def read_frames(path: Path, sequence: Sequence, faults: list[Ending]) -> dict[int, dict[str, Any]]:
    """Read the CSV of the frames: by index ``state``, a word of the system's own, and NUMBERS."""
    found: dict[int, dict[str, Any]] = {}
    if not is_given(path):
        return found
    with noted(faults, f"{path.name}: is no table of frames", "write stamp_s,state,ms,cpu_ms"):
        table = csv.DictReader(io.StringIO(read_text(path, TABLE_BYTES)))
        if "stamp_s" not in (table.fieldnames or ()):
            raise InputError(str(path), "has no column stamp_s", "write a header with stamp_s")
        rows = list(table)
        stamps_s = np.array([float(row["stamp_s"]) for row in rows])
        if not np.isfinite(stamps_s).all():
            raise ValueError("a stamp is not finite")
        near = nearest(sequence.stamps_s, stamps_s, _tolerance_s(sequence)) if rows else []
        for frame, row in zip(map(int, near), rows, strict=True):
            if frame >= 0:
                numbers = {name: _figure(name, row[name]) for name in NUMBERS if row.get(name)}
                found[frame] = {"state": (row.get("state") or "").strip(), **numbers}
        return found
    return {}


def _figure(name: str, word: str) -> float | int:
    """A figure of a frame. Raises ValueError for one that no reader of results takes."""
    figure = NUMBERS[name](word)
    if not 0 <= figure <= _MOST_FIGURE:
        raise ValueError(f"{name} is {word[:20]}, not from 0 to {_MOST_FIGURE:g}")
    return figure


def _poses(path: Path, form: str, sequence: Sequence, faults: list[Ending]) -> tuple[np.ndarray, np.ndarray]:
    """(n,) frames, increasing, and (n, 4, 4) their poses."""
    table = _table(path, form)
    frames, T = _frames_of(path, table, form, sequence), _matrices(table, form)
    finite = np.isfinite(T).all(axis=(1, 2))
    skewed = finite.copy()
    skewed[finite] = no_rotations(T[finite])
    if skewed.any():
        remedy = f"write `{_COLUMNS[form]}`, with rotations"
        raise LeftFaultError(EndKind.UNREADABLE, f"{_row(path, skewed)}: is no pose", remedy)
    if not finite.all():
        message, remedy = f"{_row(path, ~finite)}: the pose is not finite", "leave out frames without a pose"
        faults.append(Ending(EndKind.NOT_FINITE, message, remedy))
    kept, first = np.unique(frames[finite], return_index=True)
    return kept, T[finite][first]


def _row(path: Path, faulty: np.ndarray) -> str:
    """Name the first row at fault."""
    return f"{path.name}: row {int(np.flatnonzero(faulty)[0]) + 1}"


def _table(path: Path, form: str) -> np.ndarray:
    """(M, n) numbers of a file. Raises InputError if it is no such table."""
    names = _COLUMNS[form]
    count = 12 if form == "kitti" else len(names.split())
    rows = read_rows(path, "", "," if form == "euroc" else None)
    return np.array([_numbers(where, words, count, names) for where, words in rows]).reshape(-1, count)


def _tolerance_s(sequence: Sequence) -> float:
    return half_interval_s(sequence.stamps_s, sequence.camera.fps)


def _numbers(where: str, words: list[str], count: int, names: str) -> list[float]:
    """The numbers of a row, NaN and infinities among them. Raises InputError for any other word."""
    if len(words) != count:
        problem = f"{len(words)} numbers where {count} belong"
        raise InputError(where, problem, f"write `{names}`; the file may be cut short")
    try:
        if any("_" in word or not word.isascii() for word in words):
            raise ValueError
        return [float(word) for word in words]
    except ValueError:
        raise InputError(where, f"{' '.join(words)[:60]!r} are no numbers", f"write `{names}`") from None


def _frames_of(path: Path, table: np.ndarray, form: str, sequence: Sequence) -> np.ndarray:
    """Index of each row's frame."""
    if form == "kitti":
        if len(table) not in (0, len(sequence)):
            problem = f"{path.name}: has {len(table)} rows, the sequence has {len(sequence)} frames"
            raise LeftFaultError(EndKind.OTHER_STAMPS, problem, "write a row per frame")
        return np.arange(len(table))
    stamps_s = table[:, 0] / (1e9 if form == "euroc" else 1.0)
    known = np.isfinite(stamps_s)
    frames = np.full(len(table), -1)
    if known.any():
        frames[known] = nearest(sequence.stamps_s, stamps_s[known], _tolerance_s(sequence))
    if (frames < 0).any():
        first = int(np.flatnonzero(frames < 0)[0])
        problem = f"{path.name}: row {first + 1}: {stamps_s[first]:.6f} s is the time of no frame"
        raise LeftFaultError(EndKind.OTHER_STAMPS, problem, "keep the stamps of the frames")
    return frames


def _matrices(table: np.ndarray, form: str) -> np.ndarray:
    """(M, 4, 4), NaN where a number is not finite or a quaternion has no length."""
    if form == "kitti":
        T = np.tile(np.eye(4), (len(table), 1, 1))
        T[:, :3] = table.reshape(-1, 3, 4)
        return T
    quat_xyzw = table[:, 4:8] if form == "tum" else np.roll(table[:, 4:8], -1, axis=1)
    usable = np.isfinite(table[:, 1:8]).all(axis=1)
    T = np.full((len(table), 4, 4), np.nan)
    length = np.linalg.norm(quat_xyzw[usable], axis=1)
    # Rotations cannot be made of what is no quaternion: such a matrix is refused afterwards.
    unit = np.where((np.abs(length - 1) < _MOST_SKEW)[:, None], quat_xyzw[usable], [0.0, 0.0, 0.0, 1.0])
    T[usable] = poses_of(table[usable, 1:4], unit)
    broken = np.flatnonzero(usable)[np.abs(length - 1) >= _MOST_SKEW]
    T[broken, :3, :3] = 0.0
    return T


def no_rotations(T: np.ndarray) -> np.ndarray:
    """(M,) bool: True where a finite pose has no rotation, or a position beyond sense."""
    R = T[:, :3, :3]
    with np.errstate(all="ignore"):  # squares of numbers beyond sense are infinite, or none
        near = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2)) <= _MOST_SKEW
        return ~(near & (np.linalg.det(R) > 0) & (np.abs(T[:, :3, 3]).max(axis=1) <= MOST_POSITION_M))
