"""Sequence folders with files of other types, sizes and order: one line each, never a guess."""

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from io_sequences import COUNT, PINHOLE, edit, fault, make_sequence
from test_image_files import png_of_size
from test_io_tum_mono import folder as mono  # noqa: F401

from dslab.sim.io.forms import Form, load_sequence, write_sequence
from dslab.sim.sensors.camera import LEAST_SIDE_PX
from dslab.sim.sequence import SegmentTruth
from dslab.slam.features._orb_kernels import BORDER_PX

SENSOR, TRUTH = "mav0/cam0/sensor.yaml", "mav0/state_groundtruth_estimate0/data.csv"
HUGE = "9" * 401


@pytest.fixture
def folder_of(tmp_path):
    """A function that writes the sequence in a form and gives its folder."""

    def write(form: Form) -> Path:
        sequence = make_sequence()
        if form is Form.KITTI:
            sequence = replace(sequence, camera=PINHOLE)
        write_sequence(sequence, tmp_path / form, form, depth=form is Form.TUM)
        return tmp_path / form

    return write


# -- regular files -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        "rgb.txt",
        "camera.yaml",
        "groundtruth.txt",
        "depth.txt",
        "segments.json",
        "meta.json",
        "frame_truth.csv",
    ],
)
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "broken link"])
def test_every_file_of_a_folder_must_be_a_regular_one(folder_of, name, kind):
    folder = folder_of(Form.TUM)
    (folder / name).unlink()
    if kind == "pipe":
        os.mkfifo(folder / name)
    elif kind == "folder":
        (folder / name).mkdir()
    else:
        (folder / name).symlink_to("/dev/zero" if kind == "device" else folder / "none")
    fault(folder, name, "no such file" if kind == "broken link" else f"is a {kind}")


def test_images_must_be_regular_files(folder_of):
    folder = folder_of(Form.TUM)
    (folder / "rgb/000003.png").unlink()
    os.mkfifo(folder / "rgb/000003.png")
    fault(folder, "000003.png", "is missing or empty")
    for name in ("a" * 300, "a\0b", "../" * 2000):
        edit(folder / "rgb.txt", (folder / "rgb.txt").read_text().split()[-1], name)
        fault(folder, "is missing or empty")


@pytest.mark.parametrize("name", ["a" * 300, "a/" * 3000, "a\0b"])
def test_an_impossible_name_is_no_folder(name):
    fault(Path(name), "no such folder")


# -- the camera ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("fx: 50.0\n", "fx: 50.0\nfx: 60.0\n", ["camera.yaml:2: fx", "key appears twice"]),
        ("fx: 50.0", f"fx: {HUGE}", ["camera.yaml:1: fx", "more than 64 bits"]),
        ("fx: 50.0", "fx: 1e400", ["camera.yaml: fx", "is not a finite number"]),
        ("fx: 50.0", "fx: &a [*a]", ["camera.yaml:1", "stands for a part of itself"]),
        ("fx: 50.0", "fx: " + "[" * 400 + "]" * 400, ["camera.yaml:1", "nested more than 40 deep"]),
        ("fps: 30.0\n", "fps: 30.0\nmodel: [radtan]\n", ["camera.yaml: model", "no lens model"]),
        ("fps: 30.0\n", "fps: 30.0\nmodel: {a: 1}\n", ["camera.yaml: model", "no lens model"]),
        ("k1: 0.1", "k1: -9.0", ["camera.yaml: distortion", "folds the image over itself"]),
        ("fps: 30.0", "fps: 1.0e-300", ["camera.yaml: fps", "1e-300 is no frame rate"]),
        ("width: 64", "width: 36", ["camera.yaml: width", "takes no image of 36 pixels", "37 to 16384"]),
        ("height: 48", "height: 1e9", ["camera.yaml: height", "takes no image of 1000000000 pixels"]),
        ("width: 64", "width: 64.5", ["camera.yaml: width", "64.5 is no image size"]),
    ],
)
def test_each_fault_of_a_camera_file_is_one_line(folder_of, old, new, expected):
    folder = folder_of(Form.TUM)
    edit(folder / "camera.yaml", old, new)
    fault(folder, *expected)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "distortion_model: radial-tangential",
            "distortion_model: [radtan]",
            ["distortion_model", "is no name"],
        ),
        ("distortion_model:", "distortion_modle:", ["distortion_model", "is missing"]),
        ("rate_hz:", "rate_hz: 3\nrate_hz:", ["sensor.yaml", "rate_hz", "key appears twice"]),
        ("- 64\n", "- 36\n", ["sensor.yaml: width", "takes no image of 36 pixels"]),
        ("- 0.1\n", "- -9\n", ["sensor.yaml: distortion", "folds the image over itself"]),
    ],
)
def test_each_fault_of_a_sensor_file_is_one_line(folder_of, old, new, expected):
    folder = folder_of(Form.EUROC)
    edit(folder / SENSOR, old, new)
    fault(folder, *expected)


