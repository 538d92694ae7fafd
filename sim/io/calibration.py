"""What a calibration says of a camera: fields whose faults name their place, lenses by any name."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dslab.scenarios.errors import InputError
from dslab.sim.io.text import number_at, numbers_at
from dslab.sim.sensors.camera import DISTORTION_KEYS, LensModel

_NAMES: dict[LensModel, str] = {
    "radtan": "radtan radialtangential plumbbob brown opencv perspective none pinhole simplepinhole "
    "rectified undistorted radial simpleradial",
    "rational": "rational rationalpolynomial fullopencv",
    "equidistant": "equidistant equi fisheye opencvfisheye kannalabrandt kannalabrandt8",
}
_LENSES: dict[str, LensModel] = {name: model for model, names in _NAMES.items() for name in names.split()}
_OTHER_LENSES = {
    **dict.fromkeys(("mei", "omni", "omnidirectional", "unified", "omniradtan"), "the unified (MEI) model"),
    **dict.fromkeys(("ds", "doublesphere"), "the double sphere model"),
    "eucm": "the extended unified model",
    "scaramuzza": "Scaramuzza's model",
    "equirectangular": "a panorama",
    "radialdivision": "the division model",
    "thinprismfisheye": "the thin prism model",
}
CORNER = 0.5
"""Coordinate of the first pixel's centre where its corner is the origin."""


@dataclass(frozen=True)
class Calibration:
    """What a file says of a camera; None where it says nothing.

    Attributes:
        form: what wrote the file.
        focal_px: fx, fy.
        centre_px: principal point; integer coordinates are pixel centres.
        model, distortion: the lens, as of ``Intrinsics``.
        size_px: width, height.
        fps: frame rate.
        note: what was changed in reading, for the user.
    """

    form: str
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    model: LensModel = "radtan"
    distortion: tuple[float, ...] = (0.0,) * 5
    size_px: tuple[int, int] | None = None
    fps: float | None = None
    note: str = ""


@dataclass(frozen=True)
class Fields:
    """A mapping of a file, whose faults name their place."""

    where: str
    data: Mapping[Any, Any] = field(repr=False)

    def key(self, *names: str) -> str:
        """The first of some names that is there. Raises InputError if none is."""
        found = [name for name in names if name in self.data]
        if not found:
            raise InputError(f"{self.where}: {names[0]}", "is missing", "add it")
        return found[0]

    def number(self, *names: str) -> float:
        """The number under the first of some names that is there."""
        return number_at(self.where, dict(self.data), self.key(*names))

    def maybe(self, *names: str) -> float | None:
        """The same, None if it is missing."""
        return self.number(*names) if any(name in self.data for name in names) else None

    def numbers(self, *names: str, lengths: tuple[int, ...]) -> list[float]:
        """A list, or the data of a matrix."""
        key = self.key(*names)
        value = self.data[key]
        if isinstance(value, Mapping):
            return numbers_at(f"{self.where}: {key}", dict(value), "data", lengths)
        if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
            value = [number for row in value for number in row]
        return numbers_at(self.where, {key: value}, key, lengths)

    def part(self, name: str) -> "Fields":
        """A mapping inside."""
        inside = self.data.get(name)
        if not isinstance(inside, Mapping):
            raise InputError(f"{self.where}: {name}", "is missing", "add it")
        return Fields(f"{self.where}: {name}", inside)

    def word(self, *names: str, default: str | None = None) -> str:
        """A text; the default if it is missing. Raises InputError for anything else, or without a default."""
        if default is not None and not any(name in self.data for name in names):
            return default
        key = self.key(*names)
        if not isinstance(self.data[key], str):
            raise InputError(f"{self.where}: {key}", f"{self.data[key]!r} is no name", "write a name")
        return self.data[key]

    def size(self, *names: tuple[str, str]) -> tuple[int, int] | None:
        """Width and height under the first pair of names that is there; None without one."""
        for wide, high in names:
            if wide in self.data and high in self.data:
                return whole(self.where, self.number(wide), self.number(high))
        return None

    def matrix(self, *names: str) -> dict[str, tuple[float, float]]:
        """Focal lengths and centre of a camera matrix."""
        fx, skew, cx, *rest = self.numbers(*names, lengths=(9,))
        if skew or rest[0] or rest[3:] != [0, 0, 1]:
            raise InputError(
                f"{self.where}: {self.key(*names)}", "is no camera matrix", "write fx 0 cx 0 fy cy 0 0 1"
            )
        return {"focal_px": (fx, rest[1]), "centre_px": (cx, rest[2])}


