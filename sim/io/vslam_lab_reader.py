"""Reader of VSLAM-LAB folders; every fault names file, line, field and remedy.

Layout: ``sim.io.vslam_lab_layout``.
"""

import re
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given
from dslab.scenarios.yaml_file import read_yaml
from dslab.sim.io import euroc_layout
from dslab.sim.io import vslam_lab_layout as layout
from dslab.sim.io.camera_file import check_camera
from dslab.sim.io.images import DepthFolder, GrayFolder
from dslab.sim.io.sidecars import read_sidecars
from dslab.sim.io.text import (
    check_order,
    check_present,
    check_words,
    number_at,
    numbers_at,
    read_rows,
    to_nanoseconds,
    to_numbers,
)
from dslab.sim.io.truth import check_position, check_quaternion, half_interval_s, nearest_poses, poses_of
from dslab.sim.sensors.camera import DISTORTION_KEYS, Intrinsics
from dslab.sim.sequence import Sequence

_EXAMPLE = "the list `cameras` with cam_name, focal_length, principal_point, image_dimension, fps"
# Programs that hold stamps as floating-point numbers write them so.
_AS_FLOAT = re.compile(r"[0-9]{1,19}\.[0-9]*(e\+?[0-9]{1,2})?")
_CSV_REMEDY = f"give the list of frames, with the header `{layout.STAMP},{layout.PATH}`"


def load_vslam_lab(folder: Path) -> Sequence:
    """Read the first camera of a VSLAM-LAB folder, with each frame's nearest true pose.

    Args:
        folder: the folder of a sequence, with ``rgb.csv``.

    Raises:
        InputError: a file is missing, empty, cut short, malformed or absurd. Reading a frame raises it too,
            if the image is unreadable or of another size.
    """
    camera, depth_per_m = _read_camera(folder / layout.CALIBRATION_FILE)
    stamps, names, depth_names = _read_frames(folder / layout.FRAMES_FILE)
    origin = euroc_layout.choose_origin_ns(stamps)
    stamps_s = euroc_layout.to_seconds(stamps, origin)
    shape = (camera.height_px, camera.width_px)
    frames = GrayFolder([folder / name for name in names], shape, layout.CALIBRATION_FILE)
    frames[0]  # a wrong size shows in the first image already
    sidecars = read_sidecars(folder, len(stamps))
    if origin:
        sidecars["meta"] = {**sidecars["meta"], euroc_layout.ORIGIN_KEY: origin}
    depths = None
    if depth_per_m is not None and any(depth_names):
        paths = [folder / name if name else None for name in depth_names]
        check_present([path for path in paths if path is not None], layout.FRAMES_FILE)
        depths = DepthFolder(paths, shape, depth_per_m, layout.CALIBRATION_FILE)
    tolerance_s = half_interval_s(stamps_s, camera.fps)
    return Sequence(
        camera=camera,
        stamps_s=stamps_s,
        frames=frames,
        T_world_cam=_read_truth(folder / layout.TRUTH_FILE, origin, stamps_s, tolerance_s),
        depths=depths,
        image_names=tuple(names),
        **sidecars,
    )


def _read_frames(path: Path) -> tuple[list[int], list[str], list[str]]:
    """Stamps in nanoseconds, image paths, and paths of depth images, empty where there is none."""
    rows = read_rows(path, _CSV_REMEDY, ",")
    where, header = next(rows, (str(path), []))
    for name in (layout.STAMP, layout.PATH):
        if header.count(name) != 1:
            found = ",".join(header) or "an empty file"
            raise InputError(f"{where}: {name}", f"is no column of {found}", _CSV_REMEDY)
    stamp_at, path_at = header.index(layout.STAMP), header.index(layout.PATH)
    depth_at = header.index(layout.DEPTH_PATH) if layout.DEPTH_PATH in header else None
    stamps: list[int] = []
    names: list[str] = []
    depth_names: list[str] = []
    for where, words in rows:
        check_words(where, words, header)
        stamp = _to_ns(where, words[stamp_at])
        check_order(where, stamps, stamp)
        if not words[path_at]:
            raise InputError(f"{where}: {layout.PATH}", "is empty", "name the image of this frame")
        stamps.append(stamp)
        names.append(words[path_at])
        depth_names.append("" if depth_at is None else words[depth_at])
    if not stamps:
        raise InputError(str(path), "lists no frame", "give a folder with at least one frame")
    check_present([path.parent / name for name in names], path.name)
    return stamps, names, depth_names


