"""Files beside sequences in every form: segments, truth per frame, provenance, ORB-SLAM3's settings."""

import csv
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given, read_json
from dslab.sim.io import layout
from dslab.sim.io.clock import ORIGIN_KEY
from dslab.sim.io.orbslam3 import write_orbslam3_settings
from dslab.sim.io.text import check_words, read_rows, to_numbers
from dslab.sim.sequence import SegmentTruth, Sequence

_LONGEST_EXPOSURE_S = 3600.0


def write_sidecars(sequence: Sequence, folder: Path) -> None:
    """Write segments.json, meta.json, ORB-SLAM3's settings and, if any, frame_truth.csv."""
    write_orbslam3_settings(sequence.camera, folder)
    segments = [asdict(segment) for segment in sequence.segments]
    (folder / layout.SEGMENTS_FILE).write_text(json.dumps(segments, indent=1) + "\n")
    meta = {"name": sequence.name, **sequence.meta}
    (folder / layout.META_FILE).write_text(json.dumps(meta, indent=1) + "\n")
    if sequence.frame_truth:
        with (folder / layout.FRAME_TRUTH_FILE).open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["frame", *sequence.frame_truth])
            for frame, row in enumerate(zip(*sequence.frame_truth.values(), strict=True)):
                writer.writerow([frame, *(f"{value:.6g}" for value in row)])


def read_sidecars(folder: Path, frames: int, origin: int = 0) -> dict[str, Any]:
    """Read the fields ``name``, ``segments``, ``meta`` and ``frame_truth`` of a ``Sequence``.

    Args:
        folder: may hold the files; without them the fields are empty and the name is the folder's.
        frames: number of frames that they must fit.
        origin: nanoseconds at 0 s, kept in ``meta``; 0 for none.

    Raises:
        InputError: a file is malformed or does not fit.
    """
    meta = _read_meta(folder / layout.META_FILE) | ({ORIGIN_KEY: origin} if origin else {})
    return {
        "name": meta.get("name") or folder.resolve().name,
        "segments": _read_segments(folder / layout.SEGMENTS_FILE, frames),
        "meta": meta,
        "frame_truth": _read_columns(folder / layout.FRAME_TRUTH_FILE, frames),
    }


def check_exposure(where: str, exposure_s: float) -> None:
    """Raise InputError for a shutter time that is negative or absurd."""
    if not 0 <= exposure_s <= _LONGEST_EXPOSURE_S:
        problem = f"{exposure_s:g} s is no shutter time"
        raise InputError(where, problem, f"give 0 to {_LONGEST_EXPOSURE_S:g} s")


def _read_meta(path: Path) -> dict[str, Any]:
    """Read meta.json; empty without the file."""
    meta = read_json(path, dict) if is_given(path) else {}
    if not isinstance(meta.get("name", ""), str):
        raise InputError(f"{path}: name", f"{meta['name']!r} is no name", "give text")
    # Both are used as numbers; all else is only handed on.
    for key in ("seed", ORIGIN_KEY):
        value = meta.get(key, 0)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**64:
            raise InputError(f"{path}: {key}", f"{value!r} is no whole number from 0", "correct it")
    return meta


def _read_segments(path: Path, frames: int) -> tuple[SegmentTruth, ...]:
    """Read segments.json; empty without the file."""
    segments = []
    for index, record in enumerate(read_json(path, list) if is_given(path) else ()):
        try:
            segments.append(SegmentTruth.from_record(record, frames))
        except ValueError as error:
            problem = f"is no segment of this sequence ({error})"
            raise InputError(f"{path}: [{index}]", problem, "write the folder again") from None
    return tuple(segments)


def _read_columns(path: Path, frames: int) -> dict[str, np.ndarray]:
    """Read the columns of frame_truth.csv, (N,) each; empty without the file."""
    if not is_given(path):
        return {}
    (_, header), *lines = list(read_rows(path, "", ",")) or [("", [])]
    if header[:1] != ["frame"] or len(set(header)) < len(header) or not all(header):
        raise InputError(f"{path}:1", "is no header of different names, frame first", "copy the file again")
    if len(lines) != frames:
        raise InputError(
            str(path), f"has {len(lines)} rows for {frames} frames", "delete it or copy it again"
        )
    rows = []
    for frame, (where, words) in enumerate(lines):
        check_words(where, words, header)
        rows.append(to_numbers(where, words, header))
        if rows[-1][0] != frame:
            raise InputError(f"{where}: frame", f"{words[0]} stands where {frame} belongs", "sort the rows")
    table = np.array(rows)
    columns = {name: table[:, column] for column, name in enumerate(header) if name != "frame"}
    for frame, exposure_s in enumerate(columns.get("exposure_s", ())):
        check_exposure(f"{lines[frame][0]}: exposure_s", exposure_s)
    return columns
