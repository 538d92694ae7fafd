"""Reader of TUM-form folders; every fault names file, line, field and remedy."""

from pathlib import Path

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given
from dslab.sim.io import layout
from dslab.sim.io.camera_file import read_camera
from dslab.sim.io.images import DepthFolder, GrayFolder
from dslab.sim.io.sidecars import read_sidecars
from dslab.sim.io.text import check_order, check_present, read_rows, to_stamp
from dslab.sim.io.truth import half_interval_s, nearest, read_tum_poses
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import Sequence


def load_tum(folder: Path) -> Sequence:
    """Read a sequence from a TUM-form folder; see ``sim.io.layout``.

    The existence of every image is checked now, its content when the frame is read. Ground truth and depth
    images are assigned to frames within half a frame interval, without interpolation; a frame without a depth
    image has depth 0 (unknown) everywhere.

    Raises:
        InputError: a file is missing, empty, cut short, malformed or absurd. Reading a frame raises it too,
            if the image is unreadable or of another size.
    """
    camera = read_camera(folder / layout.CAMERA_FILE)
    stamps_s, images = _read_list(folder / layout.FRAMES_FILE)
    frames = GrayFolder(images, (camera.height_px, camera.width_px))
    frames[0]  # a wrong size shows in the first image already
    tolerance_s = half_interval_s(stamps_s, camera.fps)
    return Sequence(
        camera=camera,
        stamps_s=stamps_s,
        frames=frames,
        T_world_cam=read_tum_poses(folder / layout.TRUTH_FILE, stamps_s, tolerance_s),
        depths=_read_depths(folder / layout.DEPTH_FILE, camera, stamps_s, tolerance_s),
        **read_sidecars(folder, len(stamps_s)),
    )


def _read_list(path: Path) -> tuple[np.ndarray, list[Path]]:
    """Read (N,) stamps and the image paths of a list of frames."""
    stamps: list[float] = []
    images: list[Path] = []
    for where, words in read_rows(path, "give a folder with the list of frames, `stamp filename` per line"):
        if len(words) != 2:
            problem = f"{len(words)} words where stamp and filename belong"
            raise InputError(where, problem, "write `stamp filename`; the file may be cut short")
        stamp_s = to_stamp(where, words[0])
        check_order(where, stamps, stamp_s)
        stamps.append(stamp_s)
        images.append(path.parent / words[1])
    if not stamps:
        raise InputError(str(path), "lists no frame", "give a folder with at least one frame")
    check_present(images, path.name)
    return np.array(stamps), images


def _read_depths(
    path: Path, camera: Intrinsics, stamps_s: np.ndarray, tolerance_s: float
) -> DepthFolder | None:
    """The depth image nearest in time to each frame; None without the file."""
    if not is_given(path):
        return None
    depth_s, images = _read_list(path)
    best = nearest(depth_s, stamps_s, tolerance_s)
    if (best < 0).all():
        problem = f"no stamp lies within {tolerance_s:.4g} s of a frame's"
        raise InputError(str(path), problem, "give both files the same clock, or delete this one")
    chosen = [images[index] if index >= 0 else None for index in best]
    return DepthFolder(chosen, (camera.height_px, camera.width_px))
