"""Reconstructions whose poses count as the truth: nerfstudio's transforms.json and COLMAP's folders.

    transforms.json      intrinsics, and for each image its file and matrix: camera to world, OpenGL's axes (x
                         right, y up, z back)
    sparse/0 or sparse   COLMAP's images and cameras, as text or binary: world to camera, x right, y down, z
                         forward; the images are in images/

Frames come in the order of their names. Images beside those with a pose, named alike, are frames without one.
COLMAP's files are read here, as pycolmap takes a list of images or cameras that is cut short for a whole one,
and none without points.
Source: docs.nerf.studio, data conventions; colmap.github.io/format.html.
"""

import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from dslab.scenarios.errors import InputError, notice
from dslab.scenarios.input_files import (
    TABLE_BYTES,
    file_names,
    is_folder,
    is_given,
    read_bytes,
    read_json,
    read_text,
)
from dslab.sim.io.calibration import Calibration, Fields
from dslab.sim.io.calibration_tables import COLMAP_MODELS, colmap_camera
from dslab.sim.io.calibrations import transforms_camera
from dslab.sim.io.loose_images import kind_of_name, name_order
from dslab.sim.io.posed_images import posed_sequence, rigid
from dslab.sim.io.text import check_words, read_rows, to_numbers
from dslab.sim.io.truth import check_pose, poses_of
from dslab.sim.sequence import Sequence

TRANSFORMS_FILE = "transforms.json"
_OPENGL = np.diag([1.0, -1, -1, 1])
_Posed = tuple[str, list[float], str, str]
_POSE_NAMES = ["qw", "qx", "qy", "qz", "tx", "ty", "tz"]


def load_transforms(folder: Path, camera_file: Path | None = None) -> Sequence:
    """Read the images of a transforms.json. Errors as of ``load_sequence``."""
    path = folder / TRANSFORMS_FILE
    data = read_json(path, dict)
    listed = data.get("frames")
    poses: dict[Path, np.ndarray] = {}
    for index, frame in enumerate(listed if isinstance(listed, list) else []):
        fields = Fields(f"{path}: frames[{index}]", frame if isinstance(frame, Mapping) else {})
        name = fields.word("file_path")
        image = folder / (name if Path(name).suffix else f"{name}.png")
        if image in poses:
            raise InputError(f"{fields.where}: file_path", f"{name} is listed twice", "keep one of its poses")
        rows = np.reshape(fields.numbers("transform_matrix", lengths=(12, 16)), (-1, 4))
        poses[image] = rigid(f"{fields.where}: transform_matrix", rows) @ _OPENGL

    def calibration(shape: tuple[int, int]) -> tuple[Path, Calibration]:
        size = {} if "w" in data else {"w": shape[1], "h": shape[0]}
        return path, transforms_camera(Fields(str(path), {**data, **size}))

    return _sequence(folder, path, poses, calibration, camera_file)


def model_folder(folder: Path) -> Path | None:
    """The folder of COLMAP's model below a folder; None without one."""
    places = (folder / "sparse" / "0", folder / "sparse")
    return next((p for p in places for end in ("bin", "txt") if is_given(p / f"images.{end}")), None)


def load_colmap(folder: Path, camera_file: Path | None = None) -> Sequence:
    """Read the images of a COLMAP reconstruction. Errors as of ``load_sequence``."""
    home = model_folder(folder) or folder
    binary = is_given(home / "images.bin")
    path = home / ("images.bin" if binary else "images.txt")
    poses: dict[Path, np.ndarray] = {}
    cameras = set()
    for where, numbers, camera, name in _binary_images(path) if binary else _text_images(path):
        pose = [*numbers[4:], *numbers[1:4], numbers[0]]
        check_pose(where, pose)
        T_cam_world = poses_of(np.array([pose[:3]]), np.array([pose[3:]]))[0]
        poses[folder / "images" / name] = np.linalg.inv(T_cam_world)
        cameras.add(camera)

    def calibration(shape: tuple[int, int]) -> tuple[Path, Calibration]:
        file = home / ("cameras.bin" if binary else "cameras.txt")
        known = _binary_cameras(file) if binary else _text_cameras(file)
        found = {camera: known.get(camera) for camera in cameras}
        if len(set(map(repr, found.values()))) > 1:
            remedy = "reconstruct with one camera (--ImageReader.single_camera 1), or add --camera FILE"
            raise InputError(str(file), "images have cameras of their own", remedy)
        first = next(iter(found.values()))
        if first is None:
            raise InputError(str(file), "lacks the camera of the images", "copy the folder again")
        return file, colmap_camera(str(file), *first)

    notice(str(path), "true poses are in this reconstruction's unit of length, perhaps not in metres")
    return _sequence(folder, path, poses, calibration, camera_file)


