"""The file camera.yaml: reading, checking and writing."""

from pathlib import Path
from typing import Any

import yaml

from dslab.scenarios.errors import InputError
from dslab.scenarios.lenses import lens_fault, sees_too_far
from dslab.scenarios.yaml_file import read_yaml
from dslab.sim.io.calibration import Calibration
from dslab.sim.io.calibrations import KNOWN, read_calibration, split_name
from dslab.sim.io.layout import CAMERA_KEYS
from dslab.sim.io.text import number_at, numbers_at
from dslab.sim.sensors.camera import DISTORTION_KEYS, LEAST_SIDE_PX, MOST_PIXELS, MOST_SIDE_PX, Intrinsics

_LEAST_FOCAL_SHARE, _MOST_FOCAL_SHARE = 0.1, 20


def read_camera(path: Path, size_px: tuple[int, int] | None = None, fps: float | None = None) -> Intrinsics:
    """Read the intrinsics of a camera.yaml or of any form that ``sim.io.calibrations`` knows.

    Args:
        path: the file; ``FILE:NAME`` for one of several cameras.
        size_px: of the images, if the file does not say it.
        fps: frame rate, if the file does not say it.

    Raises:
        InputError: the file or a key is missing, or a value is impossible.
    """
    return camera_and_form(path, size_px, fps)[0]


def camera_and_form(
    path: Path, size_px: tuple[int, int] | None = None, fps: float | None = None
) -> tuple[Intrinsics, str]:
    """As ``read_camera``, and what the file was read as."""
    file, name = split_name(path)
    found = read_calibration(file, name)
    if found is None:
        return _own_camera(file), "camera.yaml"
    return intrinsics_of(
        found, path, size_px, fps
    ), f"{found.form}; {found.note}" if found.note else found.form


def intrinsics_of(
    found: Calibration, path: Path, size_px: tuple[int, int] | None = None, fps: float | None = None
) -> Intrinsics:
    """The checked intrinsics of a calibration. Arguments and errors as of ``read_camera``."""
    size_px, fps = found.size_px or size_px, found.fps or fps
    if size_px is None or fps is None:
        key, option = ("fps", "--fps 30") if size_px else ("size", "--size 640x480")
        remedy = f"write `dslab camera {path} {option} > camera.yaml` and give that file"
        raise InputError(f"{path}: {key}", f"a file of the form {found.form} has none", remedy)
    camera = Intrinsics(*size_px, *found.focal_px, *found.centre_px, fps, found.distortion, found.model)
    check_camera(path, camera)
    return camera


def _own_camera(path: Path) -> Intrinsics:
    """The intrinsics of a camera.yaml; ``model`` defaults to radtan."""
    example = f"the keys {', '.join(CAMERA_KEYS)}"
    values = dict(read_yaml(path, "intrinsics", example, f"add it with {example}").data)
    if not set(CAMERA_KEYS) & set(values):
        raise InputError(str(path), "is no calibration of a known form", f"give one of: {KNOWN}")
    model = values.pop("model", "radtan")
    if not isinstance(model, str) or model not in DISTORTION_KEYS:
        models = " or ".join(DISTORTION_KEYS)
        raise InputError(f"{path}: model", f"{model!r} is no lens model", f"use {models}")
    keys = CAMERA_KEYS + DISTORTION_KEYS[model]
    unknown = [key for key in values if key not in keys]
    if unknown:
        raise InputError(
            f"{path}: {unknown[0]}", f"unknown key of the model {model}", f"use {', '.join(keys)}"
        )
    numbers = {key: number_at(path, values, key) for key in CAMERA_KEYS}
    for key in ("width", "height"):
        if numbers[key] != int(numbers[key]):
            raise InputError(f"{path}: {key}", f"{numbers[key]:g} is no image size", "give whole pixels")
    camera = Intrinsics(
        width_px=int(numbers["width"]),
        height_px=int(numbers["height"]),
        fx=numbers["fx"],
        fy=numbers["fy"],
        cx=numbers["cx"],
        cy=numbers["cy"],
        fps=numbers["fps"],
        distortion=tuple(number_at(path, {key: 0.0, **values}, key) for key in DISTORTION_KEYS[model]),
        model=model,
    )
    check_camera(path, camera)
    return camera


