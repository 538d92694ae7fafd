"""Reader of the TUM-mono form: photometrically calibrated, rectified frame by frame.

    images/*.jpg or images.zip   gray images as taken
    times.txt                    id, stamp in seconds and, where known, exposure in milliseconds per frame
    camera.txt                   lens and rectification, see ``sim.io.fov_camera``
    pcalib.txt                   256 numbers: the light (any unit) behind each gray level
    vignette.png                 8 or 16 bit, the share of the light that reaches each pixel
    groundtruthSync.txt          stamp tx ty tz qx qy qz qw, nan outside motion capture

``pcalib.txt``, ``vignette.png`` and ``groundtruthSync.txt`` may be absent. Source: Engel, Usenko and
Cremers, "A photometrically calibrated benchmark for monocular visual odometry", 2016.
"""

from decimal import Decimal
from pathlib import Path

import cv2
import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import SETTINGS_BYTES, is_folder, is_given
from dslab.sim.io.camera_file import check_camera
from dslab.sim.io.clock import held_stamps
from dslab.sim.io.fov_camera import FovCamera, read_fov_camera
from dslab.sim.io.images import GrayFolder, GrayZip, numbered_images, read_raw
from dslab.sim.io.sidecars import check_exposure, read_sidecars
from dslab.sim.io.text import (
    check_frames,
    check_order,
    check_words,
    read_rows,
    to_decimal,
    to_frame_number,
    to_numbers,
)
from dslab.sim.io.truth import half_interval_s, read_tum_poses
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sequence import FrameSource, Sequence

IMAGES_DIR, IMAGES_ZIP = "images", "images.zip"
TIMES_FILE, CAMERA_FILE = "times.txt", "camera.txt"
RESPONSE_FILE, VIGNETTE_FILE, TRUTH_FILE = "pcalib.txt", "vignette.png", "groundtruthSync.txt"
_TIME_NAMES = ["id", "stamp", "exposure_ms"]
# A darker corner than this carries no information about its light.
_LEAST_VIGNETTE = 0.01


def load_tum_mono(folder: Path) -> Sequence:
    """Read a sequence from a TUM-mono folder; ``frame_truth`` holds known exposures.

    Frames are gray levels proportional to the light: the response is inverted, the vignette divided out,
    levels are limited to 255, and the image is rectified. Errors as of ``load_sequence``.
    """
    stamps, exposure_s = _read_times(folder / TIMES_FILE)
    stamps_s, stamps_ns = held_stamps(folder / TIMES_FILE, stamps)
    fps = 1 / float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else 30.0
    lens, camera = read_fov_camera(folder / CAMERA_FILE, fps)
    check_camera(folder / CAMERA_FILE, camera)
    shape = (lens.height_px, lens.width_px)
    raw = _open_images(folder, shape, len(stamps_s))
    frames = RectifiedFrames(
        raw,
        lens,
        camera,
        _read_response(folder / RESPONSE_FILE),
        _read_vignette(folder / VIGNETTE_FILE, shape),
    )
    frames[0]  # a wrong size shows in the first image already
    sidecars = read_sidecars(folder, len(stamps_s))
    if exposure_s is not None:
        sidecars["frame_truth"] = {**sidecars["frame_truth"], "exposure_s": exposure_s}
    tolerance_s = half_interval_s(stamps_s, fps)
    return Sequence(
        camera=camera,
        stamps_s=stamps_s,
        frames=frames,
        T_world_cam=read_tum_poses(folder / TRUTH_FILE, stamps_s, tolerance_s),
        depths=None,
        stamps_ns=stamps_ns,
        exposure_s=exposure_s if _light_is_known(folder, exposure_s) else None,
        **sidecars,
    )


def _light_is_known(folder: Path, exposure_s: np.ndarray | None) -> bool:
    """True if levels are proportional to exposures, as these and the response are given."""
    return exposure_s is not None and bool((exposure_s > 0).all()) and is_given(folder / RESPONSE_FILE)


