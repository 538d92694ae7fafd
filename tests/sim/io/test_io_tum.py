"""TUM-form folders: round trip, variations of real recordings, one line per fault."""

import json
import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from io_sequences import COUNT, SHAPE, edit, fault, make_sequence
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError, InputNotice
from dslab.sim.io.forms import load_sequence
from dslab.sim.io.tum import write_tum
from dslab.sim.sensors.camera import Intrinsics


@pytest.fixture
def folder(tmp_path) -> Path:
    write_tum(make_sequence(), tmp_path / "seq", depth=True)
    return tmp_path / "seq"


def test_a_written_sequence_is_read_back(folder):
    written, read = make_sequence(), load_sequence(folder)
    assert read.name == "trial"
    assert read.camera == written.camera
    np.testing.assert_allclose(read.stamps_s, written.stamps_s, atol=1e-9)
    for index in range(COUNT):
        np.testing.assert_array_equal(read.frames[index], written.frames[index])
        np.testing.assert_allclose(read.depths[index], written.depths[index], atol=1.01e-4)
    np.testing.assert_allclose(read.T_world_cam, written.T_world_cam, atol=1e-8)
    assert read.segments == written.segments
    assert read.meta["seed"] == 3
    np.testing.assert_allclose(read.frame_truth["blur_px"], written.frame_truth["blur_px"])


def test_the_files_are_the_stated_ones_in_tum_order(folder):
    names = {path.name for path in folder.iterdir()}
    expected = {"rgb", "rgb.txt", "groundtruth.txt", "camera.yaml", "segments.json", "meta.json"}
    assert names == expected | {"depth", "depth.txt", "frame_truth.csv", "orbslam3.yaml"}
    assert list(yaml.safe_load((folder / "camera.yaml").read_text())) == (
        ["fx", "fy", "cx", "cy", "width", "height", "fps", "k1", "k2", "p1", "p2", "k3"]
    )
    pose = make_sequence().T_world_cam[0]
    row = np.array((folder / "groundtruth.txt").read_text().splitlines()[1].split(), float)
    np.testing.assert_allclose(row[1:4], pose[:3, 3], atol=1e-8)
    np.testing.assert_allclose(Rotation.from_quat(row[4:]).as_matrix(), pose[:3, :3], atol=1e-8)
    assert json.loads((folder / "segments.json").read_text())[0]["first_frame"] == 2


def test_a_calibration_from_elsewhere_stands_for_camera_yaml(folder, tmp_path):
    """The data set's own folders have none; the settings say neither size nor rate."""
    (folder / "camera.yaml").unlink()
    settings = tmp_path / "TUM1.yaml"
    settings.write_text("%YAML:1.0\nCamera.fx: 50.5\nCamera.fy: 51\nCamera.cx: 30\nCamera.cy: 20\n")
    read = load_sequence(folder, settings)
    assert read.camera == Intrinsics(64, 48, 50.5, 51, 30, 20, 30.0) and len(read.depths) == COUNT
    with pytest.raises(InputError, match=r"camera\.yaml: no such file; add --camera FILE"):
        load_sequence(folder)


def test_depth_beyond_the_code_is_unknown(tmp_path):
    sequence = make_sequence()
    sequence.depths[0][:] = 20.0
    write_tum(sequence, tmp_path / "seq", depth=True)
    assert (load_sequence(tmp_path / "seq").depths[0] == 0).all()


def test_without_ground_truth_there_is_none(folder):
    (folder / "groundtruth.txt").unlink()
    assert load_sequence(folder).T_world_cam is None


@pytest.mark.filterwarnings("ignore:.*truth covers")
def test_truth_goes_to_frames_within_half_an_interval_and_is_not_interpolated(folder):
    lines = (folder / "groundtruth.txt").read_text().splitlines()
    rows = [line.split() for line in lines[1:]]
    kept = [rows[0], ["0.040", *rows[1][1:]], ["0.090", *rows[3][1:]]]
    (folder / "groundtruth.txt").write_text("\n".join(" ".join(row) for row in kept))
    T = load_sequence(folder).T_world_cam
    known = np.isfinite(T).all(axis=(1, 2))
    np.testing.assert_array_equal(known, [True, True, False, True, False, False])
    np.testing.assert_allclose(T[[1, 3]], make_sequence().T_world_cam[[1, 3]], atol=1e-8)


def test_colour_images_are_converted_to_gray(folder):
    gray = make_sequence().frames[2]
    cv2.imwrite(str(folder / "rgb/000002.png"), cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR))
    read = load_sequence(folder).frames[2]
    assert read.shape == SHAPE and read.dtype == np.uint8
    assert np.abs(read.astype(int) - gray).max() <= 1


