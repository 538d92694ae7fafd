"""Images in a folder without any list of them, with a camera.yaml from elsewhere."""

import re
from collections import Counter
from pathlib import Path

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import file_names, is_folder, is_given
from dslab.sim.io.camera_file import read_camera
from dslab.sim.io.images import GrayFolder, image_shape
from dslab.sim.io.text import check_present
from dslab.sim.sequence import Sequence

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".webp", ".tif", ".tiff")
"""Of the names of images, in either case."""


def load_images(folder: Path, camera_file: Path) -> Sequence:
    """Read the images of a folder in the order of their names, numbers in these by their value.

    Frames count at the rate of the camera.

    Args:
        folder: its other files and its folders are left alone.
        camera_file: a camera.yaml, or another calibration; see ``read_camera``.

    Raises:
        InputError: the camera cannot be read, there is no such folder or no image in it, or one is empty.
            Reading a frame raises it too, if the image is unreadable or of another size.
    """
    if not is_folder(folder):
        problem = "is no folder" if is_given(folder) else "no such folder"
        raise InputError(str(folder), problem, "give a folder of images, or a video file")
    names = sorted((name for name in file_names(folder) if name.lower().endswith(SUFFIXES)), key=name_order)
    if not names:
        raise InputError(str(folder), "holds no image", f"give a folder with {', '.join(SUFFIXES)}")
    _check_one_kind(folder, names)
    paths = [folder / name for name in names]
    check_present(paths, str(folder))
    height, width = image_shape(paths[0])
    camera = read_camera(camera_file, (width, height))
    frames = GrayFolder(paths, (camera.height_px, camera.width_px), str(camera_file))
    return Sequence(
        name=folder.resolve().name,
        camera=camera,
        stamps_s=np.arange(len(paths)) / camera.fps,
        frames=frames,
        T_world_cam=None,
        depths=None,
        segments=(),
        meta={},
        image_names=tuple(names),
    )


def _check_one_kind(folder: Path, names: list[str]) -> None:
    """Raise InputError for as many images of one name as of another: of two cameras, depth, masks."""
    counts = Counter(map(kind_of_name, names))
    numbers = list(counts.values())
    several = [(name, count) for name, count in counts.items() if numbers.count(count) > 1 and count > 1]
    if several:
        shown = ", ".join(f"{count} {name}" for name, count in several[:3])
        raise InputError(
            str(folder), f"holds images of several kinds ({shown})", "give a folder with one kind"
        )


def kind_of_name(name: str) -> str:
    """A name with a mark for each number: images of one camera have one."""
    return re.sub(r"[0-9]+", "#", name)


def name_order(name: str) -> tuple[list[tuple[int, int, str]], str]:
    """Key of a name: `frame9` comes before `frame10`."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts], name
