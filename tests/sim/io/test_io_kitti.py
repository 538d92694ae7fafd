"""KITTI's odometry form: round trip, the data set's own layout, one line per fault."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from io_sequences import COUNT, PINHOLE, edit, fault, make_sequence

from dslab.scenarios.errors import InputError, InputNotice
from dslab.sim.io.forms import Form, detect_form, load_sequence, write_sequence


@pytest.fixture
def folder(tmp_path) -> Path:
    write_sequence(replace(make_sequence(), camera=PINHOLE), tmp_path / "seq", Form.KITTI)
    return tmp_path / "seq"


def test_a_written_sequence_is_read_back(folder):
    written, read = make_sequence(), load_sequence(folder)
    assert detect_form(folder) is Form.KITTI
    assert read.camera == PINHOLE
    np.testing.assert_allclose(read.stamps_s, written.stamps_s, atol=5.1e-10, rtol=0)
    for index in range(COUNT):
        np.testing.assert_array_equal(read.frames[index], written.frames[index])
    np.testing.assert_allclose(read.T_world_cam, written.T_world_cam, atol=2e-9)
    assert read.segments == written.segments and read.name == "trial"
    np.testing.assert_allclose(read.frame_truth["blur_px"], written.frame_truth["blur_px"])


def test_writing_what_was_read_gives_the_same_bytes(folder, tmp_path):
    write_sequence(load_sequence(folder), tmp_path / "again", Form.KITTI)
    files = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    assert len(files) == COUNT + 7
    for file in files:
        if file.name != "00.txt":
            assert (tmp_path / "again" / file).read_bytes() == (folder / file).read_bytes(), file
    poses = [np.loadtxt(root / "poses/00.txt") for root in (folder, tmp_path / "again")]
    np.testing.assert_allclose(poses[0], poses[1], rtol=0, atol=2e-9)


def test_the_files_are_the_benchmark_s(folder):
    P0 = np.array((folder / "calib.txt").read_text().split()[1:], float).reshape(3, 4)
    np.testing.assert_array_equal(P0, np.column_stack([PINHOLE.K, np.zeros(3)]))
    row = np.loadtxt(folder / "poses/00.txt")[2]
    np.testing.assert_allclose(row.reshape(3, 4), make_sequence().T_world_cam[2, :3], atol=1e-9)
    np.testing.assert_allclose(np.loadtxt(folder / "times.txt"), np.arange(COUNT) / 30, atol=1e-9)
    image = cv2.imread(str(folder / "image_0/000003.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(image, make_sequence().frames[3])


def test_poses_are_found_where_the_data_set_has_them(folder, tmp_path):
    home = tmp_path / "dataset/sequences/07"
    home.parent.mkdir(parents=True)
    folder.rename(home)
    (tmp_path / "dataset/poses").mkdir()
    (home / "poses/00.txt").rename(tmp_path / "dataset/poses/07.txt")
    np.testing.assert_allclose(load_sequence(home).T_world_cam, make_sequence().T_world_cam, atol=2e-9)
    (tmp_path / "dataset/poses/07.txt").unlink()
    assert load_sequence(home).T_world_cam is None


def test_colour_images_have_their_own_projection(folder):
    """JPEGs, and no file of times."""
    (folder / "image_2").mkdir()
    for path in sorted((folder / "image_0").iterdir()):
        gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(folder / "image_2" / f"{path.stem}.jpg"), np.dstack([gray, gray // 2, gray]))
        path.unlink()
    (folder / "image_0").rmdir()
    (folder / "times.txt").unlink()
    first = (folder / "calib.txt").read_text()
    words = first.replace("P0", "P2").split()
    words[4] = "44.5"  # the distance to the first camera
    (folder / "calib.txt").write_text(first + " ".join(words) + "\n")
    (folder / "poses/00.txt").rename(folder / "poses.txt")
    with pytest.warns(InputNotice, match="has no times.txt: frames count as taken 10 times a second"):
        read = load_sequence(folder)
    assert detect_form(folder) is Form.KITTI and read.camera == replace(PINHOLE, fps=10.0)
    np.testing.assert_allclose(read.stamps_s, np.arange(COUNT) / 10)
    assert read.frames[3].shape == make_sequence().frames[3].shape and len(read.T_world_cam) == COUNT


def test_a_raw_drive_is_read(folder, tmp_path):
    drive = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync"
    (drive / "image_00").mkdir(parents=True)
    (folder / "image_0").rename(drive / "image_00" / "data")
    stamps = [f"2011-09-26 13:02:25.{100_000_000 * i + 7:09d}" for i in range(COUNT)]
    (drive / "image_00" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    calibration = "calib_time: 09-Jan-2012\n" + (folder / "calib.txt").read_text().replace(
        "P0:", "P_rect_00:"
    )
    (drive.parent / "calib_cam_to_cam.txt").write_text(calibration)
    read = load_sequence(drive)
    assert detect_form(drive) is Form.KITTI and read.camera == replace(PINHOLE, fps=10.0)
    np.testing.assert_allclose(read.stamps_s, np.arange(COUNT) / 10, atol=1e-9)
    extracted = drive.parent / "calib_cam_to_cam.txt"
    extracted.write_text("S_rect_00: 60 40\n" + extracted.read_text())
    fault(drive, "image_00/data", "64x48 pixels", "calib_cam_to_cam.txt says 60x40")
    edit(drive / "image_00" / "timestamps.txt", "2011-09-26 13", "yesterday 13")
    fault(drive, "timestamps.txt:1: timestamp: 'yesterday 13")


def test_of_more_poses_those_of_the_images_count(folder):
    for path in sorted((folder / "image_0").iterdir())[-2:]:
        path.unlink()
    times = (folder / "times.txt").read_text().splitlines()[:-2]
    (folder / "times.txt").write_text("\n".join(times) + "\n")
    (folder / "segments.json").unlink()
    (folder / "frame_truth.csv").unlink()
    with pytest.warns(
        InputNotice, match=f"has {COUNT} poses for {COUNT - 2} images: those of lines 1 to {COUNT - 2}"
    ):
        read = load_sequence(folder)
    np.testing.assert_allclose(read.T_world_cam, make_sequence().T_world_cam[:-2], atol=2e-9)


def test_a_sequence_beyond_the_form_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"rectified images; add --rectify .dslab export., or use"):
        write_sequence(make_sequence(), tmp_path / "seq", Form.KITTI)
    sequence = replace(make_sequence(), camera=PINHOLE)
    sequence.T_world_cam[4] = np.nan
    with pytest.raises(InputError, match="frame 4 has no pose"):
        write_sequence(sequence, tmp_path / "seq", Form.KITTI)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        ("times.txt", "0.066666667", "0.02", ["times.txt:3: stamp", "does not come after"]),
        ("times.txt", "0.066666667\n", "", ["image_0", "6 images, times.txt 5 stamps"]),
        ("calib.txt", "P0:", "P1:", ["calib.txt: P0", "is missing"]),
        ("calib.txt", "50.0 0.0", "50.0 0.1", ["calib.txt:1: P0", "no projection"]),
        ("poses/00.txt", "\n", " 1\n", ["00.txt:1", "13 numbers where 12"]),
        ("poses/00.txt", "e-01 ", "e+03 ", ["00.txt:1", "no rotation"]),
    ],
)
def test_each_fault_of_a_file_names_place_and_field(folder, file, old, new, expected):
    edit(folder / file, old, new)
    fault(folder, *expected)


def test_poses_of_another_length_or_twice_are_refused(folder):
    poses = folder / "poses/00.txt"
    (folder / "07.txt").write_bytes(poses.read_bytes())
    fault(folder, "several files of poses", "00.txt, 07.txt")
    (folder / "07.txt").unlink()
    poses.write_text("\n".join(poses.read_text().splitlines()[:-1]))
    fault(folder, "00.txt", "5 poses for 6 frames")


def test_missing_files_and_images_are_named(folder):
    (folder / "image_0/000002.png").write_bytes(b"")
    fault(folder, "000002.png", "missing or empty")
    (folder / "image_0/000002.png").write_bytes((folder / "image_0/000001.png").read_bytes())
    cv2.imwrite(str(folder / "image_0/000005.png"), np.zeros((50, 64), np.uint8))
    with pytest.raises(InputError, match=r"64x50 pixels, image_0/000000\.png says 64x48"):
        load_sequence(folder).frames[5]
    (folder / "calib.txt").unlink()
    fault(folder, "calib.txt", "no such file")
