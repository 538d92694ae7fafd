"""The FOV (ATAN) camera of TUM-mono's camera.txt, and its rectification.

    fx fy cx cy omega      relative to width and height of the images as taken
    1280 1024              their size
    crop                   or `fx fy cx cy 0`, relative to the size below
    640 480                size of the rectified images

Source: Devernay and Faugeras, "Straight lines have to be straight", 2001 (the model); Engel, Usenko and
Cremers, "A photometrically calibrated benchmark for monocular visual odometry", 2016 (the file).
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import SETTINGS_BYTES
from dslab.sim.io.camera_file import check_size
from dslab.sim.io.text import check_words, read_rows, to_numbers
from dslab.sim.sensors.camera import Intrinsics

_LENS_NAMES = ["fx", "fy", "cx", "cy", "omega"]
_SIZE_NAMES = ["width", "height"]
# A pinhole image of a wider lens than this would be absurdly large.
_MOST_HALF_ANGLE_DEG = 80.0


@dataclass(frozen=True)
class FovCamera:
    """A camera whose image radius grows with the angle of the ray, by one parameter.

    Attributes:
        width_px, height_px: size of the images as taken.
        fx, fy, cx, cy: pixels; integer pixel coordinates are pixel centres.
        omega: the lens's own field of view, radians; 0 is a pinhole.
    """

    width_px: int
    height_px: int
    fx: float
    fy: float
    cx: float
    cy: float
    omega: float

    def project(self, rays: np.ndarray) -> np.ndarray:
        """(..., 2) pixels of (..., 2) rays at unit depth."""
        radius = np.linalg.norm(rays, axis=-1, keepdims=True)
        shrink = np.ones_like(radius)
        if self.omega:
            spread = 2 * math.tan(self.omega / 2)
            bent = np.arctan(radius * spread) / self.omega
            shrink = np.divide(
                bent, radius, out=np.full_like(radius, spread / self.omega), where=radius > 1e-9
            )
        return rays * shrink * (self.fx, self.fy) + (self.cx, self.cy)

    def unproject(self, xy: np.ndarray) -> np.ndarray:
        """(..., 2) rays at unit depth of (..., 2) pixels."""
        bent = (xy - (self.cx, self.cy)) / (self.fx, self.fy)
        radius = np.linalg.norm(bent, axis=-1, keepdims=True)
        if not self.omega:
            return bent
        spread = 2 * math.tan(self.omega / 2)
        straight = np.tan(radius * self.omega) / spread
        return bent * np.divide(
            straight, radius, out=np.full_like(radius, self.omega / spread), where=radius > 1e-9
        )

    def cropped(self, width_px: int, height_px: int, fps: float) -> Intrinsics:
        """The pinhole camera of the largest upright rectangle that the image fills.

        The border bends outward from the middle of each side, so that the middles bound the rectangle.
        """
        x, y = np.arange(self.width_px, dtype=float), np.arange(self.height_px, dtype=float)
        left, right = (self.unproject(np.stack([np.full_like(y, end), y], -1))[:, 0] for end in (0, x[-1]))
        top, bottom = (self.unproject(np.stack([x, np.full_like(x, end)], -1))[:, 1] for end in (0, y[-1]))
        low = np.array([left.max(), top.max()])
        high = np.array([right.min(), bottom.min()])
        fx, fy = (np.array([width_px, height_px]) - 1) / (high - low)
        return Intrinsics(
            width_px, height_px, float(fx), float(fy), float(-low[0] * fx), float(-low[1] * fy), fps
        )


def read_fov_camera(path: Path, fps: float) -> tuple[FovCamera, Intrinsics]:
    """Read the lens of a camera.txt and the pinhole camera of its rectified images.

    Args:
        path: the file.
        fps: frame rate, which the file does not give.

    Raises:
        InputError: the file is missing, of another kind, or a value is impossible.
    """
    remedy = "add it with lens, size, `crop`, and size of the result"
    rows = list(read_rows(path, remedy, most_bytes=SETTINGS_BYTES))
    if len(rows) != 4:
        remedy = "write lens, size, `crop` or a rectification, and size of the result"
        raise InputError(str(path), f"has {len(rows)} lines where 4 belong", remedy)
    (lens_at, lens), (size_at, size), (mode_at, mode), (out_at, out) = rows
    if lens[0].upper() in ("FOV", "ATAN"):
        lens = lens[1:]
    check_words(lens_at, lens, _LENS_NAMES)
    fx, fy, cx, cy, omega = to_numbers(lens_at, lens, _LENS_NAMES)
    width, height = _size(size_at, size)
    if not (_is_focal_share(fx) and _is_focal_share(fy) and 0 < cx < 1 and 0 < cy < 1):
        problem = "fx fy cx cy are no shares of the image"
        raise InputError(lens_at, problem, "give them relative to width and height")
    # The file's coordinates have their origin at the corner of the first pixel.
    camera = FovCamera(width, height, fx * width, fy * height, cx * width - 0.5, cy * height - 0.5, omega)
    reach = math.hypot(max(cx, 1 - cx) / fx, max(cy, 1 - cy) / fy)
    sees_deg = math.degrees(_half_angle(reach, omega))
    if omega < 0 or omega >= math.pi or not sees_deg < _MOST_HALF_ANGLE_DEG:
        problem = f"{omega:g} makes the image's corner {sees_deg:.0f} degrees off the axis"
        remedy = f"give a lens of less than {_MOST_HALF_ANGLE_DEG:g} degrees to the side"
        raise InputError(f"{lens_at}: omega", problem, remedy)
    out_width, out_height = _size(out_at, out)
    if mode == ["crop"]:
        return camera, camera.cropped(out_width, out_height, fps)
    if len(mode) != len(_LENS_NAMES):
        remedy = "write `crop` or `fx fy cx cy 0`"
        raise InputError(mode_at, f"{' '.join(mode)!r} is no rectification that is supported", remedy)
    fx, fy, cx, cy, _ = to_numbers(mode_at, mode, _LENS_NAMES)
    if not (_is_focal_share(fx) and _is_focal_share(fy) and 0 < cx < 1 and 0 < cy < 1):
        raise InputError(mode_at, "fx fy cx cy are no shares of the image", "give them relative to the size")
    ideal = Intrinsics(
        out_width,
        out_height,
        fx * out_width,
        fy * out_height,
        cx * out_width - 0.5,
        cy * out_height - 0.5,
        fps,
    )
    return camera, ideal


def _is_focal_share(focal: float) -> bool:
    """Return True for a focal length that can be one, relative to the image."""
    return 0.01 < focal < 100


def _half_angle(bent: float, omega: float) -> float:
    """Angle off the axis, radians, at a distorted radius; pi beyond the lens's range."""
    if omega <= 0 or bent * omega >= math.pi / 2:
        return math.atan(bent) if omega == 0 else math.pi
    return math.atan(math.tan(bent * omega) / (2 * math.tan(omega / 2)))


def _size(where: str, words: list[str]) -> tuple[int, int]:
    check_words(where, words, _SIZE_NAMES)
    width, height = to_numbers(where, words, _SIZE_NAMES)
    for name, size in (("width", width), ("height", height)):
        if size != int(size):
            raise InputError(f"{where}: {name}", f"{size:g} is no image size", "give whole pixels")
    check_size(where, int(width), int(height))
    return int(width), int(height)
