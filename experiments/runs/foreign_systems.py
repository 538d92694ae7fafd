"""Another SLAM system as a program: run on the same frames, judged by the same code.

The program is any command line that takes a TUM-form folder and a result folder and writes into the latter
``trajectory.txt`` (TUM form) and ``summary.json`` with at least ``cpu_ms_median`` (tracking, per frame),
``tracked`` and ``frames``; ``first_tracked_frame`` and ``cpu_s`` (of all its threads, with its start and the
reading of images) are optional. Memory is not compared: the peak that a child process reports may be
inherited from this process.
"""

import hashlib
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_folder, is_given, read_json
from dslab.sim.cache import FolderCache, content_key
from dslab.sim.io.forms import Form, detect_form, write_sequence
from dslab.sim.io.text import check_words, read_rows, to_numbers
from dslab.sim.io.truth import check_position, check_quaternion, half_interval_s, nearest, poses_of
from dslab.sim.sequence import Sequence
from dslab.sim.unfinished import scratch_folder
from dslab.slam.core.results import MapTrajectory

_TUM_NAMES = ["stamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"]


@dataclass(frozen=True)
class ForeignRun:
    """Result of one run of a peer.

    Attributes:
        cpu_ms_median: CPU milliseconds of tracking, median over the frames.
        tracked: number of frames with a pose.
        first_tracked_frame: None if not given.
        trajectory: its path; None if it tracked nothing.
        cpu_s: CPU seconds of the whole process; None if not given.
    """

    cpu_ms_median: float
    tracked: int
    first_tracked_frame: int | None
    trajectory: MapTrajectory | None
    cpu_s: float | None = None


class ForeignSystem:
    """A program to compare with, on one sequence; see :func:`open_foreign_system`.

    Args:
        command: its words, without the two folders.
        sequence: the content of the folder.
        sequence_dir: the TUM-form folder.
        scratch: folder for result folders.
        kept: where results are kept; None keeps none.
    """

    def __init__(
        self,
        command: list[str],
        sequence: Sequence,
        sequence_dir: Path,
        scratch: Path,
        kept: FolderCache | None = None,
    ) -> None:
        self._command, self._sequence = command, sequence
        self._sequence_dir, self._scratch, self._kept = sequence_dir, scratch, kept
        self._runs = 0

    def run(self) -> ForeignRun:
        """Run the program once, or read its run of the same number over the same frames if that was kept.

        The last line of its errors is shown if it fails.

        Raises:
            InputError: it cannot be started, fails, or leaves files that are missing or not valid.
        """
        if self._kept is None:
            return self._started(Path(tempfile.mkdtemp(prefix="peer-", dir=self._scratch)))
        key = content_key([self._command, _digest(self._sequence), self._runs])
        self._runs += 1
        found = self._kept.load(key, lambda folder: read_foreign_run(folder, self._sequence))
        if found is None:
            with self._kept.create(key) as out_dir:
                found = self._started(out_dir)
        return found

    def _started(self, out_dir: Path) -> ForeignRun:
        words = [*self._command, str(self._sequence_dir), str(out_dir)]
        where = f"--peer: {shlex.join(self._command)}"
        try:
            ended = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, check=False)
        except OSError as error:
            raise InputError(where, f"cannot be run ({error.strerror})", "check the command") from None
        if ended.returncode != 0:
            lines = ended.stderr.decode(errors="replace").strip().splitlines()
            last = lines[-1].strip() if lines else "no message"
            problem = f"ended with exit code {ended.returncode}: {last}"
            raise InputError(where, problem, "run it by hand on a sequence folder")
        return read_foreign_run(out_dir, self._sequence)


@contextmanager
def open_foreign_system(
    command: str,
    source: str,
    sequence: Sequence,
    progress: Callable[[str, int, int], None] | None = None,
    kept: Path | None = None,
) -> Iterator[ForeignSystem]:
    """Open a peer and the folder that it reads, for the duration of the block.

    Args:
        command: command line with options, without the two folders.
        source: source of the sequence; the peer reads a TUM-form folder in place, anything else is written to
            a temporary one.
        sequence: the frames.
        progress: called with (step, done, total) while writing.
        kept: folder in which its result folders are kept; what is there of the same command and frames is
            read instead of running it again.

    Raises:
        InputError: the command is empty or there is no such program; the disk is full.
    """
    words = check_command(command)
    with scratch_folder() as scratch:
        folder = Path(source)
        if not (is_folder(folder) and detect_form(folder) is Form.TUM):
            folder = scratch / "sequence"
            write_sequence(sequence, folder, Form.TUM, progress=progress)
        cache = None if kept is None else FolderCache(kept, max_bytes=sys.maxsize)
        yield ForeignSystem(words, sequence, folder.resolve(), scratch, cache)


