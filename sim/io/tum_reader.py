"""Reads a TUM-form folder; every fault is one line with file, line, field and remedy."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from scenarios.errors import InputError
from sim.camera import Intrinsics
from sim.io import layout
from sim.io.camera_file import read_camera
from sim.io.images import DepthFolder, GrayFolder
from sim.sequence import SegmentTruth, Sequence


def load_sequence(path: str | Path) -> Sequence:
    """A sequence from a TUM-form folder; see ``sim.io.layout``.

    Existence of every image is checked now, its content when the frame is read. Ground truth is given to
    the frames within half a frame interval of it, without interpolation.

    Args:
        path: the folder.

    Raises:
        InputError: the folder or a file of it is missing, empty, cut short, malformed or absurd. Reading a
            frame raises it too, if the image is unreadable or of another size.
    """
    folder = Path(path)
    if not folder.is_dir():
        problem = "is no folder" if folder.exists() else "no such folder"
        raise InputError(str(folder), problem, "give a folder with rgb.txt, camera.yaml and images")
    camera = read_camera(folder / layout.CAMERA_FILE)
    stamps_s, images = _read_list(folder / layout.FRAMES_FILE)
    frames = GrayFolder(images, (camera.height_px, camera.width_px))
    frames[0]  # a wrong size shows in the first image already
    interval_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else 1 / camera.fps
    meta = _read_json(folder / layout.META_FILE, dict) or {}
    return Sequence(
        name=str(meta.get("name") or folder.resolve().name),
        camera=camera,
        stamps_s=stamps_s,
        frames=frames,
        T_world_cam=_read_truth(folder / layout.TRUTH_FILE, stamps_s, interval_s / 2),
        depths=_read_depths(folder / layout.DEPTH_FILE, camera, len(stamps_s)),
        segments=_read_segments(folder / layout.SEGMENTS_FILE, len(stamps_s)),
        meta=meta,
        frame_truth=_read_columns(folder / layout.FRAME_TRUTH_FILE, len(stamps_s)),
    )


def _read_list(path: Path) -> tuple[np.ndarray, list[Path]]:
    """(N,) stamps and the image paths of a list of frames."""
    stamps: list[float] = []
    images: list[Path] = []
    for where, words in _rows(path, "give a folder with the list of frames, `stamp filename` per line"):
        if len(words) != 2:
            problem = f"{len(words)} words where stamp and filename belong"
            raise InputError(where, problem, "write `stamp filename`; the file may be cut short")
        stamp_s = _numbers(where, words[:1], ["stamp"])[0]
        _check_order(where, stamps, stamp_s)
        stamps.append(stamp_s)
        images.append(path.parent / words[1])
    if not stamps:
        raise InputError(str(path), "lists no frame", "give a folder with at least one frame")
    lacking = [image for image in images if not image.is_file() or image.stat().st_size == 0]
    if lacking:
        more = f" and {len(lacking) - 1} more" if len(lacking) > 1 else ""
        problem = f"is missing or empty{more}, of {len(images)} listed in {path.name}"
        raise InputError(str(lacking[0]), problem, "copy the folder again, it is cut short")
    return np.array(stamps), images


def _read_truth(path: Path, stamps_s: np.ndarray, tolerance_s: float) -> np.ndarray | None:
    """(N, 4, 4) poses of the frames, NaN where no pose lies within the tolerance; None without the file."""
    if not path.exists():
        return None
    names = ["stamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"]
    rows: list[list[float]] = []
    for where, words in _rows(path, ""):
        if len(words) != len(names):
            problem = f"{len(words)} numbers where {len(names)} belong"
            raise InputError(where, problem, f"write `{' '.join(names)}`; the file may be cut short")
        row = _numbers(where, words, names)
        _check_order(where, [r[0] for r in rows[-1:]], row[0])
        norm = float(np.linalg.norm(row[4:]))
        if not 0.99 < norm < 1.01:
            raise InputError(f"{where}: qx qy qz qw", f"has length {norm:.4g}", "give a unit quaternion")
        rows.append(row)
    if not rows:
        raise InputError(str(path), "holds no pose", "add poses, or delete it to run without ground truth")
    table = np.array(rows)
    after = np.clip(np.searchsorted(table[:, 0], stamps_s), 1, max(1, len(table) - 1))
    pairs = np.stack([after - 1, np.minimum(after, len(table) - 1)])
    distance_s = np.abs(table[pairs, 0] - stamps_s)
    best = pairs[distance_s.argmin(axis=0), np.arange(len(stamps_s))]
    near = distance_s.min(axis=0) <= tolerance_s
    if not near.any():
        problem = f"no stamp lies within {tolerance_s:.4g} s of a frame's"
        raise InputError(str(path), problem, "give both files the same clock, or delete this one")
    T = np.full((len(stamps_s), 4, 4), np.nan)
    T[near] = np.eye(4)
    T[near, :3, :3] = Rotation.from_quat(table[best[near], 4:]).as_matrix()
    T[near, :3, 3] = table[best[near], 1:4]
    return T


def _read_depths(path: Path, camera: Intrinsics, frames: int) -> DepthFolder | None:
    if not path.exists():
        return None
    _, images = _read_list(path)
    if len(images) != frames:
        raise InputError(str(path), f"lists {len(images)} images for {frames} frames", "list one per frame")
    return DepthFolder(images, (camera.height_px, camera.width_px))


def _read_segments(path: Path, frames: int) -> tuple[SegmentTruth, ...]:
    records = _read_json(path, list) or []
    segments = []
    for index, record in enumerate(records):
        where = f"{path}: [{index}]"
        try:
            segment = SegmentTruth(**record)
            inside = -1 <= segment.first_frame <= segment.last_frame < frames
        except TypeError as error:
            raise InputError(where, f"is no segment ({error})", "write the folder again") from None
        if not inside:
            span = f"{segment.first_frame} to {segment.last_frame}"
            raise InputError(where, f"frames {span} are not in the sequence", "write the folder again")
        segments.append(segment)
    return tuple(segments)


def _read_columns(path: Path, frames: int) -> dict[str, np.ndarray]:
    """The columns of frame_truth.csv, (N,) each; empty without the file."""
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
    table = np.array([_numbers(f"{path}:{i + 2}", row, header) for i, row in enumerate(rows)])
    return {name: table[:, column] for column, name in enumerate(header) if name != "frame"}


def _read_json(path: Path, kind: type) -> Any:
    """The content of a JSON file, None without the file."""
    if not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(str(path), f"is no valid JSON ({error})", "correct it or delete it") from None
    if not isinstance(content, kind):
        raise InputError(str(path), f"holds no {kind.__name__}", "correct it or delete it")
    return content


def _rows(path: Path, remedy: str) -> list[tuple[str, list[str]]]:
    """``file:line`` and the words of every line that is neither empty nor a comment."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise InputError(str(path), "no such file", remedy) from None
    except (OSError, UnicodeDecodeError):
        raise InputError(str(path), "is no readable text", "copy the folder again") from None
    numbered = ((f"{path}:{number}", line.split()) for number, line in enumerate(lines, start=1))
    return [(where, words) for where, words in numbered if words and not words[0].startswith("#")]


def _numbers(where: str, words: list[str], names: list[str]) -> list[float]:
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


def _check_order(where: str, earlier: list[float], stamp_s: float) -> None:
    if earlier and stamp_s <= earlier[-1]:
        problem = f"{stamp_s:.6f} does not come after {earlier[-1]:.6f}"
        raise InputError(f"{where}: stamp", problem, "sort the lines by stamp and remove doubles")
