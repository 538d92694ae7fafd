"""Reader and writer of TUM-form folders; see ``sim.io.layout``."""

from pathlib import Path

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given
from dslab.sim.io import layout
from dslab.sim.io.camera_file import read_camera, write_camera
from dslab.sim.io.clock import held_stamps, written_seconds
from dslab.sim.io.folders import Progress, new_directory, write_images
from dslab.sim.io.images import DepthFolder, GrayFolder, image_shape, names_in
from dslab.sim.io.sidecars import read_sidecars, write_sidecars
from dslab.sim.io.text import check_present, read_list, to_decimal
from dslab.sim.io.truth import half_interval_s, nearest, other_clock, read_tum_poses, tum_poses_text
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import FrameSource, Sequence

# As many lines as the data set's lists have: ORB-SLAM3's program passes over three.
_HEADER = ("# images", "# by the seconds of their stamps", "# stamp_s filename")


def load_tum(folder: Path, camera_file: Path | None = None) -> Sequence:
    """Read a sequence from a TUM-form folder; see ``sim.io.layout``. Errors as of ``load_sequence``.

    Its camera may be given, or be a calibration.yaml, as VSLAM-LAB had it beside these lists. The existence
    of every image is checked now, its content when the frame is read. Ground truth and depth images are
    assigned to frames within half a frame interval, without interpolation; a frame without a depth image has
    depth 0 (unknown) everywhere.
    """
    stamps_s, stamps_ns, images = _read_list(folder / layout.FRAMES_FILE)
    path = camera_file or _camera_file(folder)
    rate = round(1 / float(np.median(np.diff(stamps_s))), 4) if len(stamps_s) > 1 else None
    camera = read_camera(path, image_shape(images[0])[::-1], rate)
    _check_unit(f"{folder / layout.FRAMES_FILE}: stamp", stamps_s, camera.fps)
    frames = GrayFolder(images, (camera.height_px, camera.width_px), path.name)
    tolerance_s = half_interval_s(stamps_s, camera.fps)
    return Sequence(
        camera=camera,
        stamps_s=stamps_s,
        frames=frames,
        T_world_cam=read_tum_poses(folder / layout.TRUTH_FILE, stamps_s, tolerance_s),
        depths=_read_depths(folder / layout.DEPTH_FILE, camera, stamps_s, tolerance_s),
        image_names=names_in(folder, images),
        stamps_ns=stamps_ns,
        **read_sidecars(folder, len(stamps_s)),
    )


def _camera_file(folder: Path) -> Path:
    names = (layout.CAMERA_FILE, layout.CALIBRATION_FILE)
    path = next((folder / name for name in names if is_given(folder / name)), None)
    if path is None:
        remedy = "add --camera FILE, or a calibration under this name"
        raise InputError(str(folder / layout.CAMERA_FILE), "no such file", remedy)
    return path


def _check_unit(where: str, stamps_s: np.ndarray, fps: float) -> None:
    """Raise InputError where stamps step by a thousand times and more what the frame rate says."""
    step_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else 1 / fps
    for unit, per_s in (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)):
        if 0.5 < step_s * fps / per_s < 2:
            problem = f"stamps step by {step_s:g} s, the camera takes {fps:g} images a second"
            raise InputError(where, problem, f"these look like {unit}: divide them by {per_s:.0f}")


def _read_list(path: Path) -> tuple[np.ndarray, np.ndarray | None, list[Path]]:
    """Read the stamps, see ``held_stamps``, and the image paths of a list of frames."""
    stamps, names = read_list(path, None, to_decimal)
    images = [path.parent / name for name in names]
    check_present(images, path.name)
    return *held_stamps(path, stamps), images


def _read_depths(
    path: Path, camera: Intrinsics, stamps_s: np.ndarray, tolerance_s: float
) -> DepthFolder | None:
    """The depth image nearest in time to each frame; None without the file."""
    if not is_given(path):
        return None
    depth_s, _, images = _read_list(path)
    best = nearest(depth_s, stamps_s, tolerance_s)
    if (best < 0).all():
        raise other_clock(path, depth_s, stamps_s, tolerance_s)
    chosen = [images[index] if index >= 0 else None for index in best]
    return DepthFolder(chosen, (camera.height_px, camera.width_px))


def write_tum(
    sequence: Sequence,
    directory: Path,
    depth: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write a sequence as a TUM-form folder. Arguments and errors as of ``write_sequence``."""
    coded = CodedDepth(sequence) if depth else None
    _check_unit(sequence.name, sequence.stamps_s, sequence.camera.fps)
    stamps = written_seconds(sequence)
    with new_directory(directory) as folder:
        write_camera(sequence.camera, folder / layout.CAMERA_FILE)
        if sequence.T_world_cam is not None:
            text = tum_poses_text(sequence.stamps_s, sequence.T_world_cam, stamps)
            (folder / layout.TRUTH_FILE).write_text(text)
        write_sidecars(sequence, folder)
        _write_list(stamps, folder, "rgb", layout.FRAMES_FILE, sequence.frames, progress)
        if coded:
            _write_list(stamps, folder, "depth", layout.DEPTH_FILE, coded, progress)


class CodedDepth:
    """A sequence's depth as 16-bit images; depth out of range becomes unknown. Raises InputError without."""

    def __init__(self, sequence: Sequence) -> None:
        if sequence.depths is None:
            raise InputError(sequence.name, "has no depth images", "render it with depth")
        self._depths = sequence.depths

    def __len__(self) -> int:
        return len(self._depths)

    def __getitem__(self, index: int) -> np.ndarray:
        code = np.rint(self._depths[index] * layout.DEPTH_PER_M)
        return np.where(code <= 65535, code, 0).astype(np.uint16)


def _write_list(
    stamps: list[str],
    folder: Path,
    name: str,
    list_file: str,
    images: FrameSource,
    progress: Progress | None,
) -> None:
    (folder / name).mkdir()
    paths = [f"{name}/{frame:06d}.png" for frame in range(len(stamps))]
    write_images(images, [folder / path for path in paths], f"writing {name}", progress)
    lines = [f"{stamp} {path}" for stamp, path in zip(stamps, paths, strict=True)]
    (folder / list_file).write_text("\n".join([*_HEADER, *lines]) + "\n")
