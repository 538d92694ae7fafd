"""The VSLAM-LAB form: reader, whose every fault names file, line, field and remedy, and writer.

    rgb_0/              images of the first camera, gray or colour
    rgb.csv             `ts_rgb_0 (ns),path_rgb_0`: stamp in nanoseconds and image path of each frame;
                        columns of other cameras and of depth, `ts_depth_0 (ns),path_depth_0`, may follow
    calibration.yaml    under `cameras` an entry with `cam_name: rgb_0` and its focal_length, principal_point,
                        image_dimension and fps; distortion_type and distortion_coefficients of a lens with
                        distortion; depth_factor, codes per metre, where there are depth images
    groundtruth.csv     `ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw`: pose of that camera in the world

Earlier folders have stamps in seconds, `ts_rgb0 (s),path_rgb0` and `ts`, settings of ORB-SLAM as their
calibration, and perhaps a ``groundtruth.txt`` of the TUM form. Those with ``rgb.txt`` are ``sim.io.tum``'s.

``groundtruth.csv`` may be absent or hold its header only. ``T_BS``, the place of a camera on its body, is not
used: true poses are the camera's. Source: github.com/VSLAM-LAB/VSLAM-LAB.
"""

import re
from decimal import Decimal
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given
from dslab.scenarios.yaml_file import read_yaml
from dslab.sim.io.camera_file import check_camera, read_camera, whole_size
from dslab.sim.io.clock import choose_origin_ns, to_seconds, written_ns
from dslab.sim.io.folders import Progress, new_directory, write_images
from dslab.sim.io.images import DepthFolder, GrayFolder, image_shape
from dslab.sim.io.layout import CALIBRATION_FILE, DEPTH_PER_M
from dslab.sim.io.sidecars import read_sidecars, write_sidecars
from dslab.sim.io.text import (
    check_frames,
    check_order,
    check_present,
    check_words,
    data_rows,
    number_at,
    numbers_at,
    read_rows,
    stamped_numbers,
    to_decimal,
    to_nanoseconds,
)
from dslab.sim.io.truth import check_pose, half_interval_s, nearest_poses, poses_of
from dslab.sim.io.tum import CodedDepth
from dslab.sim.sensors.camera import DISTORTION_KEYS, Intrinsics
from dslab.sim.sequence import Sequence

IMAGES_DIR, FRAMES_FILE = "rgb_0", "rgb.csv"
_TRUTH_FILE, _EARLIER_TRUTH = "groundtruth.csv", "groundtruth.txt"
_DEPTH_DIR = "depth_0"

_STAMP, _PATH, _DEPTH_PATH = "ts_rgb_0 (ns)", "path_rgb_0", "path_depth_0"
_DEPTH_STAMP = "ts_depth_0 (ns)"
# Names in earlier folders.
_SECONDS = "ts_rgb_0 (s)"
_EARLIER_POSE_COLUMNS = ["ts", "tx", "ty", "tz", "qx", "qy", "qz", "qw"]
_EARLIER = {"ts_rgb0 (s)": _SECONDS, "path_rgb0": _PATH, "path_depth0": _DEPTH_PATH}
_POSE_COLUMNS = ["ts (ns)", "tx (m)", "ty (m)", "tz (m)", "qx", "qy", "qz", "qw"]

# Lens model and number of coefficients of each ``distortion_type``.
_LENSES: dict[str, tuple[Literal["radtan", "equidistant"], int]] = {
    "radtan4": ("radtan", 4),
    "radtan5": ("radtan", 5),
    "equid4": ("equidistant", 4),
}
_EXAMPLE = "the list `cameras` with cam_name, focal_length, principal_point, image_dimension, fps"
# Programs that hold stamps as floating-point numbers write them so.
_AS_FLOAT = re.compile(r"[0-9]{1,19}\.[0-9]*(e\+?[0-9]{1,2})?")
_CSV_REMEDY = f"give the list of frames, with the header `{_STAMP},{_PATH}`"


