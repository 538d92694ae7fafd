"""KITTI's odometry form: writer and reader of rectified images, one pose per frame.

    image_0/000000.png ...   gray images, or colour ones in image_2, PNG or JPEG
    times.txt                stamp of each frame, seconds; without it ten frames a second
    calib.txt                P0: the 12 numbers of the left gray camera's projection matrix; P2 of image_2
    poses/NN.txt             12 numbers per frame, the rows of the camera-to-world matrix

The poses may also be at their place in the data set, ``../../poses/NN.txt`` with NN the folder's name, or
``NN.txt`` or ``poses.txt`` in the folder. Image size and frame rate are those of the images and times.
A synchronised raw drive has ``image_00/data`` and ``image_00/timestamps.txt``, or of another camera, and
``calib_cam_to_cam.txt`` in it or in the folder of its day.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError, notice
from dslab.scenarios.input_files import file_names, is_folder, is_given
from dslab.sim.io.calibration_tables import KITTI_FPS, kitti_projection
from dslab.sim.io.camera_file import check_camera, intrinsics_of, other_size
from dslab.sim.io.clock import held_stamps, written_seconds
from dslab.sim.io.folders import Progress, new_directory, write_images
from dslab.sim.io.images import GrayFolder, image_shape, names_in, numbered_images
from dslab.sim.io.sidecars import read_sidecars, write_sidecars
from dslab.sim.io.text import (
    check_frames,
    check_order,
    check_present,
    check_words,
    read_rows,
    stamped_numbers,
    to_decimal,
    to_numbers,
)
from dslab.sim.io.truth import check_rigid
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import InColour, Sequence

IMAGES_DIR, TIMES_FILE, CALIBRATION_FILE, POSES_DIR = "image_0", "times.txt", "calib.txt", "poses"
IMAGES_DIRS = {"image_0": "P0", "image_2": "P2", "image_1": "P1", "image_3": "P3"}
"""Folders of images, the preferred first, and the projection of each."""
RAW_DIRS = {f"image_{n:02d}": f"P_rect_{n:02d}" for n in (0, 2, 1, 3)}
"""The same of raw drives."""
_RAW_CALIBRATION, _RAW_TIMES = "calib_cam_to_cam.txt", "timestamps.txt"
_POSE_NAMES = [f"r{row}{column}" for row in range(3) for column in range(4)]
_POSES_NAME = re.compile(r"[0-9][0-9]\.txt|poses\.txt")


def write_kitti(sequence: Sequence, directory: Path, progress: Progress | None = None) -> None:
    """Write a sequence in KITTI's odometry form; the poses go to ``poses/00.txt``.

    The poses stay in the sequence's world frame; they do not start at the identity. Arguments and errors as
    of ``write_sequence``: the form holds no distortion, and a pose for each frame.
    """
    if not sequence.camera.is_pinhole:
        raise InputError(
            sequence.name,
            "has lens distortion, KITTI's form is for rectified images",
            "add --rectify (dslab export), or use tum or euroc",
        )
    poses = sequence.T_world_cam
    if poses is not None and not np.isfinite(poses).all():
        lacking = int(np.flatnonzero(~np.isfinite(poses).all(axis=(1, 2)))[0])
        raise InputError(
            sequence.name, f"frame {lacking} has no pose, KITTI's form needs one for each", "use tum or euroc"
        )
    camera, stamps = sequence.camera, written_seconds(sequence)
    # The rate of the form is that of the stamps.
    check_camera(Path(sequence.name), replace(camera, fps=_rate(np.array(stamps, float))))
    projection = np.column_stack([camera.K, np.zeros(3)])
    name = "image_2" if isinstance(sequence.frames, InColour) and sequence.frames.is_coloured else IMAGES_DIR
    with new_directory(directory) as folder:
        (folder / name).mkdir()
        paths = [folder / name / f"{frame:06d}.png" for frame in range(len(sequence))]
        write_images(sequence.frames, paths, "writing", progress)
        (folder / TIMES_FILE).write_text("".join(f"{stamp}\n" for stamp in stamps))
        # Shortest decimals that give the same numbers.
        numbers = " ".join(repr(float(v)) for v in projection.flat)
        (folder / CALIBRATION_FILE).write_text(f"{IMAGES_DIRS[name]}: {numbers}\n")
        if poses is not None:
            (folder / POSES_DIR).mkdir()
            rows = (" ".join(f"{v:.9e}" for v in pose[:3].flat) for pose in poses)
            (folder / POSES_DIR / "00.txt").write_text("\n".join(rows) + "\n")
        write_sidecars(sequence, folder)


def load_kitti(folder: Path) -> Sequence:
    """Read a folder in KITTI's odometry form or a raw drive. Errors as of ``load_sequence``."""
    images = _images(folder)
    raw = _images_dir(folder).name == "data"
    times = _images_dir(folder).parent / _RAW_TIMES if raw else folder / TIMES_FILE
    stamps_ns = None
    if is_given(times) and raw:
        stamps_s = _read_raw_times(times)
    elif is_given(times):
        stamps_s, stamps_ns = _read_times(times)
    else:
        stamps_s = np.arange(len(images)) / KITTI_FPS
        notice(str(folder), f"has no {times.name}: frames count as taken {KITTI_FPS:g} times a second")
    if len(images) != len(stamps_s):
        problem = f"holds {len(images)} images, {times.name} {len(stamps_s)} stamps"
        raise InputError(
            str(_images_dir(folder)), problem, "copy the folder again, or cut it to the same frames"
        )
    check_present(images, times.name)
    shape = image_shape(images[0])
    return Sequence(
        camera=_read_calibration(folder, raw, shape, _rate(stamps_s)),
        stamps_s=stamps_s,
        frames=GrayFolder(images, shape, f"{images[0].parent.name}/{images[0].name}"),
        T_world_cam=_read_poses(folder, images),
        depths=None,
        image_names=names_in(folder, images),
        stamps_ns=stamps_ns,
        **read_sidecars(folder, len(stamps_s)),
    )


