"""ROS 1 and ROS 2 bags: the images of one topic, decoded once into the cache.

    walk.bag, walk.mcap, walk.db3     a bag in one file
    walk/metadata.yaml                a bag of ROS 2, beside its .db3 or .mcap
    walk.bag:/cam0/image_raw          one of several topics

The camera is that of ``camera_info`` beside the images, for ``image_rect`` that of its projection. Times are
those of the headers. The package ``rosbags`` reads the files; it is the optional extra ``rosbag``.
Source: sensor_msgs Image, CompressedImage, CameraInfo; REP 104.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dslab.scenarios.errors import InputError, notice
from dslab.scenarios.input_files import file_digest, file_names, is_folder, is_given, open_file
from dslab.sim.io.calibration import Fields
from dslab.sim.io.calibrations import camera_info, split_name
from dslab.sim.io.camera_file import intrinsics_of, other_size, read_camera
from dslab.sim.io.clock import ORIGIN_KEY, choose_origin_ns, to_seconds
from dslab.sim.io.decoding import decoded_once
from dslab.sim.io.folders import Progress
from dslab.sim.io.image_header import header_size
from dslab.sim.io.images import decoded_gray
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import Sequence

SUFFIXES = (".bag", ".mcap", ".db3")
"""Of the names of bags."""
_METADATA = "metadata.yaml"
_RAW, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
# Channels, and OpenCV's name of the conversion to gray.
_ENCODINGS: dict[str, tuple[int, str]] = {
    **dict.fromkeys(("mono8", "8UC1"), (1, "")),
    "rgb8": (3, "RGB2GRAY"),
    **dict.fromkeys(("bgr8", "8UC3"), (3, "BGR2GRAY")),
    "rgba8": (4, "RGBA2GRAY"),
    "bgra8": (4, "BGRA2GRAY"),
    **{f"bayer_{kind.lower()}8": (1, f"Bayer{kind}2GRAY") for kind in ("RGGB", "BGGR", "GBRG", "GRBG")},
}


def is_bag(path: str | Path) -> bool:
    """Return True for a bag, also with the name of a topic."""
    file, _ = split_name(path)
    if is_folder(file):
        return is_given(file / _METADATA) and any(
            end in name for name in file_names(file) for end in SUFFIXES[1:]
        )
    return str(file).lower().endswith(SUFFIXES)


def load_bag(
    path: Path,
    camera_file: Path | None = None,
    cache_dir: Path | None = None,
    progress: Progress | None = None,
    force: bool = False,
) -> Sequence:
    """Read the images of a topic, gray, with the times of their headers.

    Args:
        path: the bag, with ``:TOPIC`` where it has images of several.
        camera_file: of the camera that is to count; None for the bag's own.
        cache_dir, progress, force: as of ``sim.io.video.load_video``.

    Raises:
        InputError: the bag cannot be read, holds no images or those of several topics, an image is of another
            encoding or size, the camera is not known, ``rosbags`` is not installed.
    """
    file, named = split_name(path)
    with _opened(file) as bag:
        topic, connections = _chosen(file, named, bag)
        messages = partial(_messages, file, bag, connections)
        first = next((message for _, message in messages()), None)
        if first is None:
            raise InputError(f"{file}: {topic}", "holds no image", "name another topic")
        size_px = _size(first, f"{file}: {topic}")
        size = size_px[::-1]
        content = {"bag": _digests(file), "topic": topic, "size": size}
        stamps, frames = decoded_once(
            file,
            content,
            size,
            partial(_stamps, f"{file}: {topic}", messages),
            lambda count: (
                _gray(m, f"{file}: {topic}: image {n}", size) for n, (_, m) in enumerate(messages())
            ),
            cache_dir,
            progress,
            force,
        )
        rate = round(1e9 / float(np.median(np.diff(stamps))), 4) if len(stamps) > 1 else None
        camera = (
            _camera(file, bag, topic, size_px, rate)
            if camera_file is None
            else read_camera(camera_file, size_px, rate)
        )
    if camera.size_px != size_px:
        raise other_size(f"{file}: {topic}", size_px, camera.size_px[::-1], str(camera_file or file))
    origin = choose_origin_ns(stamps.tolist())
    return Sequence(
        name=file.resolve().stem,
        camera=camera if rate is None else replace(camera, fps=rate),
        stamps_s=to_seconds(stamps.tolist(), origin),
        frames=frames,
        T_world_cam=None,
        depths=None,
        segments=(),
        meta={ORIGIN_KEY: origin} if origin else {},
    )


@contextmanager
def _opened(file: Path) -> Iterator[Any]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        remedy = "pip install 'dual-slam-lab[rosbag]', or give its images as a folder"
        raise InputError(
            str(file), "the package rosbags, which reads bags, is not installed", remedy
        ) from None
    if not is_folder(file):
        open_file(file).close()
    try:
        bag = AnyReader([file], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        bag.open()
    except Exception as error:
        raise _unreadable(file, error) from None
    try:
        yield bag
    finally:
        bag.close()


def _messages(file: Path, bag: Any, connections: list[Any]) -> Iterator[tuple[int, Any]]:
    """Time of receipt, nanoseconds, and content of the messages."""
    try:
        for connection, received_ns, data in bag.messages(connections):
            yield received_ns, bag.deserialize(data, connection.msgtype)
    except Exception as error:
        raise _unreadable(file, error) from None


def _unreadable(file: Path, error: Exception) -> InputError:
    # A damaged bag can raise anything: of the reader, of its decompressors, of SQLite.
    problem = f"cannot be read as a bag ({type(error).__name__}: {' '.join(str(error).split())[:200]})"
    return InputError(
        str(file), problem, "copy it again, or mend it with `rosbag reindex` or `ros2 bag reindex`"
    )


def _chosen(file: Path, named: str, bag: Any) -> tuple[str, list[Any]]:
    """The topic of images, and its connections."""
    topics: dict[str, list[Any]] = {}
    for connection in bag.connections:
        if connection.msgtype in (_RAW, _COMPRESSED) and not connection.topic.endswith("/compressedDepth"):
            topics.setdefault(connection.topic, []).append(connection)
    shown = ", ".join(sorted(topics)) or "none"
    if named and named not in topics:
        raise InputError(f"{file}: {named}", "is no topic of images", f"it has {shown}")
    if not topics:
        raise InputError(str(file), "holds no topic of images", "give a bag with sensor_msgs images")
    if not named and len(topics) > 1:
        remedy = f"name one: {file}:{min(topics)}"
        raise InputError(str(file), f"holds images of {len(topics)} topics ({shown})", remedy)
    topic = named or next(iter(topics))
    return topic, topics[topic]


def _size(message: Any, where: str) -> tuple[int, int]:
    """Width and height."""
    size = header_size(bytes(message.data)) if hasattr(message, "format") else (message.width, message.height)
    if size is None or not all(size):
        raise InputError(where, "is no readable image", "name another topic")
    return size


def _stamps(where: str, messages: Any) -> np.ndarray:
    """(N,) int64 nanoseconds of the headers, or of receipt where those do not increase."""
    pairs = [(m.header.stamp.sec * 10**9 + m.header.stamp.nanosec, received) for received, m in messages()]
    stamps, received = np.array(pairs, np.int64).T
    if (np.diff(stamps) > 0).all() and stamps[0] >= 0 and stamps[-1] > 0:
        return stamps
    if not (np.diff(received) > 0).all():
        raise InputError(
            where, "has neither times of headers nor of receipt that increase", "record it again"
        )
    notice(where, "the times of its headers do not increase: those of receipt count")
    return received


def _gray(message: Any, where: str, size: tuple[int, int]) -> np.ndarray:
    """(H, W) uint8 of a message."""
    if hasattr(message, "format"):
        return decoded_gray(bytes(message.data), where, size)
    if (message.height, message.width) != size:
        raise other_size(where, (message.width, message.height), size, "the first image")
    if message.encoding not in _ENCODINGS:
        problem = f"has the encoding {message.encoding!r}, which is not read"
        raise InputError(where, problem, f"republish it as one of {', '.join(_ENCODINGS)}")
    channels, conversion = _ENCODINGS[message.encoding]
    height, width = size
    if message.step < width * channels or len(message.data) < message.step * height:
        raise InputError(where, "is cut short", "copy the bag again")
    rows = np.asarray(message.data)[: message.step * height].reshape(height, message.step)
    pixels = np.ascontiguousarray(rows[:, : width * channels])
    pixels = pixels.reshape(height, width, channels) if channels > 1 else pixels
    return cv2.cvtColor(pixels, getattr(cv2, f"COLOR_{conversion}")) if conversion else pixels


def _camera(file: Path, bag: Any, topic: str, size_px: tuple[int, int], fps: float | None) -> Intrinsics:
    """The camera of the camera_info beside a topic."""
    parts = topic.split("/")
    images = parts[-2:] if parts[-1] == "compressed" else parts[-1:]
    beside = "/".join([*parts[: -len(images)], "camera_info"])
    found = [c for c in bag.connections if c.topic == beside]
    message = next((m for _, m in _messages(file, bag, found)), None) if found else None
    fields = (
        {}
        if message is None
        else {name.lower(): getattr(message, name) for name in message.__dataclass_fields__}
    )
    if message is None or not np.any(fields["k"]):
        raise InputError(f"{file}: {topic}", f"has no calibrated {beside} beside it", "add --camera FILE")
    lens = {
        "distortion_model": fields["distortion_model"] or "plumb_bob",
        "d": np.asarray(fields["d"]).tolist(),
    }
    matrix = np.reshape(fields["k"], (3, 3))
    if "rect" in images[0]:
        matrix, lens = np.reshape(fields["p"], (3, 4))[:, :3], {"d": []}
    size = {"width": fields["width"], "height": fields["height"]}
    where = f"{file}: {beside}"
    return intrinsics_of(
        camera_info(Fields(where, {"k": matrix.ravel().tolist(), **lens, **size})), Path(where), size_px, fps
    )


def _digests(file: Path) -> list[str]:
    """Of the content of a file, or of those in a folder."""
    paths = [file / name for name in file_names(file)] if is_folder(file) else [file]
    return [file_digest(path).hex() for path in paths if not is_folder(path)]
