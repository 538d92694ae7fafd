"""The EuRoC (ASL) form: reader, whose every fault names file, line, field and remedy, and writer.

    mav0/cam0/data.csv          stamp in nanoseconds and file name of each frame
    mav0/cam0/data/*.png        the images
    mav0/cam0/sensor.yaml       intrinsics, distortion, rate, mounting T_BS: camera to body
    mav0/imu0/data.csv          stamp, angular rate, specific force, body frame
    mav0/imu0/sensor.yaml       rate, noise densities
    mav0/state_groundtruth_estimate0/data.csv   stamp, position, quaternion wxyz of the body in the world,
                                and, where known, velocity and the biases of gyro and accelerometer

The body is the inertial sensor; without one it is the camera. Stamps: ``sim.io.clock``. ``mav0`` may lack or
``cam0`` be given alone. Truth may be of motion capture, ``mocap0`` or ``vicon0``, whose sensor.yaml says how
its markers are mounted. TUM-VI's calibration, ``dso/camchain.yaml``, stands for a missing sensor.yaml.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError, notice
from dslab.scenarios.input_files import is_given
from dslab.scenarios.yaml_file import read_yaml
from dslab.sim.io.calibration import Fields
from dslab.sim.io.calibrations import euroc_sensor
from dslab.sim.io.camera_file import intrinsics_of, read_camera
from dslab.sim.io.clock import choose_origin_ns, origin_ns, to_ns, to_seconds, written_ns
from dslab.sim.io.folders import Progress, new_directory, write_images
from dslab.sim.io.images import GrayFolder, names_in
from dslab.sim.io.orbslam3 import TIMES_FILE
from dslab.sim.io.sidecars import read_sidecars, write_sidecars
from dslab.sim.io.text import (
    check_present,
    data_rows,
    number_at,
    numbers_at,
    read_list,
    read_rows,
    stamped_numbers,
    to_nanoseconds,
)
from dslab.sim.io.truth import (
    check_pose,
    check_position,
    half_interval_s,
    is_rotation,
    nearest_poses,
    poses_of,
)
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.imu import ImuModel, ImuReadings, ImuTruth
from dslab.sim.sequence import Sequence

CAMERA_DIR, IMU_DIR, TRUTH_DIR = "mav0/cam0", "mav0/imu0", "mav0/state_groundtruth_estimate0"
_TRUTH_DIRS = ("state_groundtruth_estimate0", "mocap0", "vicon0")
_CAMCHAIN = "dso/camchain.yaml"
TABLE_FILE, SENSOR_FILE = "data.csv", "sensor.yaml"

_IMU_COLUMNS = ["timestamp"] + [f"{name}_RS_S_{axis}" for name in "wa" for axis in "xyz"]
_POSE_COLUMNS = ["timestamp", "p_x", "p_y", "p_z", "q_w", "q_x", "q_y", "q_z"]
_LENS_NAMES = {"radtan": "radial-tangential", "equidistant": "equidistant"}
_SENSOR_KEYS = "T_BS, rate_hz, resolution, intrinsics, distortion_model, distortion_coefficients"
# Fields of the model, by their keys in the file.
_IMU_KEYS = {
    "rate_hz": "rate_hz",
    "gyroscope_noise_density": "gyro_noise",
    "gyroscope_random_walk": "gyro_walk",
    "accelerometer_noise_density": "accel_noise",
    "accelerometer_random_walk": "accel_walk",
}


def load_euroc(folder: Path) -> Sequence:
    """Read the left camera of a folder that holds ``mav0``, with each frame's nearest true pose.

    Errors as of ``load_sequence``.
    """
    directory = camera_dir(folder)
    camera, T_body_cam = _read_camera(directory)
    stamps, images = _read_frames(directory / TABLE_FILE)
    origin = choose_origin_ns(stamps)
    stamps_s = to_seconds(stamps, origin)
    frames = GrayFolder(images, (camera.height_px, camera.width_px), SENSOR_FILE)
    sidecars = read_sidecars(folder, len(stamps), origin)
    tolerance_s = half_interval_s(stamps_s, camera.fps)
    T_world_body = _read_truth(directory.parent, origin, stamps_s, tolerance_s)
    return Sequence(
        camera=camera,
        stamps_s=stamps_s,
        frames=frames,
        T_world_cam=None if T_world_body is None else T_world_body @ T_body_cam,
        depths=None,
        image_names=names_in(folder, images),
        **sidecars,
    )


def load_euroc_imu(folder: Path) -> ImuReadings | None:
    """Read the inertial readings of an EuRoC folder; None without them.

    Stamps are on the clock of ``load_euroc``.

    Raises:
        InputError: a file is missing, malformed or absurd.
    """
    directory = camera_dir(folder)
    table = directory.parent / "imu0" / TABLE_FILE
    if not is_given(table):
        return None
    frame_stamps, _ = _read_frames(directory / TABLE_FILE)
    _, T_body_cam = _read_camera(directory)
    path = table.parent / SENSOR_FILE
    sensor = _sensor(path, "T_BS, rate_hz and the noise densities")
    T_body_imu = _matrix(path, sensor)
    values = {field: number_at(path, sensor, key) for key, field in _IMU_KEYS.items()}
    try:
        model = ImuModel(**values, T_cam_imu=np.linalg.inv(T_body_cam) @ T_body_imu)
    except InputError as error:
        raise InputError(f"{path}: {error.where}", error.problem, error.remedy) from None
    stamps, readings = stamped_numbers(read_rows(table, "", ","), _IMU_COLUMNS, to_nanoseconds)
    if not stamps:
        raise InputError(str(table), "holds no reading", "add readings, or delete the folder imu0")
    stamps_s = to_seconds(stamps, choose_origin_ns(frame_stamps))
    return ImuReadings(model, stamps_s, readings[:, :3], readings[:, 3:])


def camera_dir(folder: Path) -> Path:
    """The folder of the camera below, or at, a folder of the form."""
    places = (folder / CAMERA_DIR, folder / "cam0", folder)
    return next((place for place in places if is_given(place / TABLE_FILE)), places[0])


def _read_frames(path: Path) -> tuple[list[int], list[Path]]:
    """Stamps, in nanoseconds, and image paths."""
    stamps, names = read_list(path, ",", to_nanoseconds)
    images = [path.parent / "data" / name for name in names]
    check_present(images, path.name)
    return stamps, images


def _read_camera(directory: Path) -> tuple[Intrinsics, np.ndarray]:
    """Intrinsics, and (4, 4) camera to body."""
    path, camchain = directory / SENSOR_FILE, directory.parent.parent / _CAMCHAIN
    stamps, _ = _read_frames(directory / TABLE_FILE)
    steps_ns = np.diff(np.array(stamps))
    fps = round(1e9 / float(np.median(steps_ns)), 4) if len(steps_ns) else None
    if not is_given(path) and is_given(camchain):
        mounting = Fields(str(camchain), read_yaml(camchain, "calibration").data).part("cam0")
        T = (
            mounting.numbers("T_cam_imu", lengths=(16,))
            if "T_cam_imu" in mounting.data
            else np.eye(4).ravel()
        )
        T_cam_body = _matrix(camchain, {"T_BS": {"data": [float(value) for value in T]}})
        return read_camera(camchain, fps=fps), np.linalg.inv(T_cam_body)
    sensor = _sensor(path, _SENSOR_KEYS)
    found = euroc_sensor(Fields(str(path), sensor))
    return intrinsics_of(found, path, fps=fps), _matrix(path, sensor)


def _read_truth(home: Path, origin: int, stamps_s: np.ndarray, tolerance_s: float) -> np.ndarray | None:
    """(N, 4, 4) body to world at the frames; None without a file of poses."""
    path = next(
        (home / name / TABLE_FILE for name in _TRUTH_DIRS if is_given(home / name / TABLE_FILE)), None
    )
    if path is None:
        if is_given(home / "leica0"):
            notice(
                str(home / "leica0"), "has positions without orientations: it does not count as ground truth"
            )
        return None
    poses_at = read_euroc_poses(path, origin, stamps_s, tolerance_s)
    markers = path.parent / SENSOR_FILE
    if path.parent.name != _TRUTH_DIRS[0] and is_given(markers):
        poses_at = poses_at @ np.linalg.inv(_matrix(markers, _sensor(markers, "T_BS")))
    return poses_at


def read_euroc_poses(path: Path, origin: int, stamps_s: np.ndarray, tolerance_s: float) -> np.ndarray:
    """(N, 4, 4) poses nearest in time to the frames, NaN where none is near.

    Args:
        path: a data.csv of stamps in nanoseconds, positions and quaternions wxyz.
        origin: nanoseconds at 0 s of the frames.
        stamps_s: (N,) stamps of the frames.
        tolerance_s: largest time between a frame and its pose.

    Raises:
        InputError: the file is malformed, holds no pose, or has another clock.
    """
    rows = data_rows(path, read_rows(path, "", ","))
    # Velocity and biases may follow the pose.
    rows = ((where, words[:8] if len(words) == 17 else words) for where, words in rows)
    check = partial(check_pose, names=_POSE_COLUMNS[1:])
    stamps, table = stamped_numbers(rows, _POSE_COLUMNS, to_nanoseconds, check)
    if not stamps:
        raise InputError(str(path), "holds no pose", "add poses, or delete it to run without ground truth")
    poses = poses_of(table[:, :3], np.roll(table[:, 3:], -1, axis=1))
    return nearest_poses(path, stamps_s, to_seconds(stamps, origin), poses, tolerance_s)


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


def write_euroc(
    sequence: Sequence,
    directory: Path,
    imu: tuple[ImuReadings, ImuTruth | None] | None = None,
    progress: Progress | None = None,
) -> None:
    """Write a sequence in the EuRoC form. Arguments and errors as of ``write_sequence``."""
    stamps = written_ns(sequence)
    T_cam_body = imu[0].model.T_cam_imu if imu else np.eye(4)
    with new_directory(directory) as folder:
        camera_dir = folder / CAMERA_DIR
        (camera_dir / "data").mkdir(parents=True)
        names = [f"{stamp}.png" for stamp in stamps]
        write_images(sequence.frames, [camera_dir / "data" / name for name in names], "writing", progress)
        rows = [f"{stamp},{name}" for stamp, name in zip(stamps, names, strict=True)]
        _write_table(camera_dir, "#timestamp [ns],filename", rows)
        (folder / TIMES_FILE).write_text("".join(f"{stamp}\n" for stamp in stamps))
        _write_sensor(camera_dir, _camera_record(sequence.camera, np.linalg.inv(T_cam_body)))
        if imu:
            _write_imu(folder / IMU_DIR, imu[0], origin_ns(sequence))
        if sequence.T_world_cam is not None:
            truth = imu[1] if imu else None
            _write_truth(folder / TRUTH_DIR, stamps, sequence.T_world_cam @ T_cam_body, truth)
        write_sidecars(sequence, folder)


def _write_table(folder: Path, header: str, rows: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / TABLE_FILE).write_text("\n".join([header, *rows]) + "\n")


def _write_sensor(folder: Path, record: dict[str, Any]) -> None:
    (folder / SENSOR_FILE).write_text(yaml.safe_dump(record, sort_keys=False))


def _mounting(T: np.ndarray) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": [float(value) for value in T.flat]}


def _camera_record(camera: Intrinsics, T_body_cam: np.ndarray) -> dict[str, Any]:
    coefficients = list(camera.distortion)
    # EuRoC writes four coefficients; the fifth is added only if it is not 0.
    if camera.model == "radtan" and coefficients[4] == 0:
        coefficients.pop()
    return {
        "sensor_type": "camera",
        "T_BS": _mounting(T_body_cam),
        "rate_hz": camera.fps,
        "resolution": [camera.width_px, camera.height_px],
        "camera_model": "pinhole",
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "distortion_model": _LENS_NAMES[camera.model],
        "distortion_coefficients": coefficients,
    }


def _write_imu(folder: Path, readings: ImuReadings, origin: int) -> None:
    table = np.column_stack([readings.gyro_radps, readings.accel_mps2])
    stamps = to_ns(readings.stamps_s, origin)
    # Shortest decimals that give the same numbers.
    rows = [
        f"{stamp},{','.join(repr(float(value)) for value in row)}"
        for stamp, row in zip(stamps, table, strict=True)
    ]
    units = {"timestamp": "ns", "w": "rad s^-1", "a": "m s^-2"}
    header = ",".join(f"{name} [{units[name.split('_')[0]]}]" for name in _IMU_COLUMNS)
    _write_table(folder, f"#{header}", rows)
    noise = {key: getattr(readings.model, field) for key, field in _IMU_KEYS.items()}
    _write_sensor(folder, {"sensor_type": "imu", "T_BS": _mounting(np.eye(4)), **noise})


def _write_truth(folder: Path, stamps: list[int], T_world_body: np.ndarray, truth: ImuTruth | None) -> None:
    """Write the poses of frames that have one, with velocity and biases if known."""
    known = np.flatnonzero(np.isfinite(T_world_body).all(axis=(1, 2)))
    quat = Rotation.from_matrix(T_world_body[known, :3, :3]).as_quat(canonical=True, scalar_first=True)
    columns = [T_world_body[known, :3, 3], quat]
    header = (
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
    )
    if truth:
        columns += [truth.velocity_mps[known], truth.gyro_bias_radps[known], truth.accel_bias_mps2[known]]
        groups = {"v_RS_R": "m s^-1", "b_w_RS_S": "rad s^-1", "b_a_RS_S": "m s^-2"}
        header += "".join(f", {name}_{axis} [{unit}]" for name, unit in groups.items() for axis in "xyz")
    table = np.column_stack(columns)
    rows = [
        f"{stamps[frame]},{','.join(f'{value:.12f}' for value in row)}"
        for frame, row in zip(known, table, strict=True)
    ]
    _write_table(folder, header, rows)
    _write_sensor(folder, {"sensor_type": "visual-inertial", "T_BS": _mounting(np.eye(4))})