def _rate(stamps_s: np.ndarray) -> float:
    """Frames per second, as the stamps tell."""
    # Stamps are printed to a nanosecond: further digits of the rate are rounding errors.
    return round(1 / float(np.median(np.diff(stamps_s))), 4) if len(stamps_s) > 1 else KITTI_FPS


def _images_dir(folder: Path) -> Path:
    found = [folder / name for name in IMAGES_DIRS if is_folder(folder / name)]
    found += [folder / name / "data" for name in RAW_DIRS if is_folder(folder / name / "data")]
    return found[0] if found else folder / IMAGES_DIR


def _images(folder: Path) -> list[Path]:
    """The images in the order of their numbers. Raises InputError without one, or as ``by_number``."""
    images = numbered_images(_images_dir(folder), (".png", ".jpg", ".jpeg"))
    if not images:
        raise InputError(str(_images_dir(folder)), "holds no image", "give images by number, PNG or JPEG")
    return images


def _read_times(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    rows = read_rows(path, "give a folder with one stamp per line and frame")
    stamps, _ = stamped_numbers(rows, ["stamp"], to_decimal)
    check_frames(path, stamps)
    return held_stamps(path, stamps)


def _read_raw_times(path: Path) -> np.ndarray:
    """(N,) seconds since the first of lines such as ``2011-09-26 13:02:25.964389445``."""
    stamps = []
    for where, words in read_rows(path, ""):
        try:
            stamps.append(np.datetime64("T".join(words)).astype("datetime64[ns]").astype(np.int64))
        except ValueError:
            remedy = "write 2011-09-26 13:02:25.964389445"
            raise InputError(f"{where}: timestamp", f"{' '.join(words)!r} is no time", remedy) from None
        check_order(where, stamps[-2:-1], stamps[-1])
    check_frames(path, stamps)
    return (np.array(stamps) - stamps[0]) / 1e9


def _read_calibration(folder: Path, raw: bool, shape: tuple[int, int], fps: float) -> Intrinsics:
    directory = _images_dir(folder)
    if raw:
        key = RAW_DIRS[directory.parent.name]
        path = folder / _RAW_CALIBRATION
        path = path if is_given(path) else folder.resolve().parent / _RAW_CALIBRATION
    else:
        key, path = IMAGES_DIRS[directory.name], folder / CALIBRATION_FILE
    found = replace(kitti_projection(path, key), fps=fps)
    # A raw drive whose images are not rectified has others than its projection is for.
    if found.size_px and found.size_px != shape[::-1]:
        raise other_size(str(directory), shape[::-1], found.size_px[::-1], str(path))
    return intrinsics_of(found, path, shape[::-1])


def _poses_file(folder: Path) -> Path | None:
    """The file of the poses, or None."""
    name = folder.resolve().name
    official = folder.resolve().parent.parent / POSES_DIR / f"{name}.txt"
    homes = [place for place in (folder / POSES_DIR, folder) if is_folder(place)]
    own = [place / file for place in homes for file in file_names(place) if _POSES_NAME.fullmatch(file)]
    if len(own) > 1:
        listed = ", ".join(sorted(path.name for path in own))
        raise InputError(str(folder), f"has several files of poses ({listed})", "keep the right one")
    return own[0] if own else official if is_given(official) else None


def _read_poses(folder: Path, images: list[Path]) -> np.ndarray | None:
    path = _poses_file(folder)
    return None if path is None else read_kitti_poses(path, len(images), int(images[-1].stem))


def read_kitti_poses(path: Path, frames: int, last: int) -> np.ndarray:
    """(N, 4, 4) camera-to-world poses; printed matrices are made exact rotations.

    Args:
        path: the file.
        frames: their number.
        last: number of the last image: of more poses than images, those of the images' lines count.

    Raises:
        InputError: the file is malformed, or has too few poses.
    """
    rows = []
    for where, words in read_rows(path, ""):
        check_words(where, words, _POSE_NAMES)
        pose = np.reshape(to_numbers(where, words, _POSE_NAMES), (3, 4))
        check_rigid(where, pose)
        rows.append(pose)
    if frames < len(rows) and last < len(rows):
        lines = f"{last - frames + 2} to {last + 1}"
        notice(str(path), f"has {len(rows)} poses for {frames} images: those of lines {lines} count")
        rows = rows[last - frames + 1 : last + 1]
    if len(rows) != frames:
        problem = f"has {len(rows)} poses for {frames} frames"
        raise InputError(str(path), problem, "write one per frame, or delete it to run without ground truth")
    T = np.tile(np.eye(4), (frames, 1, 1))
    T[:, :3] = rows
    T[:, :3, :3] = Rotation.from_matrix(T[:, :3, :3]).as_matrix()
    return T
