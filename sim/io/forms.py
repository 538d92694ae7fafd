"""Sequence folders of every form: detection, reading, writing."""

from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Literal

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_folder, is_given
from dslab.sim.io import euroc, kitti, layout, reconstructions, tartanair, tum, tum_mono, vslam_lab
from dslab.sim.io.bag import is_bag, load_bag
from dslab.sim.io.clock import origin_ns
from dslab.sim.io.folders import Progress
from dslab.sim.io.loose_images import load_images
from dslab.sim.io.posed_images import LAYOUTS, load_layout
from dslab.sim.io.truth import half_interval_s, read_tum_poses, told_coverage
from dslab.sim.io.video import is_video, load_video
from dslab.sim.io.wide_lens import rectified_if_wide
from dslab.sim.sensors.imu import ImuReadings, ImuTruth
from dslab.sim.sequence import InColour, Sequence


class Form(StrEnum):
    """The forms a sequence folder can have."""

    TUM = "tum"
    KITTI = "kitti"
    EUROC = "euroc"
    TUM_MONO = "tum-mono"
    VSLAM_LAB = "vslam-lab"
    TARTANAIR = "tartanair"
    SEVEN_SCENES = "7-scenes"
    ICL_NUIM = "icl-nuim"
    SCANNET = "scannet"
    REPLICA = "replica"
    NERFSTUDIO = "nerfstudio"
    COLMAP = "colmap"
    ROS_BAG = "ros-bag"


TruthForm = Literal["tum", "kitti", "euroc"]
"""The forms of files of true poses."""
WITH_DEPTH = (Form.TUM, Form.VSLAM_LAB)
"""The forms that are written with depth images if wanted."""


_LOADERS: dict[Form, Callable[..., Sequence]] = {
    Form.TUM: tum.load_tum,
    Form.KITTI: kitti.load_kitti,
    Form.EUROC: euroc.load_euroc,
    Form.TUM_MONO: tum_mono.load_tum_mono,
    Form.VSLAM_LAB: vslam_lab.load_vslam_lab,
    Form.TARTANAIR: tartanair.load_tartanair,
    **{Form(name): partial(load_layout, form) for name, form in LAYOUTS.items()},
    Form.NERFSTUDIO: reconstructions.load_transforms,
    Form.COLMAP: reconstructions.load_colmap,
    Form.ROS_BAG: load_bag,
}
_ANY_CAMERA = (Form.TUM, *map(Form, LAYOUTS), Form.NERFSTUDIO, Form.COLMAP)
"""The forms whose intrinsics a calibration from elsewhere may replace."""
_WRITERS: dict[Form, Callable[..., None]] = {
    Form.TUM: tum.write_tum,
    Form.KITTI: kitti.write_kitti,
    Form.EUROC: euroc.write_euroc,
    Form.VSLAM_LAB: vslam_lab.write_vslam_lab,
}
READ_ONLY = tuple(form for form in Form if form not in _WRITERS)
"""The forms that are not written."""
# Names of files and folders that no form further down has.
_MARKS: dict[Form, tuple[str, ...]] = {
    Form.VSLAM_LAB: (vslam_lab.FRAMES_FILE, vslam_lab.IMAGES_DIR),
    Form.TARTANAIR: tuple(name for v in tartanair.VERSIONS for name in (v.images, v.poses)),
    Form.TUM: (layout.FRAMES_FILE,),
    Form.EUROC: (euroc.CAMERA_DIR, f"cam0/{euroc.TABLE_FILE}", euroc.TABLE_FILE),
    Form.KITTI: (*kitti.IMAGES_DIRS, *kitti.RAW_DIRS),
    Form.TUM_MONO: (tum_mono.CAMERA_FILE, tum_mono.IMAGES_ZIP),
    Form.NERFSTUDIO: (reconstructions.TRANSFORMS_FILE,),
}


def detect_form(folder: Path) -> Form:
    """Detect the form of a sequence folder by the files that no other form has.

    Raises:
        InputError: the folder does not exist or has none of the forms.
    """
    if not is_folder(folder):
        problem = "is no folder" if is_given(folder) else "no such folder"
        raise InputError(str(folder), problem, "give a folder with rgb.txt, camera.yaml and images")
    form = _form_of(folder)
    if form is not None:
        return form
    known = (
        "rgb.txt and camera.yaml (TUM), image_0 or image_2 (KITTI), mav0/cam0 (EuRoC), "
        "images and camera.txt (TUM-mono), rgb_0 and rgb.csv (VSLAM-LAB), image_left (TartanAir), "
        "transforms.json, or sparse/0 and images (COLMAP); "
        "or add --camera FILE for a folder of images"
    )
    raise InputError(str(folder), "holds no sequence of a known form", f"give a folder with {known}")


def _form_of(folder: Path) -> Form | None:
    for form, names in _MARKS.items():
        if any(is_given(folder / name) for name in names):
            return form
    if not is_folder(folder):
        return None
    if reconstructions.model_folder(folder) is not None:
        return Form.COLMAP
    if is_bag(folder):
        return Form.ROS_BAG
    fits = (Form(name) for name, form in LAYOUTS.items() if form.fits(folder))
    # Any of the others may have a camera.yaml too.
    return next(fits, Form.TUM if is_given(folder / layout.CAMERA_FILE) else None)