def load_vslam_lab(folder: Path) -> Sequence:
    """Read the first camera of a folder with ``rgb.csv``, with each frame's nearest true pose.

    Errors as of ``load_sequence``.
    """
    stamps, names, depth_names = _read_frames(folder / FRAMES_FILE)
    origin = choose_origin_ns(stamps)
    stamps_s = to_seconds(stamps, origin)
    camera, depth_per_m = _read_camera(folder / CALIBRATION_FILE, folder / names[0])
    shape = (camera.height_px, camera.width_px)
    frames = GrayFolder([folder / name for name in names], shape, CALIBRATION_FILE)
    sidecars = read_sidecars(folder, len(stamps), origin)
    depths = None
    if depth_per_m is not None and any(depth_names):
        paths = [folder / name if name else None for name in depth_names]
        check_present([path for path in paths if path is not None], FRAMES_FILE)
        depths = DepthFolder(paths, shape, depth_per_m, CALIBRATION_FILE)
    tolerance_s = half_interval_s(stamps_s, camera.fps)
    return Sequence(
        camera=camera,
        stamps_s=stamps_s,
        frames=frames,
        T_world_cam=_read_truth(folder, origin, stamps_s, tolerance_s),
        depths=depths,
        image_names=tuple(names),
        **sidecars,
    )


def _read_frames(path: Path) -> tuple[list[int], list[str], list[str]]:
    """Stamps in nanoseconds, image paths, and paths of depth images, empty where there is none."""
    rows = read_rows(path, _CSV_REMEDY, ",")
    where, header = next(rows, (str(path), []))
    header = [_EARLIER.get(name, name) for name in header]
    stamp_name, to_ns = (_SECONDS, _of_seconds) if _SECONDS in header else (_STAMP, _to_ns)
    for name in (stamp_name, _PATH):
        if header.count(name) != 1:
            found = ",".join(header) or "an empty file"
            raise InputError(f"{where}: {name}", f"is no column of {found}", _CSV_REMEDY)
    stamp_at, path_at = header.index(stamp_name), header.index(_PATH)
    depth_at = header.index(_DEPTH_PATH) if _DEPTH_PATH in header else None
    stamps: list[int] = []
    names: list[str] = []
    depth_names: list[str] = []
    for where, words in rows:
        check_words(where, words, header)
        stamp = to_ns(where, words[stamp_at])
        check_order(where, stamps, stamp)
        if not words[path_at]:
            raise InputError(f"{where}: {_PATH}", "is empty", "name the image of this frame")
        stamps.append(stamp)
        names.append(words[path_at])
        depth_names.append("" if depth_at is None else words[depth_at])
    check_frames(path, stamps)
    check_present([path.parent / name for name in names], path.name)
    return stamps, names, depth_names


def _to_ns(where: str, word: str) -> int:
    """A stamp in whole nanoseconds, also one that is written as a decimal number."""
    return to_nanoseconds(where, str(round(Decimal(word))) if _AS_FLOAT.fullmatch(word) else word)


def _of_seconds(where: str, word: str) -> int:
    """A stamp in seconds, as whole nanoseconds."""
    return round(to_decimal(where, word).scaleb(9))


def _read_camera(path: Path, image: Path) -> tuple[Intrinsics, float | None]:
    """Intrinsics of the first camera, and codes per metre of its depth images; None without them."""
    data = read_yaml(path, "calibration", _EXAMPLE, f"add it with {_EXAMPLE}").data
    if any(str(key).startswith("Camera") for key in data):
        return read_camera(path, image_shape(image)[::-1]), None
    cameras = data.get("cameras")
    entries = [entry for entry in cameras if isinstance(entry, dict)] if isinstance(cameras, list) else []
    named = [entry for entry in entries if entry.get("cam_name") == IMAGES_DIR]
    if len(named) != 1:
        problem = f"has {len(named)} entries with cam_name {IMAGES_DIR} where one belongs"
        raise InputError(f"{path}: cameras", problem, f"add {_EXAMPLE}")
    entry, where = named[0], f"{path}: {IMAGES_DIR}"
    if entry.get("cam_model") != "pinhole":
        problem = f"{entry.get('cam_model')!r} is not supported"
        raise InputError(f"{where}: cam_model", problem, "give a pinhole camera, with distortion if any")
    size = whole_size(where, entry, "image_dimension")
    fx, fy = numbers_at(where, entry, "focal_length", (2,))
    cx, cy = numbers_at(where, entry, "principal_point", (2,))
    model, coefficients = _lens(where, entry)
    fps = number_at(where, entry, "fps")
    camera = Intrinsics(*size, fx, fy, cx, cy, fps, coefficients, model)
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
    if not isinstance(kind, str) or kind not in _LENSES:
        remedy = f"use {', '.join(_LENSES)}, or leave it out"
        raise InputError(f"{where}: distortion_type", f"{kind!r} is no lens model", remedy)
    model, count = _LENSES[kind]
    given = numbers_at(where, entry, "distortion_coefficients", (count,))
    return model, (*given, *[0.0] * (len(DISTORTION_KEYS[model]) - count))


