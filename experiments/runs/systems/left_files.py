"""What a program has left: its poses and the figures of its frames, assigned to the frames of a sequence."""

import csv
import io
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dslab.experiments.runs.ending import FINISHED, Ending, EndKind
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import TABLE_BYTES, is_given, read_text
from dslab.sim.io.text import read_rows
from dslab.sim.io.truth import half_interval_s, nearest, poses_of
from dslab.sim.sequence import Sequence
from dslab.slam.core.results import MapTrajectory

_COLUMNS = {
    "tum": "stamp tx ty tz qx qy qz qw",
    "euroc": "timestamp_ns px py pz qw qx qy qz",
    "kitti": "12 numbers of rows 1 to 3 of the matrix",
}
NUMBERS = {"ms": float, "cpu_ms": float, "map_id": int, "mapping_cpu_ms": float, "loop_cpu_ms": float}
"""Columns of the table of frames, as the fields of a ``TrackingResult``; times over all stages."""
_MOST_POSITION = 1e9
_MOST_SKEW = 1e-2


@dataclass(frozen=True)
class LeftPoses:
    """The poses in a file.

    Attributes:
        trajectory: of the frames that have one; None for none.
        fault: what is wrong with the file; finished if nothing is.
    """

    trajectory: MapTrajectory | None
    fault: Ending = FINISHED


@dataclass(frozen=True)
class LeftFrames:
    """The figures of frames in a file, by index of the frame.

    Attributes:
        states: word of the system's own.
        numbers: by name, those of ``NUMBERS`` that it says.
        fault: what is wrong with the file; finished if nothing is.
    """

    states: dict[int, str] = field(default_factory=dict)
    numbers: dict[int, dict[str, float]] = field(default_factory=dict)
    fault: Ending = FINISHED


def read_maps(folder: Path, name: str, form: str, sequence: Sequence) -> list[LeftPoses]:
    """Read the files of poses of a name with one ``*``, the number of a map; that with most poses first."""
    pattern = re.compile(re.escape(name).replace(r"\*", r"(\d{1,9})"))
    numbered = [(pattern.fullmatch(file.relative_to(folder).as_posix()), file) for file in folder.glob(name)]
    maps = sorted((int(match[1]), file) for match, file in numbered if match)
    found = [read_poses(file, form, sequence, map_id) for map_id, file in maps]
    return sorted(found, key=lambda of: -len(of.trajectory.frames) if of.trajectory else 0)


def read_poses(path: Path, form: str, sequence: Sequence, map_id: int = 0) -> LeftPoses:
    """Read a file of poses; whatever is wrong with it is said in the result.

    Args:
        path: the file; if there is none, no frame has a pose.
        form: ``tum``, ``kitti`` (a row per frame, in order) or ``euroc``.
        sequence: the frames that the program was given.
        map_id: number of the map.

    Returns:
        The poses. Rows that are not finite are left out and the first is named; of a file that is malformed
        or has stamps of no frame nothing is kept.
    """
    if not is_given(path):
        return LeftPoses(None)
    try:
        table = _table(path, form)
    except InputError as error:
        return LeftPoses(None, Ending(EndKind.UNREADABLE, f"{error.where}: {error.problem}", error.remedy))
    frames, fault = _frames_of(path, table, form, sequence) if len(table) else (np.empty(0, int), None)
    if fault is not None:
        return LeftPoses(None, fault)
    T = _matrices(table, form)
    finite = np.isfinite(T).all(axis=(1, 2))
    skewed = finite.copy()
    skewed[finite] = _no_rotations(T[finite])
    if skewed.any():
        remedy = f"write `{_COLUMNS[form]}`, with rotations"
        return LeftPoses(None, Ending(EndKind.UNREADABLE, f"{_row(path, skewed)}: is no pose", remedy))
    fault = FINISHED
    if not finite.all():
        remedy = "leave out frames without a pose"
        fault = Ending(EndKind.NOT_FINITE, f"{_row(path, ~finite)}: the pose is not finite", remedy)
    kept, first = np.unique(frames[finite], return_index=True)
    found = MapTrajectory(map_id, kept, sequence.stamps_s[kept], T[finite][first]) if len(kept) else None
    return LeftPoses(found, fault)


def read_frames(path: Path, sequence: Sequence) -> LeftFrames:
    """Read the CSV of the frames; arguments and faults as :func:`read_poses`."""
    found = LeftFrames()
    if not is_given(path):
        return found
    try:
        table = csv.DictReader(io.StringIO(read_text(path, TABLE_BYTES)))
        if "stamp_s" not in (table.fieldnames or ()):
            raise InputError(str(path), "has no column stamp_s", "write a header with stamp_s")
        rows = list(table)
        stamps_s = np.array([float(row["stamp_s"]) for row in rows])
        if not np.isfinite(stamps_s).all():
            raise ValueError("a stamp is not finite")
        near = nearest(sequence.stamps_s, stamps_s, _tolerance_s(sequence)) if rows else []
        for frame, row in zip(map(int, near), rows, strict=True):
            if frame < 0:
                continue
            found.states[frame] = (row.get("state") or "").strip()
            found.numbers[frame] = {n: of(row[n]) for n, of in NUMBERS.items() if row.get(n)}
    except InputError as error:
        return LeftFrames(fault=Ending(EndKind.UNREADABLE, f"{error.where}: {error.problem}", error.remedy))
    except (ValueError, TypeError, csv.Error) as error:
        message = " ".join(f"{path.name}: is no table of frames ({error})".split())
        return LeftFrames(fault=Ending(EndKind.UNREADABLE, message, "write stamp_s,state,ms,cpu_ms"))
    return found


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


def _frames_of(
    path: Path, table: np.ndarray, form: str, sequence: Sequence
) -> tuple[np.ndarray, Ending | None]:
    """Index of each row's frame, or what is wrong with the stamps."""
    if form == "kitti":
        if len(table) != len(sequence):
            problem = f"{path.name}: has {len(table)} rows, the sequence has {len(sequence)} frames"
            return np.empty(0, int), Ending(EndKind.OTHER_STAMPS, problem, "write a row per frame")
        return np.arange(len(table)), None
    stamps_s = table[:, 0] / (1e9 if form == "euroc" else 1.0)
    known = np.isfinite(stamps_s)
    frames = np.full(len(table), -1)
    frames[known] = nearest(sequence.stamps_s, stamps_s[known], _tolerance_s(sequence))
    if (frames < 0).any():
        first = int(np.flatnonzero(frames < 0)[0])
        problem = f"{path.name}: row {first + 1}: {stamps_s[first]:.6f} s is the time of no frame"
        return frames, Ending(EndKind.OTHER_STAMPS, problem, "keep the stamps of the frames")
    return frames, None


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


def _no_rotations(T: np.ndarray) -> np.ndarray:
    """(M,) bool: True where a finite pose has no rotation, or a position beyond sense."""
    R = T[:, :3, :3]
    skew = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2)) > _MOST_SKEW
    return skew | (np.linalg.det(R) <= 0) | (np.abs(T[:, :3, 3]).max(axis=1) > _MOST_POSITION)