def check_camera(path: Path, camera: Intrinsics) -> None:
    """Raise InputError if size, focal length, centre, lens or frame rate are impossible."""
    check_size(str(path), camera.width_px, camera.height_px)
    for key, focal in (("fx", camera.fx), ("fy", camera.fy)):
        low, high = _LEAST_FOCAL_SHARE * camera.width_px, _MOST_FOCAL_SHARE * camera.width_px
        if not low <= focal <= high:
            remedy = f"give the focal length in pixels, {low:g} to {high:g}"
            raise InputError(f"{path}: {key}", f"{focal:g} is absurd for this image", remedy)
    for key, centre, size in (("cx", camera.cx, camera.width_px), ("cy", camera.cy, camera.height_px)):
        if not 0 <= centre <= size - 1:
            remedy = f"give the principal point in pixels, 0 to {size - 1:g}"
            raise InputError(f"{path}: {key}", f"{centre:g} lies outside the image", remedy)
    if not 1e-3 <= camera.fps <= 1000:
        raise InputError(f"{path}: fps", f"{camera.fps:g} is no frame rate", "give frames per second")
    lens = (camera.size_px, camera.focal_px, camera.centre_px, camera.model, camera.distortion)
    # Of images that reach further, the middle is taken: see ``sim.io.wide_lens``.
    if not camera.is_pinhole and not sees_too_far(*lens) and (fault := lens_fault(*lens)):
        raise InputError(f"{path}: distortion", *fault)


def whole_size(where: str, values: dict[Any, Any], key: str) -> tuple[int, int]:
    """Width and height under a key of a YAML file. Raises InputError unless they are whole numbers."""
    width, height = numbers_at(where, values, key, (2,))
    if any(size != int(size) for size in (width, height)):
        raise InputError(f"{where}: {key}", f"{width:g}x{height:g} is no image size", "give whole pixels")
    return int(width), int(height)


def check_size(where: str, width_px: int, height_px: int) -> None:
    """Raise InputError for an image too small for the SLAM, or absurdly large."""
    for name, side in (("width", width_px), ("height", height_px)):
        if not LEAST_SIDE_PX <= side <= MOST_SIDE_PX:
            remedy = f"give images of {LEAST_SIDE_PX} to {MOST_SIDE_PX} pixels a side"
            raise InputError(f"{where}: {name}", f"the SLAM takes no image of {side} pixels", remedy)
    if width_px * height_px > MOST_PIXELS:
        problem = f"{width_px}x{height_px} is more than {MOST_PIXELS / 1e6:.0f} million pixels"
        raise InputError(f"{where}: width", problem, "give smaller images")


def other_size(where: str, size: tuple[int, int], shape: tuple[int, int], authority: str) -> InputError:
    """The fault of an image of a (width, height) that is not the (H, W) of its camera's file."""
    problem = f"is {size[0]}x{size[1]} pixels, {authority} says {shape[1]}x{shape[0]}"
    remedy = (
        f"give the calibration of this size: `dslab camera {authority} --scale {size[0]}x{size[1]}` scales it"
    )
    return InputError(where, problem, remedy)


def write_camera(camera: Intrinsics, path: Path) -> None:
    """Write a camera.yaml that ``read_camera`` reads back exactly."""
    path.write_text(camera_text(camera))


def camera_text(camera: Intrinsics) -> str:
    """The content of a camera.yaml."""
    record: dict[str, Any] = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
    record |= {"width": camera.width_px, "height": camera.height_px, "fps": camera.fps}
    if camera.model != "radtan":
        record["model"] = camera.model
    record |= dict(zip(DISTORTION_KEYS[camera.model], camera.distortion, strict=True))
    return yaml.safe_dump(record, sort_keys=False)
