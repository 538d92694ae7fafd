"""Reader of the EuRoC (ASL) form; every fault names file, line, field and remedy.

Layout: ``sim.io.euroc_layout``.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given
from dslab.scenarios.yaml_file import read_yaml
from dslab.sim.io import euroc_layout as layout
from dslab.sim.io.camera_file import check_camera
from dslab.sim.io.images import GrayFolder
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
from dslab.sim.io.truth import (
    check_position,
    check_quaternion,
    half_interval_s,
    is_rotation,
    nearest_poses,
    poses_of,
)
from dslab.sim.sensors.camera import DISTORTION_KEYS, Intrinsics
from dslab.sim.sensors.imu import ImuModel, ImuReadings
from dslab.sim.sequence import Sequence

_SENSOR_KEYS = "T_BS, rate_hz, resolution, intrinsics, distortion_model, distortion_coefficients"


def load_euroc(folder: Path) -> Sequence:
    """Read the left camera of an EuRoC folder, with each frame's nearest true pose.

    Args:
        folder: the folder that holds ``mav0``.

    Raises:
        InputError: a file is missing, empty, cut short, malformed or absurd. Reading a frame raises it too,
            if the image is unreadable or of another size.
    """
    camera, T_body_cam = _read_camera(folder / layout.CAMERA_DIR / layout.SENSOR_FILE)
    stamps, images = _read_frames(folder / layout.CAMERA_DIR / layout.TABLE_FILE)
    origin = layout.choose_origin_ns(stamps)
    stamps_s = layout.to_seconds(stamps, origin)
    frames = GrayFolder(images, (camera.height_px, camera.width_px), layout.SENSOR_FILE)
    frames[0]  # a wrong size shows in the first image already
    sidecars = read_sidecars(folder, len(stamps))
    if origin:
        sidecars["meta"] = {**sidecars["meta"], layout.ORIGIN_KEY: origin}
    tolerance_s = half_interval_s(stamps_s, camera.fps)
    truth = folder / layout.TRUTH_DIR / layout.TABLE_FILE
    T_world_body = _read_truth(truth, origin, stamps_s, tolerance_s)
    return Sequence(
        camera=camera,
        stamps_s=stamps_s,
        frames=frames,
        T_world_cam=None if T_world_body is None else T_world_body @ T_body_cam,
        depths=None,
        **sidecars,
    )


def load_euroc_imu(folder: Path) -> ImuReadings | None:
    """Read the inertial readings of an EuRoC folder; None without them.

    Stamps are on the clock of ``load_euroc``.

    Raises:
        InputError: a file is missing, malformed or absurd.
    """
    table = folder / layout.IMU_DIR / layout.TABLE_FILE
    if not is_given(table):
        return None
    frame_stamps, _ = _read_frames(folder / layout.CAMERA_DIR / layout.TABLE_FILE)
    _, T_body_cam = _read_camera(folder / layout.CAMERA_DIR / layout.SENSOR_FILE)
    path = folder / layout.IMU_DIR / layout.SENSOR_FILE
    sensor = _sensor(path, "T_BS, rate_hz and the noise densities")
    T_body_imu = _matrix(path, sensor)
    keys = ["gyroscope_noise_density", "gyroscope_random_walk"]
    keys += ["accelerometer_noise_density", "accelerometer_random_walk"]
    values = [number_at(path, sensor, key) for key in ["rate_hz", *keys]]
    try:
        model = ImuModel(*values, T_cam_imu=np.linalg.inv(T_body_cam) @ T_body_imu)
    except InputError as error:
        raise InputError(f"{path}: {error.where}", error.problem, error.remedy) from None
    stamps: list[int] = []
    rows: list[list[float]] = []
    for where, words in read_rows(table, "", ","):
        check_words(where, words, layout.IMU_COLUMNS)
        stamp = to_nanoseconds(where, words[0])
        check_order(where, stamps, stamp)
        stamps.append(stamp)
        rows.append(to_numbers(where, words[1:], layout.IMU_COLUMNS[1:]))
    if not rows:
        raise InputError(str(table), "holds no reading", "add readings, or delete the folder imu0")
    readings = np.array(rows)
    stamps_s = layout.to_seconds(stamps, layout.choose_origin_ns(frame_stamps))
    return ImuReadings(model, stamps_s, readings[:, :3], readings[:, 3:])


def _read_frames(path: Path) -> tuple[list[int], list[Path]]:
    """Read the stamps, in nanoseconds, and the image paths."""
    stamps: list[int] = []
    images: list[Path] = []
    for where, words in read_rows(path, "give the list of frames, `stamp,filename` per line", ","):
        if len(words) != 2:
            problem = f"{len(words)} words where stamp and filename belong"
            raise InputError(where, problem, "write `stamp,filename`; the file may be cut short")
        stamp = to_nanoseconds(where, words[0])
        check_order(where, stamps, stamp)
        stamps.append(stamp)
        images.append(path.parent / "data" / words[1])
    if not stamps:
        raise InputError(str(path), "lists no frame", "give a folder with at least one frame")
    check_present(images, path.name)
    return stamps, images


def _read_camera(path: Path) -> tuple[Intrinsics, np.ndarray]:
    """Intrinsics, and (4, 4) camera to body."""
    sensor = _sensor(path, _SENSOR_KEYS)
    if sensor.get("camera_model", "pinhole") != "pinhole":
        given = sensor["camera_model"]
        raise InputError(f"{path}: camera_model", f"{given!r} is not supported", "give a pinhole camera")
    models = {name: model for model, name in layout.LENS_NAMES.items()}
    name = sensor.get("distortion_model")
    if not isinstance(name, str) or name not in models:
        known = " or ".join(models)
        raise InputError(f"{path}: distortion_model", f"{name!r} is no lens model", f"use {known}")
    model = models[name]
    width, height = numbers_at(path, sensor, "resolution", (2,))
    if any(size != int(size) for size in (width, height)):
        problem = f"{width:g}x{height:g} is no image size"
        raise InputError(f"{path}: resolution", problem, "give whole pixels")
    full = len(DISTORTION_KEYS[model])
    coefficients = numbers_at(path, sensor, "distortion_coefficients", (4, full))
    coefficients += [0.0] * (full - len(coefficients))
    fx, fy, cx, cy = numbers_at(path, sensor, "intrinsics", (4,))
    fps = number_at(path, sensor, "rate_hz")
    camera = Intrinsics(int(width), int(height), fx, fy, cx, cy, fps, tuple(coefficients), model)
    check_camera(path, camera)
    return camera, _matrix(path, sensor)


def _read_truth(path: Path, origin: int, stamps_s: np.ndarray, tolerance_s: float) -> np.ndarray | None:
    """(N, 4, 4) body to world at the frames; None without the file."""
    if not is_given(path):
        return None
    stamps: list[int] = []
    rows: list[list[float]] = []
    for where, words in read_rows(path, "", ","):
        # Velocity and biases may follow the pose.
        if len(words) != 17:
            check_words(where, words, layout.POSE_COLUMNS)
        stamp = to_nanoseconds(where, words[0])
        check_order(where, stamps, stamp)
        row = to_numbers(where, words[1:8], layout.POSE_COLUMNS[1:])
        check_position(where, row[:3])
        check_quaternion(f"{where}: q_w q_x q_y q_z", row[3:])
        stamps.append(stamp)
        rows.append(row)
    if not rows:
        raise InputError(str(path), "holds no pose", "add poses, or delete it to run without ground truth")
    table = np.array(rows)
    poses = poses_of(table[:, :3], np.roll(table[:, 3:], -1, axis=1))
    return nearest_poses(path, stamps_s, layout.to_seconds(stamps, origin), poses, tolerance_s)


def _sensor(path: Path, keys: str) -> dict[Any, Any]:
    """The content of a sensor.yaml that should hold some keys."""
    example = f"the keys {keys}"
    return read_yaml(path, "sensor", example, f"add it with {example}").data


def _matrix(path: Path, sensor: dict[Any, Any]) -> np.ndarray:
    """(4, 4) T_BS: sensor to body."""
    mounting = sensor.get("T_BS")
    if not isinstance(mounting, dict):
        raise InputError(f"{path}: T_BS", "is missing", "add it with rows, cols and data")
    T = np.reshape(numbers_at(path, mounting, "data", (16,)), (4, 4))
    R = T[:3, :3]
    if list(T[3]) != [0, 0, 0, 1] or not is_rotation(R):
        raise InputError(f"{path}: T_BS", "is no rigid transform", "give a rotation and a translation")
    check_position(f"{path}: T_BS", T[:3, 3])
    # Printed digits give a rotation only to some places.
    T[:3, :3] = Rotation.from_matrix(R).as_matrix()
    return T
