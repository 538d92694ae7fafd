"""Video files, decoded once into the cache, with a camera.yaml from elsewhere."""

import os
import weakref
from collections.abc import Callable
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import file_digest, open_file
from dslab.sim.io.camera_file import check_camera, other_size, read_camera
from dslab.sim.io.decoding import decoded_once
from dslab.sim.io.raw import RawFrames
from dslab.sim.sequence import Sequence

if TYPE_CHECKING:
    from collections.abc import Iterator

    import cv2

SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mpg", ".mpeg")
"""Of the names of video files, in either case."""
_REMEDY = "give a video that FFmpeg decodes, or its images as a folder"
_MOST_FPS = 1000.0
# A container without a list of its frames gives their number by duration and mean rate.
_MOST_LACKING = 0.02


def is_video(path: str | Path) -> bool:
    """Return True for the name of a video file."""
    return str(path).lower().endswith(SUFFIXES)


def load_video(
    path: Path,
    camera_file: Path,
    cache_dir: Path | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    force: bool = False,
) -> Sequence:
    """Read a video, gray, with the times that it gives its frames.

    Args:
        path: the file.
        camera_file: a camera.yaml, or another calibration; see ``read_camera``. Its rate counts only if the
            video has no times.
        cache_dir: folder of the cache; None for the default one.
        progress: called with (step, frames done, frames in all) while decoding.
        force: begin even if the frames seem too many for the disk, or some cannot be decoded.

    Raises:
        InputError: the camera or the video cannot be read, the video has no frame or frames of another size
            than the camera, there is no room for them.
    """
    width, height, fps, count = _properties(path)
    camera = read_camera(camera_file, (width, height), fps)
    size = (camera.height_px, camera.width_px)
    if size != (height, width):
        raise other_size(str(path), (width, height), size, str(camera_file))

    def stamps_of_all() -> np.ndarray:
        stamps_s = _read_stamps(path, camera.fps)
        if len(stamps_s) < (1 - _MOST_LACKING) * count - 1 and not force:
            problem = f"{len(stamps_s)} of its {count} frames can be decoded"
            raise InputError(str(path), problem, "copy it again; --force takes what there is")
        return stamps_s

    content = {"video": file_digest(path).hex(), "size": size, "fps": camera.fps}
    frames_of = partial(_frames, path, size)
    stamps_s, frames = decoded_once(path, content, size, stamps_of_all, frames_of, cache_dir, progress, force)
    if len(stamps_s) > 1:
        # Stamps of a video are rounded.
        camera = replace(camera, fps=round(1 / float(np.median(np.diff(stamps_s))), 4))
        check_camera(path, camera)
    return Sequence(
        name=path.stem,
        camera=camera,
        stamps_s=stamps_s,
        frames=_VideoFrames(path, frames),
        T_world_cam=None,
        depths=None,
        segments=(),
        meta={},
    )


class _VideoFrames:
    """A ``FrameSource`` of gray frames from the cache; those in colour are decoded anew, best in order."""

    def __init__(self, path: Path, grays: RawFrames) -> None:
        self._path, self._grays = path, grays
        self._files, self._next = ExitStack(), 0
        self._video: cv2.VideoCapture | None = None
        weakref.finalize(self, self._files.close)

    def __len__(self) -> int:
        return len(self._grays)

    def __getitem__(self, index: int) -> np.ndarray:
        return self._grays[index]

    def colour(self, index: int) -> np.ndarray:
        """See ``colour_frame``. Raises InputError if it cannot be decoded."""
        if self._video is None or index < self._next:
            self._files.close()
            self._video, self._next = self._files.enter_context(_opened(self._path)), 0
        while self._next < index and self._video.grab():
            self._next += 1
        done, image = self._video.read()
        self._next += 1
        if not done:
            raise InputError(f"{self._path}: frame {index}", "cannot be decoded", _REMEDY)
        return np.asarray(image) if image.ndim == 3 else self[index]


def _properties(path: Path) -> tuple[int, int, float | None, int]:
    """Width, height, frame rate, None if the file does not say it, and number of frames, 0 likewise."""
    import cv2

    open_file(path).close()
    with _opened(path) as video:
        names = ("FRAME_WIDTH", "FRAME_HEIGHT", "FPS", "FRAME_COUNT")
        width, height, fps, count = (video.get(getattr(cv2, f"CAP_PROP_{name}")) for name in names)
    return int(width), int(height), fps if 0 < fps < _MOST_FPS else None, max(0, int(count))


def _read_stamps(path: Path, fps: float) -> np.ndarray:
    """(N,) times of the frames, seconds; by the rate where the video's own do not increase."""
    import cv2

    with _opened(path) as video:
        stamps_ms: list[float] = []
        while video.grab():
            stamps_ms.append(video.get(cv2.CAP_PROP_POS_MSEC))
    if not stamps_ms:
        raise InputError(str(path), "holds no frame", _REMEDY)
    stamps_s = np.array(stamps_ms) / 1000
    return stamps_s if (np.diff(stamps_s) > 0).all() else np.arange(len(stamps_s)) / fps


def _frames(path: Path, size: tuple[int, int], count: int) -> "Iterator[np.ndarray]":
    """The gray frames of a video."""
    import cv2

    with _opened(path) as video:
        for index in range(count):
            done, image = video.read()
            if not done or image.shape[:2] != size:
                raise InputError(f"{path}: frame {index}", "cannot be decoded", _REMEDY)
            yield image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


@contextmanager
def _opened(path: Path) -> "Iterator[cv2.VideoCapture]":
    # What OpenCV and FFmpeg print of a broken file would stand beside the one line.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    import cv2

    logging = cv2.utils.logging
    level = logging.setLogLevel(logging.LOG_LEVEL_ERROR)
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        if not video.isOpened():
            raise InputError(str(path), "is no readable video", _REMEDY)
        # The intrinsics are those of the frames as they are stored.
        video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        yield video
    finally:
        video.release()
        logging.setLogLevel(level)
