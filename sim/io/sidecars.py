"""Files of simulated sequences in every form: segments, truth per frame, provenance."""

import csv
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.errors import InputError
from sim.io import layout
from sim.io.text import read_json, to_numbers
from sim.sequence import SegmentTruth, Sequence


def write_sidecars(sequence: Sequence, folder: Path) -> None:
    """Write segments.json, meta.json and, if any, frame_truth.csv."""
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


def read_sidecars(folder: Path, frames: int) -> dict[str, Any]:
    """Read the fields ``name``, ``segments``, ``meta`` and ``frame_truth`` of a ``Sequence``.

    Args:
        folder: may hold the files; without them the fields are empty and the name is the folder's.
        frames: number of frames that they must fit.

    Raises:
        InputError: a file is malformed or does not fit.
    """
    meta = read_json(folder / layout.META_FILE, dict) or {}
    return {
        "name": str(meta.get("name") or folder.resolve().name),
        "segments": _read_segments(folder / layout.SEGMENTS_FILE, frames),
        "meta": meta,
        "frame_truth": _read_columns(folder / layout.FRAME_TRUTH_FILE, frames),
    }


def _read_segments(path: Path, frames: int) -> tuple[SegmentTruth, ...]:
    records = read_json(path, list) or []
    segments = []
    for index, record in enumerate(records):
        where = f"{path}: [{index}]"
        try:
            segment = SegmentTruth.from_record(record)
            inside = -1 <= segment.first_frame <= segment.last_frame < frames
        except (AttributeError, TypeError, ValueError) as error:
            raise InputError(where, f"is no segment ({error})", "write the folder again") from None
        if not inside:
            span = f"{segment.first_frame} to {segment.last_frame}"
            raise InputError(where, f"frames {span} are not in the sequence", "write the folder again")
        segments.append(segment)
    return tuple(segments)


def _read_columns(path: Path, frames: int) -> dict[str, np.ndarray]:
    """Read the columns of frame_truth.csv, (N,) each; empty without the file."""
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = list(csv.reader(file)) or [[]]
    if len(rows) != frames:
        raise InputError(str(path), f"has {len(rows)} rows for {frames} frames", "delete it or copy it again")
    for index, row in enumerate(rows):
        if len(row) != len(header):
            problem = f"{len(row)} numbers where {len(header)} belong"
            raise InputError(f"{path}:{index + 2}", problem, "delete the file or copy it again")
    table = np.array([to_numbers(f"{path}:{i + 2}", row, header) for i, row in enumerate(rows)])
    return {name: table[:, column] for column, name in enumerate(header) if name != "frame"}
