"""TartanAir: trajectories after its published description, one line per fault."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from io_sequences import edit, fault
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError
from dslab.sim.io.forms import Form, detect_form, load_sequence

COUNT = 3
# Forward (north) 1 m a frame, 2 m to the right (east), 3 m below the origin; it looks to the east.
EAST = Rotation.from_euler("z", 90, degrees=True)
POSES = [(k, 2.0, 3.0, *EAST.as_quat()) for k in range(COUNT)]


@pytest.fixture
def folder(tmp_path) -> Path:
    home = tmp_path / "P001"
    (home / "image_left").mkdir(parents=True)
    (home / "depth_left").mkdir()
    for index in range(COUNT):
        image = np.full((480, 640, 3), 50 + index, np.uint8)
        cv2.imwrite(str(home / f"image_left/{index:06d}_left.png"), image)
        depth = np.full((480, 640), 4.0 + index, np.float32)
        depth[:100] = 10000
        np.save(home / f"depth_left/{index:06d}_left_depth.npy", depth)
    rows = (" ".join(f"{value:.18e}" for value in row) for row in POSES)
    (home / "pose_left.txt").write_text("\n".join(rows) + "\n")
    return home


def test_a_trajectory_is_read_with_the_published_camera(folder):
    assert detect_form(folder) is Form.TARTANAIR
    sequence = load_sequence(folder)
    camera = sequence.camera
    assert (camera.width_px, camera.height_px, camera.is_pinhole) == (640, 480, True)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (320, 320, 320, 240)
    np.testing.assert_allclose(sequence.stamps_s, [0, 0.1, 0.2])
    assert (sequence.frames[2] == 52).all()
    assert sequence.depths[1][200, 300] == 5 and sequence.depths[1][0, 0] == 10000


def test_poses_turn_from_north_east_down_to_a_camera_in_a_world_with_z_up(folder):
    T = load_sequence(folder).T_world_cam
    # World: x north, y west, z up.
    np.testing.assert_allclose(T[2, :3, 3], [2, -2, -3])
    for axis, points in (((0, 0, 1), (0, -1, 0)), ((1, 0, 0), (-1, 0, 0)), ((0, 1, 0), (0, 0, -1))):
        np.testing.assert_allclose(T[2, :3, :3] @ axis, points, atol=1e-12)
    assert np.linalg.det(T[2, :3, :3]) == pytest.approx(1)


def test_a_camera_file_says_otherwise(folder):
    text = "fx: 300\nfy: 300\ncx: 319.5\ncy: 239.5\nwidth: 640\nheight: 480\nfps: 30\n"
    (folder / "camera.yaml").write_text(text)
    sequence = load_sequence(folder)
    assert sequence.camera.fx == 300 and sequence.stamps_s[1] == pytest.approx(1 / 30)


def test_the_second_version_has_other_names_and_square_images(tmp_path):
    home = tmp_path / "P000"
    (home / "image_lcam_front").mkdir(parents=True)
    for index in range(2):
        path = home / f"image_lcam_front/{index:06d}_lcam_front.png"
        cv2.imwrite(str(path), np.zeros((640, 640), np.uint8))
    sequence = load_sequence(home)
    assert (sequence.camera.width_px, sequence.camera.height_px, sequence.camera.cy) == (640, 640, 320)
    assert sequence.T_world_cam is None and sequence.depths is None


def test_each_fault_names_place_and_remedy(folder):
    edit(folder / "pose_left.txt", "3.0", "x")
    fault(folder, "pose_left.txt:1: tz", "finite number")
    (folder / "pose_left.txt").write_text("0 0 0 0 0 0 1\n")
    fault(folder, "pose_left.txt", "1 poses for 3 images", "delete it")
    (folder / "pose_left.txt").write_text("0 0 0 0 0 0 2\n" * 3)
    fault(folder, "pose_left.txt:1: qx qy qz qw", "unit quaternion")
    (folder / "pose_left.txt").unlink()
    (folder / "depth_left/000001_left_depth.npy").write_bytes(b"no array")
    with pytest.raises(InputError, match=r"000001_left_depth.npy: is no readable array"):
        load_sequence(folder).depths[1]
    (folder / "depth_left/000001_left_depth.npy").unlink()
    fault(folder, "000001_left_depth.npy", "is missing", "delete depth_left")
    (folder / "image_left/000001_left.png").rename(folder / "image_left/000007_left.png")
    fault(folder, "000002_left.png", "image 1 is missing")
    cv2.imwrite(str(folder / "image_left/000000_left.png"), np.zeros((100, 100), np.uint8))
    (folder / "image_left/000007_left.png").unlink()
    (folder / "image_left/000002_left.png").unlink()
    fault(folder, "000000_left.png", "100x100", "640x480", "camera.yaml")