def _to_ns(where: str, word: str) -> int:
    """A stamp in whole nanoseconds, also one that is written as a decimal number."""
    return round(Decimal(word)) if _AS_FLOAT.fullmatch(word) else to_nanoseconds(where, word)


def _read_camera(path: Path) -> tuple[Intrinsics, float | None]:
    """Intrinsics of the first camera, and codes per metre of its depth images; None without them."""
    data = read_yaml(path, "calibration", _EXAMPLE, f"add it with {_EXAMPLE}").data
    cameras = data.get("cameras")
    entries = [entry for entry in cameras if isinstance(entry, dict)] if isinstance(cameras, list) else []
    named = [entry for entry in entries if entry.get("cam_name") == layout.IMAGES_DIR]
    if len(named) != 1:
        problem = f"has {len(named)} entries with cam_name {layout.IMAGES_DIR} where one belongs"
        raise InputError(f"{path}: cameras", problem, f"add {_EXAMPLE}")
    entry, where = named[0], f"{path}: {layout.IMAGES_DIR}"
    if entry.get("cam_model") != "pinhole":
        problem = f"{entry.get('cam_model')!r} is not supported"
        raise InputError(f"{where}: cam_model", problem, "give a pinhole camera, with distortion if any")
    width, height = numbers_at(where, entry, "image_dimension", (2,))
    if any(size != int(size) for size in (width, height)):
        problem = f"{width:g}x{height:g} is no image size"
        raise InputError(f"{where}: image_dimension", problem, "give whole pixels")
    fx, fy = numbers_at(where, entry, "focal_length", (2,))
    cx, cy = numbers_at(where, entry, "principal_point", (2,))
    model, coefficients = _lens(where, entry)
    fps = number_at(where, entry, "fps")
    camera = Intrinsics(int(width), int(height), fx, fy, cx, cy, fps, coefficients, model)
    check_camera(path, camera)
    if "depth_factor" not in entry:
        return camera, None
    depth_per_m = number_at(where, entry, "depth_factor")
    if not depth_per_m > 0:
        problem = f"{depth_per_m:g} is no number of codes per metre"
        raise InputError(f"{where}: depth_factor", problem, "give a number above 0")
    return camera, depth_per_m


def _lens(where: str, entry: dict[Any, Any]) -> tuple[Any, tuple[float, ...]]:
    """Lens model and all of its coefficients."""
    kind = entry.get("distortion_type")
    if kind is None:
        return "radtan", (0.0,) * len(DISTORTION_KEYS["radtan"])
    if not isinstance(kind, str) or kind not in layout.LENSES:
        remedy = f"use {', '.join(layout.LENSES)}, or leave it out"
        raise InputError(f"{where}: distortion_type", f"{kind!r} is no lens model", remedy)
    model, count = layout.LENSES[kind]
    given = numbers_at(where, entry, "distortion_coefficients", (count,))
    return model, (*given, *[0.0] * (len(DISTORTION_KEYS[model]) - count))


def _read_truth(path: Path, origin: int, stamps_s: np.ndarray, tolerance_s: float) -> np.ndarray | None:
    """(N, 4, 4) camera to world at the frames; None without the file or without a pose in it."""
    if not is_given(path):
        return None
    rows = read_rows(path, "", ",")
    where, header = next(rows, (str(path), []))
    if header != layout.POSE_COLUMNS:
        problem = f"{','.join(header) or 'an empty file'} is not the header of true poses"
        raise InputError(where, problem, f"write {','.join(layout.POSE_COLUMNS)}, or delete the file")
    stamps: list[int] = []
    poses: list[list[float]] = []
    for where, words in rows:
        check_words(where, words, layout.POSE_COLUMNS)
        stamp = _to_ns(where, words[0])
        check_order(where, stamps, stamp)
        pose = to_numbers(where, words[1:], layout.POSE_COLUMNS[1:])
        check_position(where, pose[:3])
        check_quaternion(f"{where}: qx qy qz qw", pose[3:])
        stamps.append(stamp)
        poses.append(pose)
    if not poses:
        return None
    table = np.array(poses)
    known = poses_of(table[:, :3], table[:, 3:])
    return nearest_poses(path, stamps_s, euroc_layout.to_seconds(stamps, origin), known, tolerance_s)
