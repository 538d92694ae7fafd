"""Sequence folders of every form: detection, reading, writing."""

from enum import StrEnum
from pathlib import Path

from scenarios.errors import InputError
from scenarios.input_files import is_folder, is_given
from sim.io import euroc_layout, kitti, layout, tum_mono
from sim.io.euroc_reader import load_euroc
from sim.io.euroc_writer import write_euroc
from sim.io.folders import Progress
from sim.io.tum_reader import load_tum
from sim.io.tum_writer import write_tum
from sim.sensors.imu import ImuReadings, ImuTruth
from sim.sequence import Sequence


class Form(StrEnum):
    """The forms a sequence folder can have."""

    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"
    TUM_MONO = "tum-mono"


_LOADERS = {
    Form.TUM: load_tum,
    Form.KITTI: kitti.load_kitti,
    Form.EUROC: load_euroc,
    Form.TUM_MONO: tum_mono.load_tum_mono,
}


def detect_form(folder: Path) -> Form:
    """Detect the form of a sequence folder by the files that no other form has.

    Raises:
        InputError: the folder does not exist or has none of the forms.
    """
    if not is_folder(folder):
        problem = "is no folder" if is_given(folder) else "no such folder"
        raise InputError(str(folder), problem, "give a folder with rgb.txt, camera.yaml and images")
    marks = {
        Form.TUM: (layout.FRAMES_FILE, layout.CAMERA_FILE),
        Form.EUROC: (euroc_layout.CAMERA_DIR,),
        Form.KITTI: (kitti.IMAGES_DIR,),
        Form.TUM_MONO: (tum_mono.CAMERA_FILE, tum_mono.IMAGES_ZIP),
    }
    for form, names in marks.items():
        if any(is_given(folder / name) for name in names):
            return form
    known = (
        "rgb.txt and camera.yaml (TUM), image_0 and times.txt (KITTI), mav0/cam0 (EuRoC), "
        "or images and camera.txt (TUM-mono)"
    )
    raise InputError(str(folder), "holds no sequence of a known form", f"give a folder with {known}")


def sequence_folder(path: Path) -> Path:
    """The folder of a sequence; for the EuRoC form, ``mav0`` may be given too."""
    return path.parent if path.name == "mav0" and is_folder(path / "cam0") else path


def load_sequence(path: str | Path) -> Sequence:
    """Read a sequence from a folder of any form.

    Args:
        path: the folder; for the EuRoC form, ``mav0`` may be given too.

    Raises:
        InputError: the folder does not exist or has no known form, or a file of it is missing, empty, cut
            short, malformed or absurd. Reading a frame raises it too, if the image is unreadable or of
            another size.
    """
    folder = sequence_folder(Path(path))
    return _LOADERS[detect_form(folder)](folder)


def write_sequence(
    sequence: Sequence,
    directory: Path,
    form: Form,
    imu: tuple[ImuReadings, ImuTruth | None] | None = None,
    depth: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write a sequence as a folder of a form.

    Args:
        sequence: what to write.
        directory: new or empty folder.
        form: any but TUM-mono.
        imu: inertial readings, for the EuRoC form.
        depth: write depth images too, in the TUM form; the sequence must have them.
        progress: called with step, frames done and frames in all.

    Raises:
        InputError: the form cannot hold the sequence; the folder is not empty or cannot be written, the
            disk is full; nothing is left behind.
    """
    if imu is not None and form is not Form.EUROC:
        raise InputError("--imu", f"the form {form} has no inertial readings", "use --format euroc")
    if depth and form is not Form.TUM:
        raise InputError("--depth", f"the form {form} has no depth images", "use --format tum")
    if form is Form.TUM:
        write_tum(sequence, directory, depth, progress)
    elif form is Form.KITTI:
        kitti.write_kitti(sequence, directory, progress)
    elif form is Form.EUROC:
        write_euroc(sequence, directory, imu, progress)
    else:
        raise InputError("--format", f"{form} is read, not written", "use tum, kitti or euroc")