def test_the_least_image_is_what_the_features_need():
    assert LEAST_SIDE_PX == 2 * BORDER_PX + 1


# -- order ---------------------------------------------------------------------------------------------------


def test_kitti_s_images_are_read_by_number(folder_of):
    folder = folder_of(Form.KITTI)
    for number in range(COUNT):
        # Sorted as text, 10 comes before 9.
        (folder / f"image_0/{number:06d}.png").rename(folder / f"image_0/{number + 8}.png")
    frames = load_sequence(folder).frames
    for number in range(COUNT):
        assert (frames[number] == make_sequence().frames[number]).all()
    (folder / "image_0/09.png").write_bytes((folder / "image_0/8.png").read_bytes())
    fault(folder, "image_0: 9.png", "number 9 occurs twice")


def test_tum_mono_s_images_and_times_are_numbered_alike(mono):  # noqa: F811
    edit(mono / "times.txt", "00002", "00003")
    fault(mono, "times.txt:3: id", "00003 stands where 2 belongs")
    edit(mono / "times.txt", "00003", "x")
    fault(mono, "times.txt:3: id", "'x' is no number of a frame")
    edit(mono / "times.txt", "x", "00002")
    (mono / "images/00002.png").rename(mono / "images/00007.png")
    fault(mono, "00003.png", "image 2 is missing")


def test_a_large_image_in_a_kitti_folder_is_not_decoded(folder_of):
    folder = folder_of(Form.KITTI)
    (folder / "image_0/000000.png").write_bytes(png_of_size(30000, 30000))
    fault(folder, "000000.png: width", "takes no image of 30000 pixels")


def test_a_projection_given_twice_is_refused(folder_of):
    folder = folder_of(Form.KITTI)
    (folder / "calib.txt").write_text((folder / "calib.txt").read_text() * 2)
    fault(folder, "calib.txt:2: P0", "appears twice")


# -- truth ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("form", "file", "column", "value", "expected"),
    [
        (Form.TUM, "groundtruth.txt", 1, "1e308", ":3: position: 1e+308 is no coordinate in metres"),
        (Form.TUM, "groundtruth.txt", 5, "1e308", ":3: qx qy qz qw: has length 1e+308"),
        (Form.TUM, "groundtruth.txt", 0, "1e300", ":3: stamp: 1e300 is no time in seconds"),
        (Form.TUM, "groundtruth.txt", 2, "1_0", ":3: ty: '1_0' is not a finite number"),
        (Form.TUM, "groundtruth.txt", 2, "٣", ":3: ty: '٣' is not a finite number"),
        (Form.TUM, "rgb.txt", 0, "1e18", ":5: stamp: 1e18 is no time in seconds"),
        (Form.KITTI, "poses/00.txt", 3, "-1e308", ":3: position: -1e+308 is no coordinate in metres"),
        (Form.KITTI, "poses/00.txt", 4, "1e308", ":3: is no rotation and translation"),
    ],
)
def test_times_and_positions_are_those_of_a_recording(folder_of, form, file, column, value, expected):
    folder = folder_of(form)
    lines = (folder / file).read_text().splitlines()
    at = 2 if file != "rgb.txt" else 4
    words = lines[at].split()
    words[column] = value
    (folder / file).write_text("\n".join([*lines[:at], " ".join(words), *lines[at + 1 :]]))
    fault(folder, f"{file}{expected}")


def test_positions_of_the_euroc_form_are_bounded(folder_of):
    folder = folder_of(Form.EUROC)
    line = (folder / TRUTH).read_text().splitlines()[2]
    words = line.split(",")
    edit(folder / TRUTH, line, ",".join([words[0], "1e308", *words[2:]]))
    fault(folder, "data.csv:3: position", "no coordinate")


def test_a_pose_outside_motion_capture_has_no_other_words(mono):  # noqa: F811
    (mono / "groundtruthSync.txt").write_text("0.00 1 2 3 0 0 0 1\n0.05 nan x nan nan nan nan nan\n")
    fault(mono, "groundtruthSync.txt:2: ty", "'x' is not a finite number")