def _sequence(
    folder: Path,
    path: Path,
    poses: Mapping[Path, np.ndarray],
    calibration: Callable[[tuple[int, int]], tuple[Path, Calibration]],
    camera_file: Path | None,
) -> Sequence:
    if not poses:
        raise InputError(str(path), "lists no image with a pose", "copy the folder again")
    homes = sorted({image.parent for image in poses})
    if len(homes) > 1:
        listed = ", ".join(home.name for home in homes[:3])
        raise InputError(str(path), f"lists images of several folders ({listed})", "give one camera's alone")
    kinds = {kind_of_name(image.name) for image in poses}
    beside = file_names(homes[0]) if is_folder(homes[0]) else []
    images = {homes[0] / name for name in beside if kind_of_name(name) in kinds} | set(poses)
    ordered = sorted(images, key=lambda image: name_order(image.name))
    T = np.array([poses.get(image, np.full((4, 4), np.nan)) for image in ordered])
    return posed_sequence(folder, ordered, np.arange(len(ordered)), calibration, camera_file, T)


def _text_images(path: Path) -> Iterator[_Posed]:
    """Place, quaternion wxyz and translation, camera and name; the line after each has points."""
    lines = enumerate(read_text(path, TABLE_BYTES).splitlines(), start=1)
    rows = [(n, line) for n, line in lines if not line.lstrip().startswith("#")]
    for number, line in rows[::2]:
        words = line.split(maxsplit=9)
        if not words:
            break
        where = f"{path}:{number}"
        check_words(where, words, ["id", *_POSE_NAMES, "camera", "name"])
        yield where, to_numbers(where, words[1:8], _POSE_NAMES), words[8], words[9].strip()


def _text_cameras(path: Path) -> dict[str, tuple[str, list[str]]]:
    """Model and numbers of the cameras."""
    return {words[0]: (words[1], words[2:]) for _, words in read_rows(path, "") if len(words) > 4}


def _binary_images(path: Path) -> Iterator[_Posed]:
    """As ``_text_images``."""
    data, at = read_bytes(path, TABLE_BYTES), 8
    try:
        for index in range(struct.unpack_from("<Q", data)[0]):
            *numbers, camera = struct.unpack_from("<7dI", data, at + 4)
            end = data.index(b"\0", at + 64)
            where = f"{path}: image {index}"
            pose = to_numbers(where, list(map(repr, numbers)), _POSE_NAMES)
            yield where, pose, str(camera), data[at + 64 : end].decode()
            at = end + 9 + 24 * struct.unpack_from("<Q", data, end + 1)[0]
            if at > len(data):
                raise ValueError
    except (struct.error, ValueError):
        raise InputError(str(path), "is cut short or no list of images", "copy the folder again") from None


def _binary_cameras(path: Path) -> dict[str, tuple[str, list[str]]]:
    """As ``_text_cameras``."""
    data, at = read_bytes(path, TABLE_BYTES), 8
    cameras = {}
    models = list(COLMAP_MODELS.items())
    try:
        for _ in range(struct.unpack_from("<Q", data)[0]):
            camera, model, *size = struct.unpack_from("<IiQQ", data, at)
            if not 0 <= model < len(models):
                problem = f"its model, number {model}, is not supported"
                raise InputError(f"{path}: camera {camera}", problem, f"use {', '.join(COLMAP_MODELS)}")
            name, keys = models[model]
            numbers = struct.unpack_from(f"<{len(keys.split())}d", data, at + 24)
            cameras[str(camera)] = name, [*map(str, size), *map(repr, numbers)]
            at += 24 + 8 * len(numbers)
    except struct.error:
        raise InputError(str(path), "is cut short or no list of cameras", "copy the folder again") from None
    return cameras