def sequence_folder(path: Path) -> Path:
    """The folder of a sequence; for the EuRoC form, ``mav0`` may be given too."""
    return path.parent if path.name == "mav0" and is_folder(path / "cam0") else path


def load_sequence(
    path: str | Path,
    camera: str | Path | None = None,
    progress: Progress | None = None,
    force: bool = False,
    truth: str | Path | None = None,
    truth_form: TruthForm = "tum",
) -> Sequence:
    """Read a sequence from a folder of any form, or from a ROS bag, images or a video.

    Args:
        path: the folder; for the EuRoC form, ``mav0`` may be given too. With ``camera`` a folder of images
            without any list, or a video file. A bag may be followed by ``:TOPIC``.
        camera: calibration of images or a video, or in the place of that of a folder in TUM's form or of
            images without times; see ``sim.io.camera_file.read_camera``.
        progress: called with (step, frames done, frames in all) while a video or a bag is decoded.
        force: decode it even if its frames seem too many for the disk.
        truth: file of true poses, camera to world, in the place of the sequence's own.
        truth_form: ``tum`` and ``euroc`` on the clock of the frames, or ``tum`` on that of EuRoC's stamps,
            ``kitti`` with a line per frame.

    Raises:
        InputError: the folder does not exist or has no known form, or a file of it is missing, empty, cut
            short, malformed or absurd. Reading a frame raises it too, if the image is unreadable or of
            another size.
    """
    if camera is None and is_video(path) and not is_folder(path):
        remedy = "add its intrinsics: --camera FILE (sim.load_sequence(…, camera=FILE))"
        raise InputError(str(path), "a video says nothing of its camera", remedy)
    folder = sequence_folder(Path(path))
    form = _form_of(folder)
    # Images may be of any place, that of a camera.yaml too.
    listed = form in _ANY_CAMERA and (form is not Form.TUM or is_given(folder / layout.FRAMES_FILE))
    if form is Form.ROS_BAG or (form is None and is_bag(path)):
        sequence = load_bag(Path(path), camera and Path(camera), progress=progress, force=force)
    elif camera is not None and form is not None and listed:
        sequence = _LOADERS[form](folder, Path(camera))
    elif camera is None:
        sequence = _LOADERS[detect_form(folder)](folder)
    elif is_video(path):
        sequence = load_video(Path(path), Path(camera), progress=progress, force=force)
    else:
        sequence = load_images(Path(path), Path(camera))
    sequence = rectified_if_wide(str(path), sequence)
    if truth is not None:
        sequence = with_truth(sequence, Path(truth), truth_form)
    T = told_coverage(str(truth or path), sequence.stamps_s, sequence.T_world_cam)
    return sequence if T is sequence.T_world_cam else replace(sequence, T_world_cam=T)


def with_truth(sequence: Sequence, path: Path, form: TruthForm) -> Sequence:
    """A sequence with true poses of a file. Arguments and errors as of ``load_sequence``."""
    if not is_given(path):
        raise InputError(str(path), "no such file", "give the file of the true poses")
    stamps_s = sequence.stamps_s
    tolerance_s = half_interval_s(stamps_s, sequence.camera.fps)
    if form == "kitti":
        T = kitti.read_kitti_poses(path, len(sequence), len(sequence) - 1)
    elif form == "euroc":
        T = euroc.read_euroc_poses(path, origin_ns(sequence), stamps_s, tolerance_s)
    else:
        T = read_tum_poses(path, stamps_s, tolerance_s, origin_ns(sequence) / 1e9)
    return replace(sequence, T_world_cam=T)


def write_sequence(
    sequence: Sequence,
    directory: Path,
    form: Form,
    imu: tuple[ImuReadings, ImuTruth | None] | None = None,
    depth: bool = False,
    progress: Progress | None = None,
    colour: bool = True,
) -> None:
    """Write a sequence as a folder of a form.

    Args:
        sequence: what to write.
        directory: new or empty folder.
        form: any but TUM-mono and TartanAir.
        imu: for the EuRoC form, readings and, if known, the truth at the frames; see ``record_imu``.
        depth: write depth images too, in the TUM and VSLAM-LAB forms; the sequence must have them.
        progress: called with step, frames done and frames in all.
        colour: write frames in colour where the sequence has it; the lab reads them as gray.

    Raises:
        InputError: the form cannot hold the sequence; the folder is not empty or cannot be written, the
            disk is full; nothing is left behind.
    """
    if imu is not None and form is not Form.EUROC:
        raise InputError("--imu", f"the form {form} has no inertial readings", "use --format euroc")
    if depth and form not in WITH_DEPTH:
        problem = f"the form {form} has no depth images"
        raise InputError("--depth", problem, f"use --format {' or '.join(WITH_DEPTH)}")
    if form not in _WRITERS:
        raise InputError("--format", f"{form} is read, not written", "use tum, kitti, euroc or vslam-lab")
    more = {"depth": depth} if form in WITH_DEPTH else {"imu": imu} if form is Form.EUROC else {}
    sequence = replace(sequence, frames=InColour(sequence.frames)) if colour else sequence
    _WRITERS[form](sequence, directory, progress=progress, **more)
