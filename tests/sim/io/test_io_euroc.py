"""The EuRoC form: round trip with inertial readings, the clock of real recordings, one line per fault."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from io_sequences import COUNT, edit, fault, make_sequence
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError, InputNotice
from dslab.sim.io.euroc import load_euroc_imu
from dslab.sim.io.forms import Form, detect_form, load_sequence, write_sequence
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.imu import ImuModel, ImuReadings, ImuTruth

FISHEYE = Intrinsics(64, 48, 50.0, 51.0, 30.5, 20.25, 20.0, (0.1, -0.2, 0.01, 0.002), "equidistant")
STAMPS = "mav0/cam0/data.csv"
SENSOR = "mav0/cam0/sensor.yaml"
TRUTH = "mav0/state_groundtruth_estimate0/data.csv"
# Half a unit of the twelfth decimal, carried through rotations.
PRINTED = 1e-11


def make_imu() -> tuple[ImuReadings, ImuTruth]:
    rng = np.random.default_rng(1)
    stamps_s = np.arange(34) / 200
    readings = ImuReadings(ImuModel(), stamps_s, rng.normal(size=(34, 3)), rng.normal(size=(34, 3)))
    return readings, ImuTruth(*rng.normal(size=(3, COUNT, 3)))


@pytest.fixture
def folder(tmp_path) -> Path:
    write_sequence(make_sequence(), tmp_path / "seq", Form.EUROC, make_imu())
    return tmp_path / "seq"


def check_same(read, written) -> None:
    assert read.camera == written.camera
    stamps_ns = [round(t * 1e9) for t in written.stamps_s]
    assert [round(t * 1e9) for t in read.stamps_s] == stamps_ns
    for index in range(COUNT):
        np.testing.assert_array_equal(read.frames[index], written.frames[index])
    np.testing.assert_allclose(read.T_world_cam, written.T_world_cam, atol=PRINTED)
    assert read.segments == written.segments and read.name == "trial"


@pytest.mark.parametrize(
    ("lens", "imu"),
    [(make_sequence().camera, make_imu()), (FISHEYE, None)],
    ids=["radtan, with imu", "equidistant, camera only"],
)
def test_a_written_sequence_is_read_back(tmp_path, lens, imu):
    written = replace(make_sequence(), camera=lens)
    write_sequence(written, tmp_path / "seq", Form.EUROC, imu)
    assert detect_form(tmp_path / "seq") is Form.EUROC
    check_same(load_sequence(tmp_path / "seq"), written)
    check_same(load_sequence(tmp_path / "seq/mav0"), written)


def test_inertial_readings_are_read_back_bit_for_bit(folder):
    (written, _), read = make_imu(), load_euroc_imu(folder)
    np.testing.assert_array_equal(read.stamps_s, written.stamps_s)
    np.testing.assert_array_equal(read.gyro_radps, written.gyro_radps)
    np.testing.assert_array_equal(read.accel_mps2, written.accel_mps2)
    for name in ("rate_hz", "gyro_noise", "gyro_walk", "accel_noise", "accel_walk"):
        assert getattr(read.model, name) == getattr(written.model, name)
    np.testing.assert_allclose(read.model.T_cam_imu, written.model.T_cam_imu, atol=1e-14)


def test_without_inertial_readings_there_are_none(tmp_path):
    write_sequence(make_sequence(), tmp_path / "seq", Form.EUROC)
    assert not (tmp_path / "seq/mav0/imu0").exists()
    assert load_euroc_imu(tmp_path / "seq") is None
    assert len((tmp_path / "seq" / TRUTH).read_text().splitlines()[1].split(",")) == 8


def test_the_truth_is_the_body_s_in_the_order_of_the_data_set(folder):
    row = np.array((folder / TRUTH).read_text().splitlines()[3].split(","), float)
    sequence, (readings, truth) = make_sequence(), make_imu()
    T_world_imu = sequence.T_world_cam[2] @ readings.model.T_cam_imu
    assert row[0] == 66666667 and len(row) == 17
    np.testing.assert_allclose(row[1:4], T_world_imu[:3, 3], atol=1e-11)
    R = Rotation.from_quat(row[4:8], scalar_first=True).as_matrix()
    np.testing.assert_allclose(R, T_world_imu[:3, :3], atol=1e-11)
    expected = [truth.velocity_mps[2], truth.gyro_bias_radps[2], truth.accel_bias_mps2[2]]
    np.testing.assert_allclose(row[8:], np.concatenate(expected), atol=1e-11)
    sensor = yaml.safe_load((folder / SENSOR).read_text())
    T_body_cam = np.reshape(sensor["T_BS"]["data"], (4, 4))
    np.testing.assert_allclose(T_body_cam @ readings.model.T_cam_imu, np.eye(4), atol=1e-12)
    assert (folder / "mav0/cam0/data/66666667.png").is_file()


def test_the_camera_s_folder_may_stand_alone(folder, tmp_path):
    written = make_sequence()
    (folder / "mav0" / "cam0").rename(tmp_path / "cam0")
    for path in (tmp_path, tmp_path / "cam0"):
        assert detect_form(path) is Form.EUROC
        read = load_sequence(path)
        assert read.camera == written.camera and read.T_world_cam is None and len(read) == COUNT


def test_truth_of_motion_capture_is_that_of_its_markers(folder):
    """They are mounted somewhere on the body; TUM-VI and EuRoC's Vicon room have such files."""
    written, home = load_sequence(folder), folder / "mav0"
    T_body_markers = np.eye(4)
    T_body_markers[:3, :3] = Rotation.from_rotvec([0.1, 0.2, -0.3]).as_matrix()
    T_body_markers[:3, 3] = 0.05, -0.02, 0.1
    (home / TRUTH[5:]).parent.rename(home / "mocap0")
    rows = [line.split(",") for line in (home / "mocap0" / "data.csv").read_text().splitlines()]
    for row in rows[1:]:
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat(np.roll(np.array(row[4:8], float), -1)).as_matrix()
        T[:3, 3] = np.array(row[1:4], float)
        T = T @ T_body_markers
        quat_wxyz = np.roll(Rotation.from_matrix(T[:3, :3]).as_quat(), 1)
        row[1:] = [repr(float(value)) for value in (*T[:3, 3], *quat_wxyz)]
    (home / "mocap0" / "data.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    sensor = {"T_BS": {"rows": 4, "cols": 4, "data": T_body_markers.ravel().tolist()}}
    (home / "mocap0" / "sensor.yaml").write_text(yaml.safe_dump(sensor))
    np.testing.assert_allclose(load_sequence(folder).T_world_cam, written.T_world_cam, atol=1e-8)


def test_without_a_sensor_file_the_camchain_counts(folder):
    written = load_sequence(folder)
    sensor = yaml.safe_load((folder / SENSOR).read_text().removeprefix("%YAML:1.0"))
    (folder / SENSOR).unlink()
    (folder / "dso").mkdir()
    T_cam_body = np.linalg.inv(np.reshape(sensor["T_BS"]["data"], (4, 4)))
    camera = {
        "T_cam_imu": T_cam_body.tolist(), "camera_model": "pinhole", "distortion_model": "radtan",
        "distortion_coeffs": sensor["distortion_coefficients"], "intrinsics": sensor["intrinsics"],
        "resolution": sensor["resolution"],
    }  # fmt: skip
    (folder / "dso" / "camchain.yaml").write_text(yaml.safe_dump({"cam0": camera}))
    read = load_sequence(folder)
    assert read.camera == replace(written.camera, fps=30.0)
    np.testing.assert_allclose(read.T_world_cam, written.T_world_cam, atol=1e-8)
    for bad in ({"cam1": camera}, {"cam0": camera | {"T_cam_imu": 3}}):
        (folder / "dso" / "camchain.yaml").write_text(yaml.safe_dump(bad))
        fault(folder, "camchain.yaml", "cam0")


def test_positions_alone_are_no_truth_and_it_is_said(folder):
    (folder / "mav0" / TRUTH[5:]).parent.rename(folder / "mav0" / "leica0")
    with pytest.warns(InputNotice, match="leica0: has positions without orientations"):
        assert load_sequence(folder).T_world_cam is None


def test_stamps_since_1970_keep_every_nanosecond(folder, tmp_path):
    origin = 1403636579763555584
    for file in (folder / STAMPS, folder / TRUTH, folder / "mav0/imu0/data.csv"):
        header, *lines = file.read_text().splitlines()
        shifted = [f"{int(line.split(',', 1)[0]) + origin},{line.split(',', 1)[1]}" for line in lines]
        file.write_text("\r\n".join([header, *shifted]) + "\r\n")
    sequence = load_sequence(folder)
    assert sequence.meta["stamp_origin_ns"] == origin
    check_same(sequence, make_sequence())
    np.testing.assert_array_equal(load_euroc_imu(folder).stamps_s, make_imu()[0].stamps_s)
    write_sequence(sequence, tmp_path / "again", Form.EUROC)
    rows = [(root / STAMPS).read_text().splitlines()[1:] for root in (folder, tmp_path / "again")]
    assert [r.split(",")[0] for r in rows[0]] == [r.split(",")[0] for r in rows[1]]
    check_same(load_sequence(tmp_path / "again"), sequence)


@pytest.mark.filterwarnings("ignore:.*truth covers")
def test_a_frame_without_pose_has_none_when_read_back(tmp_path):
    sequence = make_sequence()
    sequence.T_world_cam[3] = np.nan
    write_sequence(sequence, tmp_path / "seq", Form.EUROC)
    read = load_sequence(tmp_path / "seq").T_world_cam
    np.testing.assert_allclose(read, sequence.T_world_cam, atol=PRINTED)


def test_opencv_s_yaml_and_other_names_are_read(folder):
    edit(folder / SENSOR, "sensor_type", "%YAML:1.0\nsensor_type")
    edit(folder / SENSOR, "rate_hz: 30.0\n", "")  # the stamps tell it
    edit(folder / SENSOR, "radial-tangential", "radtan")
    assert load_sequence(folder).camera == make_sequence().camera


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        (STAMPS, "66666667,", "33333333,", ["data.csv:4: stamp", "33333333 does not come after 33333333"]),
        (STAMPS, "66666667,", "0.0667,", ["data.csv:4: timestamp", "nanoseconds"]),
        (STAMPS, ",66666667.png", "", ["data.csv:4", "cut short"]),
        (SENSOR, "- 50.0\n", "", ["sensor.yaml: intrinsics", "4 numbers"]),
        (SENSOR, "- 64", "- 65", ["0.png", "64x48", "sensor.yaml says 65x48"]),
        (SENSOR, "radial-tangential", "omni", ["sensor.yaml: distortion_model", "'omni'"]),
        (SENSOR, "T_BS:", "T_SB:", ["sensor.yaml: T_BS", "is missing"]),
        (TRUTH, "66666667,", "66666667,x", ["data.csv:4: p_x", "'x"]),
        (TRUTH, "66666667,", "66666667,1,", ["data.csv:4", "18 numbers"]),
    ],
)
def test_each_fault_of_a_file_names_place_and_field(folder, file, old, new, expected):
    edit(folder / file, old, new)
    fault(folder, *expected)


