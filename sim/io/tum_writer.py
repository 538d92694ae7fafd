"""Writes a sequence as a TUM-form folder, wholly or not at all."""

import csv
import json
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from scenarios.errors import InputError
from sim.camera import Intrinsics
from sim.io import layout
from sim.sequence import FrameSource, Sequence

_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def claim_output_dir(directory: Path) -> None:
    """See that a folder can be made there, before the work that is to go into it.

    Raises:
        InputError: it is a file or a folder that is not empty, or the place cannot be written.
    """
    if directory.exists() and not directory.is_dir():
        raise InputError(str(directory), "is a file", "give the path of a new or empty folder")
    if directory.is_dir() and any(directory.iterdir()):
        raise InputError(str(directory), "the folder is not empty", "give another one or empty it")
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=directory.parent):
            pass
        if directory.is_dir():
            with tempfile.TemporaryFile(dir=directory):
                pass
    except OSError as error:
        raise _unwritable(directory, error) from error


def write_tum(
    sequence: Sequence,
    directory: Path,
    depth: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> None:
    """Write a sequence as a TUM-form folder; see ``sim.io.layout``.

    Args:
        sequence: what to write.
        directory: new or empty folder.
        depth: write depth images too; the sequence must have them.
        progress: called with step, frames done and frames in all.

    Raises:
        InputError: the folder is not empty or cannot be written, the disk is full; nothing is left behind.
    """
    if depth and sequence.depths is None:
        raise InputError(sequence.name, "has no depth images", "render it with depth")
    directory = directory.resolve()
    claim_output_dir(directory)
    progress = progress or (lambda step, done, total: None)
    with _whole_or_nothing(directory) as folder:
        _write_tables(sequence, folder)
        _write_images(sequence, folder, "rgb", layout.FRAMES_FILE, sequence.frames, progress)
        if depth and sequence.depths is not None:
            coded = _CodedDepth(sequence.depths)
            _write_images(sequence, folder, "depth", layout.DEPTH_FILE, coded, progress)


class _CodedDepth:
    """Depth as 16-bit images; what does not fit is unknown."""

    def __init__(self, depths: FrameSource) -> None:
        self._depths = depths

    def __len__(self) -> int:
        return len(self._depths)

    def __getitem__(self, index: int) -> np.ndarray:
        code = np.rint(self._depths[index] * layout.DEPTH_PER_M)
        return np.where(code <= 65535, code, 0).astype(np.uint16)


@contextmanager
def _whole_or_nothing(directory: Path) -> Iterator[Path]:
    """A folder beside the wanted one that takes its name when the block ends, and vanishes if it raises."""
    # Made by mkdir and not as a temporary folder, which nobody else could read.
    unfinished = directory.parent / f".{directory.name}.unfinished-{os.getpid()}-{secrets.token_hex(4)}"
    try:
        unfinished.mkdir()
    except OSError as error:
        raise _unwritable(directory, error) from error
    try:
        yield unfinished
        if directory.is_dir():
            directory.rmdir()
        os.replace(unfinished, directory)
    except OSError as error:
        raise _unwritable(directory, error) from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _write_tables(sequence: Sequence, folder: Path) -> None:
    camera = yaml.safe_dump(_camera_record(sequence.camera), sort_keys=False)
    (folder / layout.CAMERA_FILE).write_text(camera)
    if sequence.T_world_cam is not None:
        text = _trajectory_text(sequence.stamps_s, sequence.T_world_cam)
        (folder / layout.TRUTH_FILE).write_text(text)
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


def _write_images(
    sequence: Sequence,
    folder: Path,
    name: str,
    list_file: str,
    images: FrameSource,
    progress: Callable[[str, int, int], None],
) -> None:
    (folder / name).mkdir()
    lines = ["# stamp_s filename"]
    for frame, stamp_s in enumerate(sequence.stamps_s):
        path = f"{name}/{frame:06d}.png"
        encoded, data = cv2.imencode(".png", images[frame], _FAST_PNG)
        if not encoded:
            raise OSError(f"frame {frame} cannot be encoded")
        (folder / path).write_bytes(data.tobytes())
        lines.append(f"{stamp_s:.9f} {path}")
        progress(f"writing {name}", frame + 1, len(sequence))
    (folder / list_file).write_text("\n".join(lines) + "\n")


def _camera_record(camera: Intrinsics) -> dict[str, float]:
    record = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
    record |= {"width": camera.width_px, "height": camera.height_px, "fps": camera.fps}
    return record | dict(zip(layout.DISTORTION_KEYS, camera.distortion, strict=True))


def _trajectory_text(stamps_s: np.ndarray, T_world_cam: np.ndarray) -> str:
    """Poses in TUM's order; frames without a pose are left out."""
    known = np.isfinite(T_world_cam).all(axis=(1, 2))
    quat_xyzw = Rotation.from_matrix(T_world_cam[known, :3, :3]).as_quat(canonical=True)
    rows = np.column_stack([stamps_s[known], T_world_cam[known, :3, 3], quat_xyzw])
    lines = ["# stamp_s tx ty tz qx qy qz qw, camera (x right, y down, z forward) to world, metres"]
    lines += [" ".join(f"{value:.9f}" for value in row) for row in rows]
    return "\n".join(lines) + "\n"


def _unwritable(directory: Path, error: OSError) -> InputError:
    problem = f"cannot be written ({error.strerror or error})"
    return InputError(str(directory), problem, "free space or give another folder")
