"""Writer of the EuRoC (ASL) form, all or nothing; see ``sim.io.euroc_layout``."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from dslab.sim.io import euroc_layout as layout
from dslab.sim.io.folders import Progress, new_directory, write_images
from dslab.sim.io.sidecars import write_sidecars
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.imu import ImuModel, ImuReadings, ImuTruth
from dslab.sim.sequence import Sequence


def write_euroc(
    sequence: Sequence,
    directory: Path,
    imu: tuple[ImuReadings, ImuTruth | None] | None = None,
    progress: Progress | None = None,
) -> None:
    """Write a sequence in the EuRoC form.

    Args:
        sequence: what to write.
        directory: new or empty folder; it will hold ``mav0``.
        imu: readings and, if known, the truth at the frames, from ``sim.sensors.imu.record_imu``; None
            for none.
        progress: called with step, frames done and frames in all.

    Raises:
        InputError: the folder is not empty or cannot be written, the disk is full; nothing is left behind.
    """
    stamps = layout.to_ns(sequence.stamps_s, layout.origin_ns(sequence))
    T_cam_body = imu[0].model.T_cam_imu if imu else np.eye(4)
    with new_directory(directory) as folder:
        camera_dir = folder / layout.CAMERA_DIR
        (camera_dir / "data").mkdir(parents=True)
        names = [f"{stamp}.png" for stamp in stamps]
        write_images(sequence.frames, [camera_dir / "data" / name for name in names], "writing", progress)
        rows = [f"{stamp},{name}" for stamp, name in zip(stamps, names, strict=True)]
        _write_table(camera_dir, "#timestamp [ns],filename", rows)
        _write_sensor(camera_dir, _camera_record(sequence.camera, np.linalg.inv(T_cam_body)))
        if imu:
            _write_imu(folder / layout.IMU_DIR, imu[0], layout.origin_ns(sequence))
        if sequence.T_world_cam is not None:
            truth = imu[1] if imu else None
            _write_truth(folder / layout.TRUTH_DIR, stamps, sequence.T_world_cam @ T_cam_body, truth)
        write_sidecars(sequence, folder)


def _write_table(folder: Path, header: str, rows: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / layout.TABLE_FILE).write_text("\n".join([header, *rows]) + "\n")


def _write_sensor(folder: Path, record: dict[str, Any]) -> None:
    (folder / layout.SENSOR_FILE).write_text(yaml.safe_dump(record, sort_keys=False))


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
        "distortion_model": layout.LENS_NAMES[camera.model],
        "distortion_coefficients": coefficients,
    }


def _write_imu(folder: Path, readings: ImuReadings, origin: int) -> None:
    table = np.column_stack([readings.gyro_radps, readings.accel_mps2])
    stamps = layout.to_ns(readings.stamps_s, origin)
    # Shortest decimals that give the same numbers.
    rows = [
        f"{stamp},{','.join(repr(float(value)) for value in row)}"
        for stamp, row in zip(stamps, table, strict=True)
    ]
    units = {"timestamp": "ns", "w": "rad s^-1", "a": "m s^-2"}
    header = ",".join(f"{name} [{units[name.split('_')[0]]}]" for name in layout.IMU_COLUMNS)
    _write_table(folder, f"#{header}", rows)
    model: ImuModel = readings.model
    record = {
        "sensor_type": "imu",
        "T_BS": _mounting(np.eye(4)),
        "rate_hz": model.rate_hz,
        "gyroscope_noise_density": model.gyro_noise,
        "gyroscope_random_walk": model.gyro_walk,
        "accelerometer_noise_density": model.accel_noise,
        "accelerometer_random_walk": model.accel_walk,
    }
    _write_sensor(folder, record)


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
