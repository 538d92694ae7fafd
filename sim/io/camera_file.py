"""Reads and checks camera.yaml."""

import math
from pathlib import Path
from typing import Any

import yaml

from scenarios.errors import InputError
from sim.camera import Intrinsics
from sim.io.layout import CAMERA_KEYS, DISTORTION_KEYS


def read_camera(path: Path) -> Intrinsics:
    """The intrinsics of a camera.yaml.

    Raises:
        InputError: the file or a key is missing, or a value is impossible.
    """
    values = _read(path)
    unknown = [key for key in values if key not in CAMERA_KEYS + DISTORTION_KEYS]
    if unknown:
        keys = ", ".join(CAMERA_KEYS + DISTORTION_KEYS)
        raise InputError(f"{path}: {unknown[0]}", "unknown key", f"use {keys}")
    numbers = {key: _number(path, values, key) for key in CAMERA_KEYS}
    distortion = [_number(path, {key: 0.0, **values}, key) for key in DISTORTION_KEYS]
    for key in ("width", "height"):
        if not 16 <= numbers[key] <= 16384 or numbers[key] != int(numbers[key]):
            raise InputError(f"{path}: {key}", f"{numbers[key]:g} is no image size", "give whole pixels")
    for key in ("fx", "fy"):
        low, high = 0.1 * numbers["width"], 20 * numbers["width"]
        if not low <= numbers[key] <= high:
            remedy = f"give the focal length in pixels, {low:g} to {high:g}"
            raise InputError(f"{path}: {key}", f"{numbers[key]:g} is absurd for this image", remedy)
    for key, size in (("cx", numbers["width"]), ("cy", numbers["height"])):
        if not 0 <= numbers[key] <= size - 1:
            remedy = f"give the principal point in pixels, 0 to {size - 1:g}"
            raise InputError(f"{path}: {key}", f"{numbers[key]:g} lies outside the image", remedy)
    if not 0 < numbers["fps"] <= 1000:
        raise InputError(f"{path}: fps", f"{numbers['fps']:g} is no frame rate", "give frames per second")
    k1, k2, p1, p2, k3 = distortion
    return Intrinsics(
        width_px=int(numbers["width"]),
        height_px=int(numbers["height"]),
        fx=numbers["fx"],
        fy=numbers["fy"],
        cx=numbers["cx"],
        cy=numbers["cy"],
        fps=numbers["fps"],
        distortion=(k1, k2, p1, p2, k3),
    )


def _read(path: Path) -> dict[Any, Any]:
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        remedy = f"add it with the keys {', '.join(CAMERA_KEYS)}"
        raise InputError(str(path), "no such file", remedy) from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        raise InputError(str(path), "is no readable YAML", "correct it or copy it again") from None
    if not isinstance(values, dict):
        raise InputError(str(path), "holds no intrinsics", f"add the keys {', '.join(CAMERA_KEYS)}")
    return values


def _number(path: Path, values: dict[Any, Any], key: str) -> float:
    if key not in values:
        raise InputError(f"{path}: {key}", "is missing", "add it")
    try:
        number = math.nan if isinstance(values[key], bool) else float(values[key])
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{path}: {key}", f"{values[key]!r} is not a finite number", "correct it")
    return number
