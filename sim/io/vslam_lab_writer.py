"""Writer of VSLAM-LAB folders, all or nothing. Layout: ``sim.io.vslam_lab_layout``."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from dslab.scenarios.errors import InputError
from dslab.sim.io import vslam_lab_layout as layout
from dslab.sim.io.euroc_layout import origin_ns, to_ns
from dslab.sim.io.folders import Progress, new_directory, write_images
from dslab.sim.io.layout import DEPTH_PER_M
from dslab.sim.io.sidecars import write_sidecars
from dslab.sim.io.tum import CodedDepth
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import Sequence


def write_vslam_lab(
    sequence: Sequence, directory: Path, depth: bool = False, progress: Progress | None = None
) -> None:
    """Write a sequence as a VSLAM-LAB folder; frames without a true pose have none there.

    Args:
        sequence: what to write.
        directory: new or empty folder.
        depth: write depth images too; the sequence must have them.
        progress: called with step, frames done and frames in all.

    Raises:
        InputError: a stamp is negative; the folder is not empty or cannot be written, the disk is full;
            nothing is left behind.
    """
    if depth and sequence.depths is None:
        raise InputError(sequence.name, "has no depth images", "render it with depth")
    stamps = to_ns(sequence.stamps_s, origin_ns(sequence))
    if stamps[0] < 0:
        raise InputError(sequence.name, "has stamps below 0, which this form cannot hold", "use tum")
    names = [f"{frame:06d}.png" for frame in range(len(sequence))]
    columns: dict[str, list] = {
        layout.STAMP: stamps,
        layout.PATH: [f"{layout.IMAGES_DIR}/{name}" for name in names],
    }
    with new_directory(directory) as folder:
        (folder / layout.IMAGES_DIR).mkdir()
        images = [folder / layout.IMAGES_DIR / name for name in names]
        write_images(sequence.frames, images, "writing", progress)
        if depth and sequence.depths is not None:
            (folder / layout.DEPTH_DIR).mkdir()
            images = [folder / layout.DEPTH_DIR / name for name in names]
            write_images(CodedDepth(sequence.depths), images, "writing depth", progress)
            columns |= {layout.DEPTH_STAMP: stamps}
            columns |= {layout.DEPTH_PATH: [f"{layout.DEPTH_DIR}/{name}" for name in names]}
        rows = list(zip(*columns.values(), strict=True))
        (folder / layout.FRAMES_FILE).write_text(_table(list(columns), rows))
        (folder / layout.CALIBRATION_FILE).write_text(_calibration(sequence.camera, depth))
        (folder / layout.TRUTH_FILE).write_text(_truth(sequence, stamps))
        write_sidecars(sequence, folder)


def _table(header: list[str], rows: list[tuple]) -> str:
    return "".join(",".join(map(str, row)) + "\n" for row in [header, *rows])


def _calibration(camera: Intrinsics, depth: bool) -> str:
    """The text of calibration.yaml; the camera is its own body."""
    fields: dict[str, object] = {
        "cam_name": layout.IMAGES_DIR,
        "cam_type": "rgb+depth" if depth else "gray",
        **({"depth_name": layout.DEPTH_DIR} if depth else {}),
        "cam_model": "pinhole",
        "focal_length": [camera.fx, camera.fy],
        "principal_point": [camera.cx, camera.cy],
        **({"depth_factor": DEPTH_PER_M} if depth else {}),
    }
    if not camera.is_pinhole:
        fields["distortion_type"] = "radtan5" if camera.model == "radtan" else "equid4"
        fields["distortion_coefficients"] = list(camera.distortion)
    fields["image_dimension"] = [camera.width_px, camera.height_px]
    fields["fps"] = camera.fps
    fields["T_BS"] = np.eye(4).ravel().tolist()
    body = ",\n     ".join(f"{key}: {value}" for key, value in fields.items())
    return f"%YAML 1.2\n---\ncameras:\n  - {{{body}\n    }}\n"


def _truth(sequence: Sequence, stamps: list[int]) -> str:
    """The text of groundtruth.csv, its header only without ground truth."""
    poses = sequence.T_world_cam
    rows: list[tuple] = []
    if poses is not None:
        for frame in np.flatnonzero(np.isfinite(poses).all(axis=(1, 2))).tolist():
            quat_xyzw = Rotation.from_matrix(poses[frame, :3, :3]).as_quat(canonical=True)
            values = [f"{value:.9f}" for value in (*poses[frame, :3, 3], *quat_xyzw)]
            rows.append((stamps[frame], *values))
    return _table(layout.POSE_COLUMNS, rows)