def _digest(sequence: Sequence) -> str:
    """Hash of all that a peer sees: images, stamps, camera."""
    digest = hashlib.sha256(repr((sequence.camera, sequence.stamps_s.tobytes())).encode())
    for index in range(len(sequence)):
        digest.update(np.ascontiguousarray(sequence.frames[index]))
    return digest.hexdigest()


def check_command(command: str) -> list[str]:
    """Split a command line into words. Raises InputError if it is not valid or the program is missing."""
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise InputError(f"--peer: {command}", f"is no command line ({error})", "check its quotes") from None
    if not words:
        raise InputError("--peer", "is empty", "give the command that runs the other system")
    if shutil.which(words[0]) is None:
        raise InputError(f"--peer: {words[0]}", "no such command", "check its path, or install it")
    return words


def read_foreign_run(out_dir: Path, sequence: Sequence) -> ForeignRun:
    """Read the result files of a peer's run.

    Raises:
        InputError: a file is missing, malformed, or does not belong to the sequence.
    """
    path = out_dir / "summary.json"
    if not is_given(path):
        raise InputError(str(path), "the peer has not written it", "see `dslab bench --help`")
    summary = read_json(path, dict)
    frames = _count(path, summary, "frames", None)
    if frames != len(sequence):
        problem = f"is {frames}, the sequence has {len(sequence)}"
        raise InputError(f"{path}: frames", problem, "count every frame that was given")
    tracked = _count(path, summary, "tracked", frames)
    has_first = summary.get("first_tracked_frame") is not None
    return ForeignRun(
        cpu_ms_median=_number(path, summary, "cpu_ms_median"),
        tracked=tracked,
        first_tracked_frame=_count(path, summary, "first_tracked_frame", frames - 1) if has_first else None,
        trajectory=_read_trajectory(out_dir / "trajectory.txt", sequence, tracked),
        cpu_s=None if summary.get("cpu_s") is None else _number(path, summary, "cpu_s"),
    )


def _read_trajectory(path: Path, sequence: Sequence, tracked: int) -> MapTrajectory | None:
    """Read the poses and assign each to the frame of its stamp; the file is optional if none is tracked."""
    if tracked == 0 and not is_given(path):
        return None
    rows: list[list[float]] = []
    for where, words in read_rows(path, "see `dslab bench --help`"):
        check_words(where, words, _TUM_NAMES)
        rows.append(to_numbers(where, words, _TUM_NAMES))
        check_position(where, rows[-1][1:4])
        check_quaternion(f"{where}: qx qy qz qw", rows[-1][4:])
    if not rows:
        return None
    table = np.array(rows)
    tolerance_s = half_interval_s(sequence.stamps_s, sequence.camera.fps)
    frames = nearest(sequence.stamps_s, table[:, 0], tolerance_s)
    if (frames < 0).any():
        problem = f"{table[frames < 0, 0][0]:.6f} s is the time of no frame"
        raise InputError(f"{path}: stamp", problem, "keep the stamps of rgb.txt")
    frames, rows_kept = np.unique(frames, return_index=True)
    table = table[rows_kept]
    return MapTrajectory(0, frames, sequence.stamps_s[frames], poses_of(table[:, 1:4], table[:, 4:]))


def _number(path: Path, summary: dict, field: str) -> float:
    value = summary.get(field)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < np.inf:
        raise InputError(f"{path}: {field}", f"{value!r} is no number from 0 up", "correct the peer")
    return float(value)


def _count(path: Path, summary: dict, field: str, most: int | None) -> int:
    value = _number(path, summary, field)
    if value != int(value) or (most is not None and value > most):
        wanted = "a whole number" if most is None else f"a whole number up to {most}"
        raise InputError(f"{path}: {field}", f"{value:g} is not {wanted}", "correct the peer")
    return int(value)