def lens_model(where: str, name: str) -> LensModel:
    """The model of a name in any spelling. Raises InputError for one that is not supported."""
    plain = re.sub(r"[^a-z0-9]", "", name.lower())
    if plain in _OTHER_LENSES:
        remedy = "calibrate the camera as radtan or equidistant, or rectify the images"
        raise InputError(where, f"{name!r}, {_OTHER_LENSES[plain]}, is not supported", remedy)
    if plain not in _LENSES:
        raise InputError(where, f"{name!r} is no known lens model", f"use {', '.join(DISTORTION_KEYS)}")
    return _LENSES[plain]


def lens_of(where: str, model: LensModel, given: list[float]) -> dict[str, Any]:
    """The lens by as many coefficients as it has; more than five of radtan are the rational model's."""
    if model == "radtan" and len(given) > 5:
        if any(given[8:]):
            problem = f"{len(given)} coefficients, with a thin prism or a tilt, are not supported"
            raise InputError(where, problem, "calibrate with at most eight")
        given = given[:8]
        model = "rational" if any(given[5:]) else "radtan"
        given = given if model == "rational" else given[:5]
    count = len(DISTORTION_KEYS[model])
    if len(given) > count:
        raise InputError(where, f"{len(given)} coefficients are too many for {model}", f"give {count}")
    return {"model": model, "distortion": (*given, *[0.0] * (count - len(given)))}


def fov_lens(
    focal_px: tuple[float, float], centre_px: tuple[float, float], size_px: tuple[int, int], omega: float
) -> dict[str, Any]:
    """The equidistant lens that agrees best with a FOV (ATAN) lens over an image, with a note of the error.

    A ray at angle t from the axis appears at radius atan(2 tan(omega / 2) tan t) / omega, an odd and smooth
    function of t, as the equidistant model's polynomial is.

    Source: Devernay and Faugeras, "Straight lines have to be straight", 2001, Sec. 2.3.
    """
    if abs(omega) < 1e-6:
        return {"focal_px": focal_px, "centre_px": centre_px}
    corner = np.maximum(centre_px, np.subtract(size_px, centre_px)) / focal_px
    spread = 2 * math.tan(omega / 2)
    # At a radius of pi / 2 over omega the ray is at right angles to the axis.
    bent = min(float(np.hypot(*corner)) * omega, math.radians(89))
    t = np.linspace(0, math.atan(math.tan(bent) / spread), 400)[1:]
    radius, slope = np.arctan(spread * np.tan(t)) / omega, spread / omega
    powers = slope * t[:, None] ** np.array([3, 5, 7, 9])
    k = np.linalg.lstsq(powers, radius - slope * t, rcond=None)[0]
    error_px = float(np.abs(powers @ k + slope * t - radius).max() * max(focal_px))
    return {
        "focal_px": (focal_px[0] * slope, focal_px[1] * slope),
        "centre_px": centre_px,
        "model": "equidistant",
        "distortion": tuple(map(float, k)),
        "note": f"FOV lens as the equidistant one that agrees to {error_px:.2g} px",
    }


def chosen(where: str, name: str, names: list[str], alone: bool = False) -> str:
    """The camera of a name, or the first. Raises InputError if there is none, or the choice is open."""
    if name in names:
        return name
    shown = ", ".join(map(str, names)) or "none"
    if name:
        raise InputError(where, f"holds no camera {name!r}", f"it has {shown}")
    if not names or (alone and len(names) > 1):
        raise InputError(
            where,
            f"holds {len(names)} cameras",
            f"add one of {shown} to its name: {where}:{shown.split(',')[0]}",
        )
    return names[0]


def whole(where: str, width: float, height: float) -> tuple[int, int]:
    """A size in whole pixels. Raises InputError for any other."""
    if width != int(width) or height != int(height):
        raise InputError(where, f"{width:g}x{height:g} is no image size", "give whole pixels")
    return int(width), int(height)


def is_number(word: str) -> bool:
    """True for the word of a decimal number."""
    return bool(re.fullmatch(r"[-+]?[\d.]+([eE][-+]?\d+)?", word))
