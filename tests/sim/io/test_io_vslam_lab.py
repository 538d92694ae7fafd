"""The VSLAM-LAB form: folders as its tools write them, our own, one line per fault."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from io_sequences import COUNT, SHAPE, edit, fault, make_sequence

from dslab.sim.io.forms import Form, detect_form, load_sequence, write_sequence

ORIGIN = 1403636579763555584
CALIBRATION = """%YAML 1.2
---
cameras:
  - {cam_name: rgb_0,
     cam_type: gray,
     cam_model: pinhole,
     distortion_type: radtan4,
     focal_length: [58.6, 57.2],
     principal_point: [36.7, 24.8],
     distortion_coefficients: [-0.28, 0.07, 0.0002, 1.76e-05],
     image_dimension: [64, 48],
     fps: 20.0,
     T_BS: [0.0, -1.0, 0.0, -0.0216, 1.0, 0.0, 0, -0.0646, 0, 0, 1.0, 0.0098, 0, 0, 0, 1] # wrt. the body
    }

  - {cam_name: rgb_1,
     cam_type: gray,
     cam_model: pinhole,
     focal_length: [1.0, 1.0],
    }


imus:
  - {imu_name: imu_0,
     fps: 200.0,
    }
"""


@pytest.fixture
def folder(tmp_path) -> Path:
    """Stereo with absolute stamps, as the tools make it of EuRoC; one stamp as of a floating-point number."""
    home = tmp_path / "MH_01_easy"
    for name in ("rgb_0", "rgb_1"):
        (home / name).mkdir(parents=True)
    rng, rows, poses = np.random.default_rng(0), [], []
    for index in range(COUNT):
        stamp = ORIGIN + 50_000_000 * index
        cv2.imwrite(str(home / f"rgb_0/{stamp}.png"), rng.integers(0, 256, SHAPE, dtype=np.uint8))
        rows.append(f"{stamp},rgb_0/{stamp}.png,{stamp},rgb_1/{stamp}.png")
        poses.append(f"{stamp + 1000},{index},0.5,-1.25,0.0,0.0,0.6,0.8")
    header = "ts_rgb_0 (ns),path_rgb_0,ts_rgb_1 (ns),path_rgb_1"
    (home / "rgb.csv").write_text("\r\n".join([header, *rows]) + "\r\n")
    (home / "calibration.yaml").write_text(CALIBRATION)
    poses[0] = poses[0].replace(str(ORIGIN + 1000), f"{ORIGIN}.0")
    (home / "groundtruth.csv").write_text(
        "\n".join(["ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw", *poses]) + "\n"
    )
    return home


def test_a_folder_of_the_tools_is_read(folder):
    assert detect_form(folder) is Form.VSLAM_LAB
    sequence = load_sequence(folder)
    camera = sequence.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.fps) == (58.6, 57.2, 36.7, 24.8, 20)
    assert camera.model == "radtan" and camera.distortion == (-0.28, 0.07, 0.0002, 1.76e-05, 0)
    np.testing.assert_allclose(sequence.stamps_s, np.arange(COUNT) / 20, atol=1e-9)
    assert sequence.meta["stamp_origin_ns"] == ORIGIN
    image = cv2.imread(str(folder / sequence.image_names[2]), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(sequence.frames[2], image)
    # The truth is the camera's own: its place on the body plays no part.
    np.testing.assert_allclose(sequence.T_world_cam[3, :3, 3], [3, 0.5, -1.25])
    np.testing.assert_allclose(sequence.T_world_cam[0, :3, :3] @ [1, 0, 0], [0.28, 0.96, 0], atol=1e-9)
    assert sequence.depths is None


def test_depth_has_the_factor_of_the_calibration(folder):
    (folder / "depth_0").mkdir()
    cv2.imwrite(str(folder / "depth_0/a.png"), np.full(SHAPE, 2500, np.uint16))
    header, first, second, *rest = (folder / "rgb.csv").read_text().splitlines()
    lines = [f"{header},ts_depth_0 (ns),path_depth_0", f"{first},7,depth_0/a.png"]
    lines += [f"{row},," for row in (second, *rest)]
    (folder / "rgb.csv").write_text("\n".join(lines) + "\n")
    edit(folder / "calibration.yaml", "cam_type: gray,", "cam_type: rgb+depth,\n     depth_factor: 1000.0,")
    depths = load_sequence(folder).depths
    assert (depths[0] == 2.5).all() and (depths[1] == 0).all()


@pytest.mark.parametrize("kind", ["csv", "txt"])
def test_earlier_folders_are_read(folder, kind):
    """Stamps in seconds and settings of ORB-SLAM; lists with commas or of the TUM form."""
    new = load_sequence(folder)
    third = new.frames[3]
    stamps = [f"{(ORIGIN + 50_000_000 * index) / 1e9:.6f}" for index in range(COUNT)]
    poses = [f"{stamp},{index},0.5,-1.25,0.0,0.0,0.6,0.8" for index, stamp in enumerate(stamps)]
    rows = [f"{stamp},{name}" for stamp, name in zip(stamps, new.image_names, strict=True)]
    for name in ("rgb.csv", "groundtruth.csv"):
        (folder / name).unlink()
    if kind == "csv":
        (folder / "rgb.csv").write_text("\n".join(["ts_rgb0 (s),path_rgb0", *rows]))
        (folder / "groundtruth.csv").write_text("\n".join(["ts,tx,ty,tz,qx,qy,qz,qw", *poses]))
    else:
        (folder / "rgb_0").rename(folder / "rgb")
        (folder / "rgb.txt").write_text("\n".join(rows).replace(",", " ").replace("rgb_0/", "rgb/"))
        (folder / "groundtruth.txt").write_text("\n".join(poses).replace(",", " "))
    lines = ["%YAML:1.0", "Camera.fx: 58.6", "Camera.fy: 57.2", "Camera.cx: 36.7", "Camera.cy: 24.8"]
    lines += ["Camera.k1: -0.28", "Camera.k2: 0.07", "Camera.p1: 0.0002", "Camera.p2: 1.76e-05"]
    (folder / "calibration.yaml").write_text(
        "\n".join([*lines, "Camera.w: 64", "Camera.h: 48", "Camera.fps: 20"])
    )
    read = load_sequence(folder)
    assert read.camera == new.camera
    np.testing.assert_allclose(np.diff(read.stamps_s), 0.05, atol=2e-6)
    np.testing.assert_allclose(read.T_world_cam, new.T_world_cam, atol=1e-9)
    np.testing.assert_array_equal(read.frames[3], third)


@pytest.mark.parametrize("truth", ["header only", "absent"])
def test_a_folder_without_truth_is_read(folder, truth):
    path = folder / "groundtruth.csv"
    path.write_text(path.read_text().splitlines()[0] + "\n")
    if truth == "absent":
        path.unlink()
    assert load_sequence(folder).T_world_cam is None


@pytest.mark.filterwarnings("ignore:.*truth covers")
def test_what_is_written_is_the_published_form_and_is_read_back(tmp_path):
    written = make_sequence()
    written.T_world_cam[2] = np.nan
    write_sequence(written, tmp_path / "out", Form.VSLAM_LAB, depth=True)
    lines = (tmp_path / "out/rgb.csv").read_text().splitlines()
    assert lines[0] == "ts_rgb_0 (ns),path_rgb_0,ts_depth_0 (ns),path_depth_0"
    assert lines[2] == "33333333,rgb_0/000001.png,33333333,depth_0/000001.png"
    lines = (tmp_path / "out/groundtruth.csv").read_text().splitlines()
    assert lines[0] == "ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw" and len(lines) == COUNT
    (camera,) = yaml.safe_load((tmp_path / "out/calibration.yaml").read_text())["cameras"]
    assert camera["cam_name"] == "rgb_0" and camera["depth_name"] == "depth_0"
    assert camera["distortion_type"] == "radtan5" and camera["T_BS"] == np.eye(4).ravel().tolist()
    read = load_sequence(tmp_path / "out")
    assert read.camera == written.camera and read.segments == written.segments
    np.testing.assert_allclose(read.stamps_s, written.stamps_s, atol=1e-9)
    np.testing.assert_array_equal(read.frames[4], written.frames[4])
    np.testing.assert_allclose(read.depths[4], written.depths[4], atol=1.01e-4)
    np.testing.assert_allclose(read.T_world_cam, written.T_world_cam, atol=1e-8)


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        ("rgb.csv", "path_rgb_0", "file", ["rgb.csv:1: path_rgb_0", "is no column of", "ts_rgb_0 (ns)"]),
        ("rgb.csv", f"{ORIGIN}.png,{ORIGIN}", f"{ORIGIN}.png", ["rgb.csv:2", "3 numbers where 4 belong"]),
        ("rgb.csv", f"\n{ORIGIN}", "\nnow", ["rgb.csv:2: timestamp", "'now'"]),
        ("rgb.csv", f"\n{ORIGIN}", "\n1.7e39", ["rgb.csv:2: timestamp", "no stamp in nanoseconds"]),
        ("rgb.csv", f"rgb_0/{ORIGIN}.png", "rgb_0/x.png", ["x.png", "missing or empty", "rgb.csv"]),
        ("calibration.yaml", "cam_name: rgb_0", "cam_name: left", ["cameras", "0 entries", "rgb_0"]),
        ("calibration.yaml", "cam_model: pinhole", "cam_model: unknown", ["rgb_0: cam_model", "'unknown'"]),
        ("calibration.yaml", "radtan4", "fov", ["rgb_0: distortion_type", "radtan5", "equid4"]),
        ("calibration.yaml", "radtan4", "radtan5", ["distortion_coefficients", "no list of 5 numbers"]),
        ("calibration.yaml", "[64, 48]", "[65, 48]", ["64x48 pixels", "calibration.yaml says 65x48"]),
        ("calibration.yaml", "fps: 20.0,", "", ["rgb_0: fps", "is missing"]),
        ("groundtruth.csv", "tx (m)", "x", ["groundtruth.csv:1", "not the header", "tx (m)"]),
        ("groundtruth.csv", "0.6,0.8", "0.6,0.9", ["groundtruth.csv:2: qx qy qz qw", "unit quaternion"]),
    ],
)
def test_each_fault_of_a_file_names_place_and_field(folder, file, old, new, expected):
    edit(folder / file, old, new)
    fault(folder, *expected)


def test_the_command_writes_the_form(dslab, tmp_path):
    write_sequence(make_sequence(), tmp_path / "seq", Form.TUM, depth=True)
    dslab("export", str(tmp_path / "seq"), "--format", "vslam-lab", "--out", str(tmp_path / "out"))
    assert detect_form(tmp_path / "out") is Form.VSLAM_LAB
    assert load_sequence(tmp_path / "out").depths is not None
