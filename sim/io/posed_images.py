"""Images that have true poses and no times, as one sequence; the forms of data sets that are such folders.

    7-Scenes   frame-000000.color.png, frame-000000.pose.txt
    ICL-NUIM   rgb/0.png, depth/0.png, livingRoom0.gt.freiburg: poses by the numbers of the frames
    ScanNet    color/0.jpg, pose/0.txt, intrinsic/intrinsic_color.txt
    Replica    results/frame000000.jpg, results/depth000000.png, traj.txt, cam_params.json, there or above

Poses are camera to world, as 4x4 matrices but for ICL-NUIM; a frame whose matrix is not finite has none.
Frames count at a stated rate. A ``camera.yaml`` in the folder, or ``--camera``, replaces intrinsics and rate.

ICL-NUIM's world has y up, and so had its camera, whence the published fy of -480. Its images are stored from
the top down: with fy 480, world and camera are both mirrored. The depth images of 7-Scenes are not registered
to colour and those of ScanNet have another size: neither are read. 7-Scenes publishes no colour camera, only
585 pixels for depth; 525 is the default of the sensor's driver.
Source: the data sets' pages, and for Replica the rendering that NICE-SLAM distributes.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError, notice
from dslab.scenarios.input_files import file_names, is_folder, is_given
from dslab.sim.io import layout
from dslab.sim.io.calibration import Calibration
from dslab.sim.io.calibrations import read_calibration
from dslab.sim.io.camera_file import intrinsics_of, read_camera
from dslab.sim.io.images import DepthFolder, GrayFolder, image_shape, names_in
from dslab.sim.io.sidecars import read_sidecars
from dslab.sim.io.text import check_present, check_words, read_rows, to_frame_number, to_numbers
from dslab.sim.io.truth import check_rigid, read_tum_poses
from dslab.sim.sequence import Sequence

FPS = 30.0
"""Images per second where nothing says it."""
_CELLS = [f"m{row}{column}" for row in range(4) for column in range(4)]
_NOT_FINITE = re.compile(r"[-+]?(inf(inity)?|nan)|.*#.*", re.IGNORECASE)
_Y_MIRRORED = np.diag([1.0, -1, 1, 1])
Truth = Callable[[Path, list[str]], np.ndarray | None]


@dataclass(frozen=True)
class Layout:
    """A folder of numbered images.

    Attributes:
        home: folder of the images in it.
        image: pattern of their names, with a group for the number.
        mark: pattern of a name that the folder has.
        poses: reads (N, 4, 4) poses, given the folder and the numbers, or None.
        published: camera of the data set, for images of its size; None without one.
        camera: reads the calibration that the folder has, or None.
        depth: where the depth image of a number is; empty without depth.
        depth_per_m: its codes per metre.
    """

    home: str
    image: str
    mark: str
    poses: Truth
    published: Calibration | None = None
    camera: Callable[[Path], tuple[Path, Calibration] | None] = lambda folder: None
    depth: str = ""
    depth_per_m: float = layout.DEPTH_PER_M

    def fits(self, folder: Path) -> bool:
        """True for a folder of this layout."""
        return is_folder(folder / self.home) and any(
            re.fullmatch(self.mark, name) for name in file_names(folder)
        )


def posed_sequence(
    folder: Path,
    images: list[Path],
    numbers: np.ndarray,
    calibration: Callable[[tuple[int, int]], tuple[Path, Calibration]],
    camera_file: Path | None,
    T_world_cam: np.ndarray | None,
    depths: tuple[list[Path | None], float] | None = None,
) -> Sequence:
    """A sequence of images without times.

    Args:
        folder: of the sequence.
        images: N of them, in their order.
        numbers: (N,) increasing numbers, by which time counts.
        calibration: called with (H, W) if there is no other camera, gives a calibration and its file.
        camera_file: of the camera that is to count; None for that of the folder.
        T_world_cam: (N, 4, 4), or None.
        depths: depth images, None for a frame without one, and their codes per metre.

    Raises:
        InputError: an image is missing, or the camera is not known or does not fit.
    """
    check_present(images, str(folder))
    shape = image_shape(images[0])
    own = camera_file or folder / layout.CAMERA_FILE
    step = float(np.diff(numbers).min()) if len(numbers) > 1 else 1.0
    if camera_file is not None or is_given(own):
        camera = read_camera(own, shape[::-1], FPS / step)
    else:
        own, found = calibration(shape)
        camera = intrinsics_of(found, own, shape[::-1], FPS / step)
    notice(str(folder), f"has no times: frames count as taken {camera.fps:g} times a second")
    lacking = round(float(numbers[-1] - numbers[0]) / step) + 1 - len(numbers)
    if lacking:
        notice(str(folder), f"{lacking} numbers are missing between the images: their time passes")
    size = (camera.height_px, camera.width_px)
    some = depths is not None and any(path is not None for path in depths[0])
    return Sequence(
        camera=camera,
        stamps_s=(numbers - numbers[0]) / step / camera.fps,
        frames=GrayFolder(images, size, str(own)),
        T_world_cam=T_world_cam,
        depths=DepthFolder(depths[0], size, depths[1], str(own)) if depths and some else None,
        image_names=names_in(folder, images),
        **read_sidecars(folder, len(images)),
    )


def load_layout(form: Layout, folder: Path, camera_file: Path | None = None) -> Sequence:
    """Read a folder of numbered images. Errors as of ``load_sequence``."""
    home = folder / form.home
    words: dict[int, tuple[str, str]] = {}
    for name in file_names(home):
        if match := re.fullmatch(form.image, name):
            number = to_frame_number(f"{home}: {name}", match[1])
            if number in words:
                raise InputError(f"{home}: {name}", f"number {number} occurs twice", "keep one of them")
            words[number] = match[1], name
    if not words:
        raise InputError(str(home), "holds no image", "copy the folder again")
    numbers = sorted(words)
    written = [words[number][0] for number in numbers]
    images = [home / words[number][1] for number in numbers]
    depths = [folder / form.depth.format(word) for word in written] if form.depth else []

    def calibration(shape: tuple[int, int]) -> tuple[Path, Calibration]:
        return form.camera(folder) or _published(folder, form.published, shape)

    return posed_sequence(
        folder,
        images,
        np.array(numbers),
        calibration,
        camera_file,
        form.poses(folder, written),
        ([path if is_given(path) else None for path in depths], form.depth_per_m),
    )


def _published(folder: Path, camera: Calibration | None, shape: tuple[int, int]) -> tuple[Path, Calibration]:
    remedy = "add --camera FILE, or a camera.yaml in the folder"
    if camera is None or camera.size_px != shape[::-1]:
        size = f"{shape[1]}x{shape[0]}"
        raise InputError(str(folder), f"does not say which camera took its images of {size}", remedy)
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    notice(
        str(folder), f"the camera is taken to be fx {fx:g}, fy {fy:g}, cx {cx:g}, cy {cy:g}: else {remedy}"
    )
    return folder, camera


def matrix_of(where: str, words: list[str]) -> np.ndarray:
    """(4, 4) camera to world of 16 words, NaN if one is not finite. Raises InputError for anything else."""
    check_words(where, words, _CELLS)
    if any(_NOT_FINITE.fullmatch(word) for word in words):
        return np.full((4, 4), np.nan)
    return rigid(where, np.reshape(to_numbers(where, words, _CELLS), (4, 4)))


def rigid(where: str, T: np.ndarray) -> np.ndarray:
    """(4, 4) with an exact rotation, of printed rows. Raises InputError if they are no rigid transform."""
    check_rigid(where, T)
    exact = np.eye(4)
    exact[:3, :3] = Rotation.from_matrix(T[:3, :3]).as_matrix()
    exact[:3, 3] = T[:3, 3]
    return exact


def _in_files(place: str) -> Truth:
    """Poses in a file per number."""

    def read(folder: Path, numbers: list[str]) -> np.ndarray | None:
        paths = [folder / place.format(number) for number in numbers]
        if not any(is_given(path) for path in paths):
            return None
        T = np.full((len(paths), 4, 4), np.nan)
        for frame, path in enumerate(paths):
            if is_given(path):
                T[frame] = matrix_of(str(path), [word for _, row in read_rows(path, "") for word in row])
        return T

    return read


def _in_lines(folder: Path, numbers: list[str]) -> np.ndarray | None:
    """Poses in lines of traj.txt, the first of number 0."""
    path = folder / "traj.txt"
    if not is_given(path):
        return None
    rows = [matrix_of(where, words) for where, words in read_rows(path, "")]
    if int(numbers[-1]) >= len(rows):
        problem = f"has {len(rows)} poses for images up to number {int(numbers[-1])}"
        raise InputError(str(path), problem, "copy it again, or delete it to run without ground truth")
    return np.array([rows[int(number)] for number in numbers])


def _by_number(folder: Path, numbers: list[str]) -> np.ndarray | None:
    """ICL-NUIM's poses, whose stamps are numbers of frames."""
    names = [name for name in file_names(folder) if name.endswith(".gt.freiburg")]
    if not names:
        return None
    if len(names) > 1:
        problem = f"has several files of poses ({', '.join(names)})"
        raise InputError(str(folder), problem, "keep the right one")
    T = read_tum_poses(folder / names[0], np.array(numbers, float), 0.1)
    return None if T is None else _Y_MIRRORED @ T @ _Y_MIRRORED