def test_exposures_are_not_negative(folder_of, mono):  # noqa: F811
    edit(mono / "times.txt", "5.5", "-5.5")
    fault(mono, "times.txt:1: exposure_ms", "-0.0055 s is no shutter time")
    folder = folder_of(Form.TUM)
    edit(folder / "frame_truth.csv", "0.004", "-0.004")
    fault(folder, "frame_truth.csv:2: exposure_s", "-0.004 s is no shutter time")


# -- sidecars ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("1,0,", "2,0,", "frame_truth.csv:3: frame: 2 stands where 1 belongs"),
        ("frame,blur_px,exposure_s", "frame,blur_px,blur_px", "frame_truth.csv:1: is no header"),
        ("frame,blur_px,exposure_s", "blur_px,frame,exposure_s", "frame_truth.csv:1: is no header"),
        ("0,0,0.004", "0,0", "frame_truth.csv:2: 2 numbers where 3 belong"),
        ("0,0,0.004\n", "", "frame_truth.csv: has 5 rows for 6 frames"),
        ("0,0,0.004", '0,"\0,0.004', "frame_truth.csv:2: blur_px"),
        ("0,0,0.004", f"0,{'0' * 200_000},0.004", "frame_truth.csv:2: is too long for a table"),
    ],
    ids=range(7),
)
def test_each_fault_of_the_truth_per_frame_is_one_line(folder_of, old, new, expected):
    folder = folder_of(Form.TUM)
    edit(folder / "frame_truth.csv", old, new)
    fault(folder, expected)


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("kind", [1], "kind is not valid"),
        ("kind", "", "kind is not valid"),
        ("severity", None, "severity is not valid"),
        ("severity", [["exposure_s", 1]], "severity is not valid"),
        ("start_s", "0", "start_s is not valid"),
        ("end_s", -1, "end_s is not valid"),
        ("first_frame", True, "first_frame or last_frame is not valid"),
        ("first_frame", 2.0, "first_frame or last_frame is not valid"),
        ("first_frame", -1, "frames -1 to 3 are not in the sequence"),
        ("last_frame", COUNT, "frames 2 to 6 are not in the sequence"),
        ("measure", 3, "measure is not valid"),
        ("threshold", None, "threshold is not valid"),
        ("runs", [[-100, 10000]], "runs do not go from 2 to 3"),
        ("runs", [[3, 3], [2, 2]], "runs do not go from 2 to 3"),
        ("runs", [[2, 3, 4]], "runs is not valid"),
        ("runs", [["2", "3"]], "runs is not valid"),
        ("runs", [2, 3], "not iterable"),
        ("runs", None, "not iterable"),
        ("sort", 1, "unexpected keyword argument 'sort'"),
    ],
)
def test_each_field_of_a_segment_has_its_type_and_lies_in_the_sequence(folder_of, field, value, expected):
    folder = folder_of(Form.TUM)
    record = json.loads((folder / "segments.json").read_text())[0]
    (folder / "segments.json").write_text(json.dumps([record, {**record, field: value}]))
    fault(folder, "segments.json: [1]", "is no segment of this sequence", expected)


@pytest.mark.parametrize("record", [None, [], "x", {}])
def test_a_record_that_is_no_segment_is_a_value_error(record):
    with pytest.raises(ValueError):
        SegmentTruth.from_record(record, 10)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ('{"seed": "3"}', "meta.json: seed: '3' is no whole number"),
        ('{"seed": [3]}', "meta.json: seed"),
        ('{"seed": 3.5}', "meta.json: seed"),
        ('{"seed": true}', "meta.json: seed"),
        ('{"seed": -1}', "meta.json: seed"),
        ('{"seed": null}', "meta.json: seed"),
        (f'{{"seed": {HUGE}}}', "meta.json: is no valid JSON"),
        ('{"seed": 1, "seed": 2}', "key 'seed' appears twice"),
        ('{"stamp_origin_ns": "x"}', "meta.json: stamp_origin_ns"),
        ('{"name": {"a": 1}}', "meta.json: name"),
        ('["name"]', "meta.json: holds no object"),
        ('{"a": ' + "[" * 5000, "levels deep"),
    ],
    ids=range(12),
)  # fmt: skip
def test_each_fault_of_the_provenance_is_one_line(folder_of, content, expected):
    folder = folder_of(Form.TUM)
    (folder / "meta.json").write_text(content)
    fault(folder, expected)


def test_a_table_of_pixels_is_no_table(folder_of):
    folder = folder_of(Form.TUM)
    (folder / "groundtruth.txt").write_text("0 " * 60_000)
    fault(folder, "groundtruth.txt:1: is too long for a table")
