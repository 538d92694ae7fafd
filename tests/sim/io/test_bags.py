"""ROS bags: topics, cameras, encodings, times. They are made with rosbags, the extra that reads them."""

import json
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from dslab.experiments.batch.spec import read_batch
from dslab.experiments.runs.identity import sequence_digest
from dslab.scenarios.errors import InputError, InputNotice
from dslab.sim.io.forms import Form, detect_form, load_sequence

COUNT, SHAPE = 4, (48, 64)
START_NS = 1_700_000_000_123_456_789
K = [50.0, 0, 30, 0, 51, 20, 0, 0, 1]
D = [0.1, -0.05, 0.001, 0.002, 0.0]


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("DSLAB_CACHE_DIR", str(tmp_path / "cache"))


def gray(n: int) -> np.ndarray:
    return np.random.default_rng(n).integers(0, 256, SHAPE, dtype=np.uint8)


def encoded(image: np.ndarray, encoding: str) -> np.ndarray:
    """Bytes of an image; those of colour have the gray one in every channel, rows are padded."""
    channels = 3 if encoding in {"rgb8", "bgr8"} else 1
    rows = np.repeat(image, channels, axis=1)
    return np.pad(rows, ((0, 0), (0, 8))).ravel()


def record(path: Path, topics: dict[str, str], infos: tuple[str, ...] = (), stamp=None) -> Path:
    """Write a bag of topics with the encodings of their images, ``jpeg`` for compressed ones."""
    pytest.importorskip("rosbags")
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    one = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if one else Stores.ROS2_HUMBLE)
    packages = {"Time": "builtin_interfaces", "Header": "std_msgs"}
    names = ("Time", "Header", "Image", "CompressedImage", "RegionOfInterest", "CameraInfo")
    of = {name: store.types[f"{packages.get(name, 'sensor_msgs')}/msg/{name}"] for name in names}
    serialize = store.serialize_ros1 if one else store.serialize_cdr
    with rosbag1.Writer(path) if one else rosbag2.Writer(path, version=9) as bag:

        def write(topic: str, kind: str, messages) -> None:
            name = f"sensor_msgs/msg/{kind}"
            connection = bag.add_connection(topic, name, typestore=store)
            for n, message in enumerate(messages):
                bag.write(connection, START_NS + 100_000_000 * n + 5_000_000, serialize(message, name))

        def header(n: int):
            time_ns = START_NS + 100_000_000 * n if stamp is None else stamp
            time = of["Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
            return of["Header"](stamp=time, frame_id="cam", **({"seq": n} if one else {}))

        for topic, encoding in topics.items():
            if encoding == "jpeg":
                packed = [cv2.imencode(".png", gray(n))[1].ravel() for n in range(COUNT)]
                messages = [
                    of["CompressedImage"](header=header(n), format="png", data=data)
                    for n, data in enumerate(packed)
                ]
                write(topic, "CompressedImage", messages)
                continue
            messages = [
                of["Image"](
                    header=header(n), height=SHAPE[0], width=SHAPE[1], encoding=encoding, is_bigendian=0,
                    step=encoded(gray(n), encoding).size // SHAPE[0], data=encoded(gray(n), encoding),
                )
                for n in range(COUNT)
            ]  # fmt: skip
            write(topic, "Image", messages)
        for topic in infos:
            region = of["RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
            values = {"k": K, "d": D, "r": np.eye(3).ravel(), "p": [40, 0, 31, 0, 0, 41, 21, 0, 0, 0, 1, 0]}
            fields = {name.upper() if one else name: np.array(v, float) for name, v in values.items()}
            info = of["CameraInfo"](
                header=header(0), height=SHAPE[0], width=SHAPE[1], distortion_model="plumb_bob",
                binning_x=0, binning_y=0, roi=region, **fields,
            )  # fmt: skip
            write(topic, "CameraInfo", [info])
    return path


def fault(path: Path | str, *expected: str) -> None:
    with pytest.raises(InputError) as caught:
        load_sequence(path)
    line = str(caught.value)
    assert "\n" not in line and all(part in line for part in expected), line


@pytest.mark.parametrize("name", ["walk.bag", "walk"])
@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "jpeg"])
def test_one_topic_needs_no_name(tmp_path, name, encoding):
    """Stamps are those of the headers, to the nanosecond; the camera is beside the images."""
    topic = "/cam0/image_raw" + ("/compressed" if encoding == "jpeg" else "")
    path = record(tmp_path / name, {topic: encoding}, ("/cam0/camera_info",))
    read = load_sequence(path)
    assert read.name == "walk" and (name == "walk.bag" or detect_form(path) is Form.ROS_BAG)
    assert read.camera.focal_px == (50, 51) and read.camera.distortion == tuple(D) and read.camera.fps == 10
    assert read.meta["stamp_origin_ns"] == START_NS
    np.testing.assert_allclose(read.stamps_s, np.arange(COUNT) / 10, atol=1e-12)
    for n in range(COUNT):
        np.testing.assert_allclose(read.frames[n].astype(int), gray(n), atol=1)


