"""Writer of TUM-form folders, all or nothing."""

from pathlib import Path

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.sim.io import layout
from dslab.sim.io.camera_file import write_camera
from dslab.sim.io.folders import Progress, new_directory, write_images
from dslab.sim.io.sidecars import write_sidecars
from dslab.sim.io.truth import tum_poses_text
from dslab.sim.sequence import FrameSource, Sequence


def write_tum(
    sequence: Sequence,
    directory: Path,
    depth: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write a sequence as a TUM-form folder; see ``sim.io.layout``.

    Args:
        sequence: what to write.
        directory: new or empty folder.
        depth: write depth images too; the sequence must have them.
        progress: called with step, frames done and frames in all.

    Raises:
        InputError: the folder is not empty or cannot be written, the disk is full; nothing is left behind.
    """
    if depth and sequence.depths is None:
        raise InputError(sequence.name, "has no depth images", "render it with depth")
    with new_directory(directory) as folder:
        write_camera(sequence.camera, folder / layout.CAMERA_FILE)
        if sequence.T_world_cam is not None:
            text = tum_poses_text(sequence.stamps_s, sequence.T_world_cam)
            (folder / layout.TRUTH_FILE).write_text(text)
        write_sidecars(sequence, folder)
        _write_list(sequence, folder, "rgb", layout.FRAMES_FILE, sequence.frames, progress)
        if depth and sequence.depths is not None:
            coded = CodedDepth(sequence.depths)
            _write_list(sequence, folder, "depth", layout.DEPTH_FILE, coded, progress)


class CodedDepth:
    """Depth as 16-bit images; depth out of range becomes unknown."""

    def __init__(self, depths: FrameSource) -> None:
        self._depths = depths

    def __len__(self) -> int:
        return len(self._depths)

    def __getitem__(self, index: int) -> np.ndarray:
        code = np.rint(self._depths[index] * layout.DEPTH_PER_M)
        return np.where(code <= 65535, code, 0).astype(np.uint16)


def _write_list(
    sequence: Sequence,
    folder: Path,
    name: str,
    list_file: str,
    images: FrameSource,
    progress: Progress | None,
) -> None:
    (folder / name).mkdir()
    paths = [f"{name}/{frame:06d}.png" for frame in range(len(sequence))]
    write_images(images, [folder / path for path in paths], f"writing {name}", progress)
    lines = [f"{stamp_s:.9f} {path}" for stamp_s, path in zip(sequence.stamps_s, paths, strict=True)]
    (folder / list_file).write_text("\n".join(["# stamp_s filename", *lines]) + "\n")
