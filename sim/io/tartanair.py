"""Reader of TartanAir trajectories.

    image_left/000000_left.png ...         images, 640x480
    pose_left.txt                          tx ty tz qx qy qz qw per frame
    depth_left/000000_left_depth.npy ...   metres along the axis

The second version of the data set has ``lcam_front`` in the place of ``left``, and images of 640x640; its
depth is not read. Poses and depth may be absent. Axes are north, east, down: the camera's x points forward, y
right, z down. The focal length is 320 pixels and no times are given: frames count ten a second. A
``camera.yaml`` in the folder says otherwise.
Source: github.com/castacks/tartanair_tools, data_type.md.
"""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import IMAGE_BYTES, is_folder, is_given, read_bytes
from dslab.sim.io import layout
from dslab.sim.io.camera_file import read_camera
from dslab.sim.io.images import GrayFolder, image_shape, numbered_images
from dslab.sim.io.raw import UNREADABLE
from dslab.sim.io.sidecars import read_sidecars
from dslab.sim.io.text import check_words, read_rows, to_numbers
from dslab.sim.io.truth import check_pose, poses_of
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import Sequence

_FPS = 10.0
_NAMES = ["tx", "ty", "tz", "qx", "qy", "qz", "qw"]
# Columns are the axes of our camera, x right, y down, z forward, in those of the data set.
_NED_FROM_CAMERA = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
# Our worlds have z up.
_UP_FROM_NED = np.diag([1.0, -1, -1, 1])


@dataclass(frozen=True)
class _Version:
    """Names and intrinsics of one version of the data set."""

    camera: str
    width_px: int
    height_px: int

    @property
    def images(self) -> str:
        """Folder of the images."""
        return f"image_{self.camera}"

    @property
    def poses(self) -> str:
        """File of the poses."""
        return f"pose_{self.camera}.txt"

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera, as published."""
        return Intrinsics(
            self.width_px, self.height_px, 320.0, 320.0, self.width_px / 2, self.height_px / 2, _FPS
        )


VERSIONS = (_Version("left", 640, 480), _Version("lcam_front", 640, 640))


def load_tartanair(folder: Path) -> Sequence:
    """Read the left camera of a TartanAir trajectory. Errors as of ``load_sequence``."""
    version = next(v for v in VERSIONS if is_given(folder / v.images) or is_given(folder / v.poses))
    given = is_given(folder / layout.CAMERA_FILE)
    camera = read_camera(folder / layout.CAMERA_FILE) if given else version.intrinsics
    place = folder / version.images
    paths = numbered_images(place, (".png", ".jpg"), f"_{version.camera}")
    if not paths:
        raise InputError(str(place), "holds no image", "copy the folder again")
    shape = (camera.height_px, camera.width_px)
    found = image_shape(paths[0])
    if found != shape and not given:
        problem = f"is {found[1]}x{found[0]} pixels, those of the data set {shape[1]}x{shape[0]}"
        raise InputError(str(paths[0]), problem, "add a camera.yaml with the intrinsics of these images")
    frames = GrayFolder(paths, shape, layout.CAMERA_FILE if given else "the data set")
    return Sequence(
        camera=camera,
        stamps_s=np.arange(len(paths)) / camera.fps,
        frames=frames,
        T_world_cam=_read_poses(folder / version.poses, len(paths)),
        depths=_open_depths(folder, version, [path.stem for path in paths], shape),
        image_names=tuple(f"{version.images}/{path.name}" for path in paths),
        **read_sidecars(folder, len(paths)),
    )


class NpyDepths:
    """A ``FrameSource`` of depth images, stored as arrays of metres.

    Args:
        paths: the files.
        shape: (H, W) that every one must have.
    """

    def __init__(self, paths: list[Path], shape: tuple[int, int]) -> None:
        self._paths, self._shape = paths, shape

    def __len__(self) -> int:
        return len(self._paths)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) float32 metres, 0 for none. Raises InputError if the file holds anything else."""
        path = self._paths[index]
        data = read_bytes(path, IMAGE_BYTES, "copy the folder again")
        try:
            depth_m = np.load(io.BytesIO(data), allow_pickle=False)
        except UNREADABLE:
            raise InputError(str(path), "is no readable array", "copy it again") from None
        if not isinstance(depth_m, np.ndarray) or depth_m.shape != self._shape or depth_m.dtype.kind != "f":
            size = f"{self._shape[1]}x{self._shape[0]}"
            raise InputError(str(path), f"is no depth image of {size} pixels", "copy it again")
        depth_m = depth_m.astype(np.float32)
        return np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, np.float32(0))


def _open_depths(
    folder: Path, version: _Version, stems: list[str], shape: tuple[int, int]
) -> NpyDepths | None:
    """The depth images; None without arrays of them."""
    place = folder / f"depth_{version.camera}"
    paths = [place / f"{stem}_depth.npy" for stem in stems]
    if not is_folder(place) or not any(is_given(path) for path in paths):
        return None
    lacking = next((path for path in paths if not is_given(path)), None)
    if lacking is not None:
        remedy = f"copy the folder again, or delete {place.name} to do without depth"
        raise InputError(str(lacking), "is missing", remedy)
    return NpyDepths(paths, shape)


def _read_poses(path: Path, frames: int) -> np.ndarray | None:
    """(N, 4, 4) camera to world, z up; None without the file."""
    if not is_given(path):
        return None
    rows = []
    for where, words in read_rows(path, ""):
        check_words(where, words, _NAMES)
        rows.append(to_numbers(where, words, _NAMES))
        check_pose(where, rows[-1])
    if len(rows) != frames:
        problem = f"has {len(rows)} poses for {frames} images"
        raise InputError(
            str(path), problem, "copy the folder again, or delete it to run without ground truth"
        )
    table = np.array(rows)
    return _UP_FROM_NED @ poses_of(table[:, :3], table[:, 3:]) @ _NED_FROM_CAMERA