@pytest.mark.parametrize("kind", ["rggb", "gbrg"])
def test_bayer_patterns_keep_the_light(tmp_path, kind):
    """Of a pattern whose red is bright, gray is what red weighs."""
    path = record(tmp_path / "walk.bag", {"/image_raw": f"bayer_{kind}8"}, ("/camera_info",))
    from dslab.sim.io import bag

    red = np.zeros(SHAPE, np.uint8)
    red[kind.index("r") // 2 :: 2, kind.index("r") % 2 :: 2] = 200
    message = type("Message", (), {"encoding": f"bayer_{kind}8", "height": 48, "width": 64, "step": 64})
    message.data = red.ravel()
    assert abs(bag._gray(message, "x", SHAPE)[4:-4, 4:-4].mean() - 0.299 * 200) < 2
    assert len(load_sequence(path)) == COUNT


def test_of_several_topics_one_is_named(tmp_path):
    topics = {"/cam0/image_raw": "mono8", "/cam1/image_rect": "mono8"}
    path = record(tmp_path / "walk.bag", topics, ("/cam0/camera_info", "/cam1/camera_info"))
    fault(path, "images of 2 topics (/cam0/image_raw, /cam1/image_rect)", "walk.bag:/cam0/image_raw")
    fault(f"{path}:/cam2", "/cam2: is no topic of images", "/cam1/image_rect")
    read = load_sequence(f"{path}:/cam1/image_rect")
    assert read.camera.focal_px == (40, 41) and read.camera.is_pinhole
    assert load_sequence(f"{path}:/cam0/image_raw").camera.focal_px == (50, 51)


def test_a_bag_without_a_camera_takes_one(tmp_path):
    path = record(tmp_path / "walk.bag", {"/cam0/image_raw": "mono8"})
    fault(path, "has no calibrated /cam0/camera_info beside it", "--camera FILE")
    camera = tmp_path / "cam.yaml"
    camera.write_text("fx: 60\nfy: 60\ncx: 30\ncy: 20\nwidth: 64\nheight: 48\nfps: 30\n")
    read = load_sequence(path, camera)
    assert read.camera.fx == 60 and read.camera.fps == 10


def test_headers_without_times_are_said(tmp_path):
    path = record(tmp_path / "walk.bag", {"/image_raw": "mono8"}, ("/camera_info",), stamp=0)
    with pytest.warns(InputNotice, match="times of its headers do not increase: those of receipt count"):
        assert load_sequence(path).meta["stamp_origin_ns"] == START_NS + 5_000_000


def test_bad_bags_are_one_line(tmp_path):
    path = record(tmp_path / "walk.bag", {"/image_raw": "32FC1"}, ("/camera_info",))
    fault(path, "image 0: has the encoding '32FC1'", "republish it as one of mono8")
    path.write_bytes(path.read_bytes()[:2000])
    fault(path, "walk.bag: cannot be read as a bag", "reindex")
    fault(record(tmp_path / "none.bag", {}, ("/camera_info",)), "holds no topic of images")
    made = record(tmp_path / "two", {"/image_raw": "mono8"}, ("/camera_info",))
    (made / "metadata.yaml").write_text("rosbag2_bagfile_information: 3\n")
    fault(made, "two: cannot be read as a bag")


@pytest.mark.slow
def test_the_commands_take_bags(tmp_path, dslab):
    path = record(tmp_path / "walk.bag", {"/cam0/image_raw": "mono8", "/b": "mono8"}, ("/cam0/camera_info",))
    source = f"{path}:/cam0/image_raw"
    code, _, err = dslab("export", source, "--format", "euroc", "--out", tmp_path / "out")
    assert code == 0, err
    assert load_sequence(tmp_path / "out").meta["stamp_origin_ns"] == START_NS
    dark = "covered_lens:start_s=0.1,duration_s=0.2,transmission=0"
    code, _, err = dslab("degrade", source, "--segment", dark, "--out", tmp_path / "dark")
    assert code == 0, err
    code, _, err = dslab("run", path, "--out", tmp_path / "run")
    assert code == 2 and err.count("\n") == 1 and "images of 2 topics" in err


def test_without_the_package_the_remedy_is_one_line(tmp_path, monkeypatch):
    (tmp_path / "walk.bag").write_bytes(b"#ROSBAG V2.0\n")
    for name in ("rosbags", "rosbags.highlevel"):
        monkeypatch.setitem(sys.modules, name, None)
    fault(tmp_path / "walk.bag", "rosbags, which reads bags, is not installed", "dual-slam-lab[rosbag]")


def test_topics_of_bags_are_sequences_of_a_batch(tmp_path):
    """A copy is the same sequence, another topic is not."""
    topics = {"/cam0/image_raw": "mono8", "/cam1/image_raw": "bayer_rggb8"}
    path = record(tmp_path / "walk.bag", topics, ("/cam0/camera_info", "/cam1/camera_info"))
    copy = shutil.copy(path, tmp_path / "copy.bag")
    named = [f"{path}:/cam0/image_raw", f"{path}:/cam1/image_raw", f"{copy}:/cam0/image_raw"]
    spec = tmp_path / "batch.yaml"
    spec.write_text(f"sequences: {json.dumps(named)}\nsystems: [base]\n")
    _, sources = read_batch(spec)
    digests = [sequence_digest(source) for source in sources]
    assert sources == named and digests[0] == digests[2] != digests[1]