def test_each_fault_of_the_truth_names_its_line(folder):
    path = folder / TRUTH
    header, _, *rest = path.read_text().splitlines()
    path.write_text("\n".join([header, "0,1,2,3,0,0,0,0", *rest]))
    fault(folder, "data.csv:2: q_w q_x q_y q_z", "unit quaternion")
    path.write_text("\n".join([header, "99000000000,1,2,3,1,0,0,0"]))
    fault(folder, "data.csv", "clock")
    path.write_text(header)
    fault(folder, "data.csv", "holds no pose")


def imu_fault(folder: Path, *expected: str) -> None:
    with pytest.raises(InputError) as caught:
        load_euroc_imu(folder)
    for part in expected:
        assert part in str(caught.value)


def test_each_fault_of_the_inertial_files_names_its_place(folder):
    table, sensor = folder / "mav0/imu0/data.csv", folder / "mav0/imu0/sensor.yaml"
    whole = table.read_text()
    edit(table, "\n5000000,", "\n0,")
    imu_fault(folder, "data.csv:3: stamp", "does not come after")
    table.write_text(whole.replace("\n5000000,", "\n5000000,1,"))
    imu_fault(folder, "data.csv:3", "8 numbers where 7")
    table.write_text(whole.replace("\n5000000,", "\n5000000,x"))
    imu_fault(folder, "data.csv:3: w_RS_S_x", "finite")
    table.write_text(whole.splitlines()[0])
    imu_fault(folder, "data.csv", "holds no reading")
    table.write_text(whole)
    edit(sensor, "gyroscope_noise_density: ", "gyroscope_noise_density: -")
    imu_fault(folder, "sensor.yaml: imu: gyro_noise", "no density")
    sensor.unlink()
    imu_fault(folder, "sensor.yaml", "no such file")