class RectifiedFrames:
    """A ``FrameSource`` that corrects and rectifies the images of another.

    Args:
        raw: images as taken.
        lens: of those images.
        camera: pinhole camera of the result.
        response: (256,) float32 light behind each gray level, 0 to 255.
        vignette: (H, W) float32 share of the light that reaches each pixel, at most 1.
    """

    def __init__(
        self,
        raw: FrameSource,
        lens: FovCamera,
        camera: Intrinsics,
        response: np.ndarray,
        vignette: np.ndarray,
    ) -> None:
        self._raw, self._response = raw, response
        self._gain = 1 / np.maximum(vignette, np.float32(_LEAST_VIGNETTE))
        at = lens.project(np.stack(np.meshgrid(*camera.rays()), axis=-1))
        # The outermost pixels of a crop lie on the border, except for rounding.
        at = np.where(np.abs(at - np.rint(at)) < 1e-6, np.rint(at), at)
        self._map = at.astype(np.float32)

    def __len__(self) -> int:
        return len(self._raw)

    def __getitem__(self, index: int) -> np.ndarray:
        """(H, W) uint8; black where the image as taken does not reach."""
        light = cv2.LUT(self._raw[index], self._response) * self._gain
        rectified = cv2.remap(light, self._map, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        return np.clip(np.rint(rectified), 0, 255).astype(np.uint8)


def _read_times(path: Path) -> tuple[list[Decimal], np.ndarray | None]:
    """Read stamps, and (N,) exposures in seconds if the lines have them."""
    stamps: list[Decimal] = []
    exposures_ms: list[float] = []
    ids: list[int] = []
    names: list[str] = []
    for where, words in read_rows(path, "give a folder with `id stamp exposure_ms` per frame"):
        names = names or _TIME_NAMES[: max(2, min(len(words), 3))]
        check_words(where, words, names)
        _check_id(where, words[0], ids)
        stamp, own_ms = to_decimal(where, words[1]), to_numbers(where, words[2:], names[2:])
        check_order(where, stamps[-1:], stamp)
        for exposure_ms in own_ms:
            check_exposure(f"{where}: exposure_ms", exposure_ms / 1000)
        stamps.append(stamp)
        exposures_ms += own_ms
    check_frames(path, stamps)
    return stamps, np.array(exposures_ms) / 1000 if len(names) == len(_TIME_NAMES) else None


def _check_id(where: str, word: str, ids: list[int]) -> None:
    """Add the number of a frame to those before it. Raises InputError unless it follows them."""
    number = to_frame_number(f"{where}: id", word)
    if ids and number != ids[-1] + 1:
        raise InputError(f"{where}: id", f"{word} stands where {ids[-1] + 1} belongs", "copy the file again")
    ids.append(number)


def _open_images(folder: Path, shape: tuple[int, int], count: int) -> FrameSource:
    directory, archive = folder / IMAGES_DIR, folder / IMAGES_ZIP
    if is_folder(directory):
        paths = numbered_images(directory, (".jpg", ".png"))
        where, images = directory, GrayFolder(paths, shape, CAMERA_FILE)
    else:
        where, images = archive, GrayZip(archive, shape, CAMERA_FILE)
    if len(images) != count:
        problem = f"holds {len(images)} images, {TIMES_FILE} {count} stamps"
        raise InputError(str(where), problem, "copy the folder again, or cut it to the same frames")
    return images


def _read_response(path: Path) -> np.ndarray:
    """(256,) float32 light behind each level, 0 to 255; the level itself without the file."""
    if not is_given(path):
        return np.arange(256, dtype=np.float32)
    names = [f"level {level}" for level in range(256)]
    rows = list(read_rows(path, "", most_bytes=SETTINGS_BYTES))
    if len(rows) != 1 or len(rows[0][1]) != 256:
        count = sum(len(words) for _, words in rows)
        raise InputError(str(path), f"holds {count} numbers where 256 belong on one line", "copy it again")
    values = np.array(to_numbers(rows[0][0], rows[0][1], names))
    if not (np.diff(values) > 0).all():
        level = int(np.flatnonzero(np.diff(values) <= 0)[0]) + 1
        raise InputError(f"{rows[0][0]}: level {level}", "does not grow", "give a response that grows")
    return (255 * (values - values[0]) / (values[-1] - values[0])).astype(np.float32)


def _read_vignette(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) float32, the brightest pixel 1; 1 everywhere without the file."""
    if not is_given(path):
        return np.ones(shape, np.float32)
    image = read_raw(path, shape, CAMERA_FILE)
    if image.ndim != 2:
        raise InputError(str(path), "is no gray image", "give the vignette of this camera")
    if not image.any():
        raise InputError(str(path), "is black", "give the vignette of this camera")
    return image.astype(np.float32) / np.float32(image.max())