def test_an_equidistant_camera_is_read_back(tmp_path):
    lens = Intrinsics(64, 48, 50.0, 51.0, 30.5, 20.25, 30.0, (0.1, -0.2, 0.01, 0.002), "equidistant")
    write_tum(replace(make_sequence(), camera=lens), tmp_path / "seq")
    assert load_sequence(tmp_path / "seq").camera == lens


def test_a_camera_file_may_name_the_model_radtan(folder):
    edit(folder / "camera.yaml", "fps: 30.0\n", "fps: 30.0\nmodel: radtan\n")
    assert load_sequence(folder).camera == make_sequence().camera


@pytest.mark.parametrize("old", ["rgb.txt", "camera.yaml"])
def test_a_missing_file_is_named(folder, old):
    (folder / old).unlink()
    fault(folder, old, "no such file")


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        ("rgb.txt", "0.066666667", "0.02", ["rgb.txt:6: stamp", "does not come after"]),
        ("rgb.txt", " rgb/000005.png", "", ["rgb.txt:9", "cut short"]),
        ("rgb.txt", "rgb/000004.png", "rgb/000044.png", ["rgb/000044.png", "missing"]),
        ("camera.yaml", "fx: 50.0", "fx: -50.0", ["camera.yaml: fx", "absurd"]),
        ("camera.yaml", "fx: 50.0\n", "", ["camera.yaml: fx", "is missing"]),
        ("camera.yaml", "fy: 51.0", "fy: .nan", ["camera.yaml:2: fy", "finite"]),
        ("camera.yaml", "cx: 30.5", "cx: 64", ["camera.yaml: cx", "outside the image", "0 to 63"]),
        ("camera.yaml", "width: 64", "width: 65", ["000000.png", "64x48", "65x48"]),
        ("camera.yaml", "k3: 0.3", "k4: 0.3", ["camera.yaml: k4", "unknown key", "k3"]),
        ("camera.yaml", "fps: 30.0", "model: equidistant", ["camera.yaml: p1", "model equidistant"]),
        ("camera.yaml", "fx: 50.0", "fx: [", ["camera.yaml", "YAML"]),
        ("segments.json", '"first_frame": 2', '"first_frame": 99', ["segments.json: [0]", "99"]),
        ("segments.json", '"kind"', '"sort"', ["segments.json: [0]", "no segment"]),
        ("meta.json", "{", "[", ["meta.json", "JSON"]),
        ("frame_truth.csv", "0,0,", "0,x,", ["frame_truth.csv:2: blur_px", "'x'"]),
    ],
)
def test_each_fault_of_a_file_names_place_and_field(folder, file, old, new, expected):
    edit(folder / file, old, new)
    fault(folder, *expected)


def replace_truth_line(folder: Path, line: str) -> None:
    lines = (folder / "groundtruth.txt").read_text().splitlines()
    lines[3] = line
    (folder / "groundtruth.txt").write_text("\n".join(lines))


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("0.0667 1 2 3 0 0 0", ["groundtruth.txt:4", "7 numbers where 8"]),
        ("0.0667 1 inf 3 0 0 0 1", ["groundtruth.txt:4: ty", "finite"]),
        ("0.0667 1 2 3 0 0 0 0", ["groundtruth.txt:4: qx qy qz qw", "unit quaternion"]),
    ],
)
def test_each_fault_of_the_truth_names_its_line(folder, line, expected):
    replace_truth_line(folder, line)
    fault(folder, *expected)


def test_truth_of_another_clock_is_refused(folder):
    (folder / "groundtruth.txt").write_text("1000 0 0 0 0 0 0 1\n1001 0 0 0 0 0 0 1\n")
    fault(folder, "groundtruth.txt", "clock")


def test_missing_and_empty_folders_are_refused(tmp_path):
    fault(tmp_path / "none", "no such folder")
    fault(tmp_path, "camera.yaml")
    (tmp_path / "file").write_text("")
    fault(tmp_path / "file", "is no folder")


def test_a_folder_cut_short_says_how_much_is_missing(folder):
    for index in (2, 3, 4):
        (folder / f"rgb/{index:06d}.png").unlink()
    fault(folder, "000002.png", "2 more, of 6")
    (folder / "rgb.txt").write_text("# stamp_s filename\n")
    fault(folder, "rgb.txt", "lists no frame")