def _matrix_camera(folder: Path) -> tuple[Path, Calibration] | None:
    """ScanNet's camera: a matrix of 4x4."""
    path = folder / "intrinsic" / "intrinsic_color.txt"
    if not is_given(path):
        return None
    words = [word for _, row in read_rows(path, "") for word in row]
    check_words(str(path), words, _CELLS)
    fx, _, cx, _, _, fy, cy = to_numbers(str(path), words, _CELLS)[:7]
    return path, Calibration("ScanNet intrinsics", (fx, fy), (cx, cy))


def _json_camera(folder: Path) -> tuple[Path, Calibration] | None:
    """Replica's camera, in the folder or beside it."""
    places = (folder / "cam_params.json", folder.resolve().parent / "cam_params.json")
    path = next(filter(is_given, places), None)
    found = None if path is None else read_calibration(path)
    return None if path is None or found is None else (path, found)


_NUMBER = "([0-9]{1,9})"
_IMAGE = r"(png|jpg|jpeg)"
_SEVEN_SCENES = rf"frame-{_NUMBER}\.color\.{_IMAGE}"
LAYOUTS = {
    "7-scenes": Layout(
        "",
        _SEVEN_SCENES,
        _SEVEN_SCENES,
        _in_files("frame-{}.pose.txt"),
        Calibration("7-Scenes", (525.0, 525.0), (320.0, 240.0), size_px=(640, 480)),
    ),
    "icl-nuim": Layout(
        "rgb",
        rf"{_NUMBER}\.{_IMAGE}",
        r".*\.gt\.freiburg|associations\.txt",
        _by_number,
        Calibration("ICL-NUIM", (481.2, 480.0), (319.5, 239.5), size_px=(640, 480)),
        depth="depth/{}.png",
    ),
    "scannet": Layout(
        "color", rf"{_NUMBER}\.{_IMAGE}", "pose|intrinsic", _in_files("pose/{}.txt"), camera=_matrix_camera
    ),
    "replica": Layout(
        "results",
        rf"frame{_NUMBER}\.{_IMAGE}",
        r"traj\.txt|cam_params\.json",
        _in_lines,
        Calibration("Replica", (600.0, 600.0), (599.5, 339.5), size_px=(1200, 680)),
        _json_camera,
        "results/depth{}.png",
        6553.5,
    ),
}
"""Layouts by the names of their forms."""