def _read_truth(folder: Path, origin: int, stamps_s: np.ndarray, tolerance_s: float) -> np.ndarray | None:
    """(N, 4, 4) camera to world at the frames; None without the file or without a pose in it."""
    path = folder / _TRUTH_FILE
    if is_given(path):
        rows = read_rows(path, "", ",")
        where, header = next(rows, (str(path), []))
        to_ns = _to_ns if header[:1] == _POSE_COLUMNS[:1] else _of_seconds
        if header not in (_POSE_COLUMNS, _EARLIER_POSE_COLUMNS):
            problem = f"{','.join(header) or 'an empty file'} is not the header of true poses"
            raise InputError(where, problem, f"write {','.join(_POSE_COLUMNS)}, or delete the file")
    elif is_given(folder / _EARLIER_TRUTH):
        path, to_ns = folder / _EARLIER_TRUTH, _of_seconds
        rows = data_rows(path, read_rows(path, ""))
    else:
        return None
    stamps, table = stamped_numbers(rows, _POSE_COLUMNS, to_ns, check_pose)
    if not stamps:
        return None
    known = poses_of(table[:, :3], table[:, 3:])
    return nearest_poses(path, stamps_s, to_seconds(stamps, origin), known, tolerance_s)


def write_vslam_lab(
    sequence: Sequence, directory: Path, depth: bool = False, progress: Progress | None = None
) -> None:
    """Write a sequence as a VSLAM-LAB folder; frames without a true pose have none there.

    Arguments and errors as of ``write_sequence``: the form holds no stamp below 0.
    """
    coded = CodedDepth(sequence) if depth else None
    stamps = written_ns(sequence)
    names = [f"{frame:06d}.png" for frame in range(len(sequence))]
    columns: dict[str, list] = {
        _STAMP: stamps,
        _PATH: [f"{IMAGES_DIR}/{name}" for name in names],
    }
    with new_directory(directory) as folder:
        (folder / IMAGES_DIR).mkdir()
        images = [folder / IMAGES_DIR / name for name in names]
        write_images(sequence.frames, images, "writing", progress)
        if coded:
            (folder / _DEPTH_DIR).mkdir()
            images = [folder / _DEPTH_DIR / name for name in names]
            write_images(coded, images, "writing depth", progress)
            columns |= {_DEPTH_STAMP: stamps}
            columns |= {_DEPTH_PATH: [f"{_DEPTH_DIR}/{name}" for name in names]}
        rows = list(zip(*columns.values(), strict=True))
        (folder / FRAMES_FILE).write_text(_table(list(columns), rows))
        (folder / CALIBRATION_FILE).write_text(_calibration(sequence.camera, depth))
        (folder / _TRUTH_FILE).write_text(_truth(sequence, stamps))
        write_sidecars(sequence, folder)


def _table(header: list[str], rows: list[tuple]) -> str:
    return "".join(",".join(map(str, row)) + "\n" for row in [header, *rows])


def _calibration(camera: Intrinsics, depth: bool) -> str:
    """The text of calibration.yaml; the camera is its own body."""
    fields: dict[str, object] = {
        "cam_name": IMAGES_DIR,
        "cam_type": "rgb+depth" if depth else "gray",
        **({"depth_name": _DEPTH_DIR} if depth else {}),
        "cam_model": "pinhole",
        "focal_length": [camera.fx, camera.fy],
        "principal_point": [camera.cx, camera.cy],
        **({"depth_factor": DEPTH_PER_M} if depth else {}),
    }
    if not camera.is_pinhole:
        fields["distortion_type"] = "radtan5" if camera.model == "radtan" else "equid4"
        fields["distortion_coefficients"] = list(camera.distortion)
    fields["image_dimension"] = [camera.width_px, camera.height_px]
    fields["fps"] = camera.fps
    fields["T_BS"] = np.eye(4).ravel().tolist()
    body = ",\n     ".join(f"{key}: {value}" for key, value in fields.items())
    return f"%YAML 1.2\n---\ncameras:\n  - {{{body}\n    }}\n"


def _truth(sequence: Sequence, stamps: list[int]) -> str:
    """The text of groundtruth.csv, its header only without ground truth."""
    poses = sequence.T_world_cam
    rows: list[tuple] = []
    if poses is not None:
        for frame in np.flatnonzero(np.isfinite(poses).all(axis=(1, 2))).tolist():
            quat_xyzw = Rotation.from_matrix(poses[frame, :3, :3]).as_quat(canonical=True)
            values = [f"{value:.9f}" for value in (*poses[frame, :3, 3], *quat_xyzw)]
            rows.append((stamps[frame], *values))
    return _table(_POSE_COLUMNS, rows)