def test_unreadable_or_other_sized_images_show_when_they_are_read(folder):
    (folder / "rgb/000003.png").write_bytes((folder / "rgb/000003.png").read_bytes()[:200])
    (folder / "rgb/000004.png").write_bytes(b"no image at all")
    cv2.imwrite(str(folder / "rgb/000005.png"), np.zeros((50, 64), np.uint8))
    sequence = load_sequence(folder)
    assert sequence.frames[2].shape == SHAPE
    for index, problem in (
        (3, "is cut short"),
        (4, "no readable image"),
        (5, "64x50 pixels, camera.yaml says 64x48"),
    ):
        with pytest.raises(InputError, match=problem):
            sequence.frames[index]


def test_a_folder_that_is_not_empty_is_never_written_to(folder):
    before = sorted(folder.rglob("*"))
    with pytest.raises(InputError, match="already holds files"):
        write_tum(make_sequence(), folder)
    assert sorted(folder.rglob("*")) == before


def test_an_empty_folder_is_filled_and_a_file_in_the_way_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    write_tum(make_sequence(), tmp_path / "empty")
    assert len(load_sequence(tmp_path / "empty")) == COUNT
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file"):
        write_tum(make_sequence(), tmp_path / "file")


def test_a_place_that_cannot_be_written_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_tum(make_sequence(), tmp_path / "file" / "seq")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_is_an_input_error_and_leaves_nothing(tmp_path, monkeypatch):
    def write_to_full_disk(path: Path, data: bytes) -> int:
        with open("/dev/full", "wb", buffering=0) as disk:
            return disk.write(data)

    monkeypatch.setattr(Path, "write_bytes", write_to_full_disk)
    with pytest.raises(InputError, match="the disk is full"):
        write_tum(make_sequence(), tmp_path / "seq")
    assert list(tmp_path.iterdir()) == []


def test_depth_images_are_given_to_the_frames_nearest_in_time(tmp_path):
    sequence = make_sequence()
    write_tum(sequence, tmp_path / "seq", depth=True)
    written = load_sequence(tmp_path / "seq")
    rows = (tmp_path / "seq/depth.txt").read_text().splitlines()[3:]
    # Another clock's jitter, one image lost, one more between the frames: as a depth camera of its own gives.
    late = [f"{float(row.split()[0]) + 0.004:.6f} {row.split()[1]}" for row in rows if "000002" not in row]
    late.insert(1, f"{0.5 / 30:.6f} depth/000005.png")
    (tmp_path / "seq/depth.txt").write_text("\n".join(late) + "\n")
    read = load_sequence(tmp_path / "seq")
    assert len(read.depths) == len(read) == COUNT
    for index in set(range(COUNT)) - {2}:
        np.testing.assert_array_equal(read.depths[index], written.depths[index])
    assert (read.depths[2] == 0).all()
    (tmp_path / "seq/depth.txt").write_text("99.0 depth/000000.png\n")
    fault(tmp_path / "seq", "depth.txt", "clock")


def test_headers_doubled_lines_spaces_and_a_byte_order_mark_are_read(folder):
    """As spreadsheets and scripts leave them; what is left out is said."""
    written = load_sequence(folder)
    second = written.frames[1]
    frames, truth = folder / "rgb.txt", folder / "groundtruth.txt"
    rows = [line for line in frames.read_text().splitlines() if not line.startswith("#")]
    name = rows[1].split()[1]
    (folder / name).rename(folder / "rgb" / "image of a desk.png")
    rows[1] = f"{rows[1].split()[0]} rgb/image of a desk.png"
    frames.write_text("\ufefftimestamp filename\n" + "\n".join(rows) + "\n", encoding="utf-8")
    poses = [line for line in truth.read_text().splitlines() if not line.startswith("#")]
    truth.write_text("\n".join(["timestamp tx ty tz qx qy qz qw", *poses[:3], poses[2], *poses[3:]]) + "\n")
    with pytest.warns(InputNotice) as said:
        read = load_sequence(folder)
    assert [str(each.message).rpartition("/")[2] for each in said] == [
        "rgb.txt:1: is taken for a header",
        "groundtruth.txt:1: is taken for a header",
        "groundtruth.txt: 1 lines that repeat the one before are left out",
    ]
    np.testing.assert_array_equal(read.T_world_cam, written.T_world_cam)
    np.testing.assert_array_equal(read.frames[1], second)


@pytest.mark.parametrize(("per_s", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds")])
def test_stamps_in_another_unit_than_seconds_are_refused(folder, per_s, unit):
    rows = [
        line.split() for line in (folder / "rgb.txt").read_text().splitlines() if not line.startswith("#")
    ]
    (folder / "rgb.txt").write_text("".join(f"{float(t) * per_s:.3f} {name}\n" for t, name in rows))
    fault(folder, "rgb.txt: stamp", f"these look like {unit}: divide them by {per_s:.0f}")
