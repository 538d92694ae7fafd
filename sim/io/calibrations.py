"""Calibration files as people have them, each read to one camera.

OpenCV, ROS, Kalibr, EuRoC, ORB-SLAM, stella_vslam and VINS count pixels from the centre of the first one, as
the lab does; nerfstudio from its corner.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import SETTINGS_BYTES, is_given, read_json, read_text
from dslab.scenarios.yaml_file import read_yaml
from dslab.sim.io.calibration import CORNER, Calibration, Fields, chosen, fov_lens, lens_model, lens_of, whole
from dslab.sim.io.calibration_tables import TABLES
from dslab.sim.sensors.camera import DISTORTION_KEYS, LensModel

KNOWN = (
    "camera.yaml of the lab, OpenCV's FileStorage, ROS camera_info, Kalibr's camchain, settings of ORB-SLAM, "
    "stella_vslam or VINS, COLMAP's cameras.txt, transforms.json, DSO's camera.txt, EuRoC's sensor.yaml, "
    "KITTI's calib.txt"
)


def split_name(text: str | Path) -> tuple[Path, str]:
    """Path and name of a camera in it: ``calib.txt:P2``; the name is empty without a suffix."""
    path, colon, name = str(text).rpartition(":")
    if colon and not is_given(text) and is_given(path):
        return Path(path), name
    return Path(text), ""


def read_calibration(path: Path, name: str = "") -> Calibration | None:
    """Read a file of any known form but the lab's own.

    Args:
        path: the file.
        name: of the camera in it, where it holds several.

    Returns:
        None for a file of the lab's own form, or of none.

    Raises:
        InputError: the file cannot be read, has no known form, or a lens that is not supported.
    """
    text = read_text(path, SETTINGS_BYTES, f"give a calibration: {KNOWN}")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    for is_form, read in TABLES:
        if is_form(lines):
            return read(path, name)
    fields = Fields(str(path), _mapping(path, text))
    for form, mark, reader in _FORMS:
        if mark(fields.data):
            return replace(reader(fields, name), form=form)
    return None


def _mapping(path: Path, text: str) -> Mapping[Any, Any]:
    start = text.lstrip("\ufeff \t\r\n")[:1]
    if start == "<":
        return _xml(path, text)
    if start == "{" and path.suffix == ".json":
        return read_json(path, dict)
    return read_yaml(path, "calibration", KNOWN).data


def _xml(path: Path, text: str) -> Mapping[Any, Any]:
    """The content of OpenCV's XML as that of its YAML."""
    if "<!" in text.replace("<!--", ""):
        raise InputError(str(path), "is XML with a document type", "give XML as OpenCV writes it")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(str(path), f"is not valid XML ({error})", "correct it, or write it again") from None

    def value(element: ElementTree.Element) -> Any:
        inside = list(element)
        if inside:
            return {child.tag: value(child) for child in inside}
        words = (element.text or "").split()
        return words if element.tag == "data" else " ".join(words)

    content = value(root)
    if root.tag != "opencv_storage" or not isinstance(content, dict):
        raise InputError(str(path), "is no XML of OpenCV", f"give one of: {KNOWN}")
    return content


def _opencv(fields: Fields, name: str) -> Calibration:
    given = (
        fields.numbers(*_DISTORTION, lengths=(0, 4, 5, 8, 12, 14)) if _has(fields.data, _DISTORTION) else []
    )
    fisheye = fields.maybe("fisheye_model", "fisheye")
    lens = lens_of(f"{fields.where}: distortion", "equidistant" if fisheye else "radtan", given)
    size = fields.size(*_SIZES)
    return Calibration("", **fields.matrix(*_MATRIX), **lens, size_px=size, fps=fields.maybe("fps"))


def camera_info(fields: Fields, name: str = "") -> Calibration:
    """The camera of a ROS message, as a mapping of its fields."""
    lens = lens_model(
        f"{fields.where}: distortion_model", fields.word("distortion_model", default="plumb_bob")
    )
    given = fields.numbers("distortion_coefficients", "D", "d", lengths=(0, 4, 5, 8, 12, 14))
    return Calibration(
        "",
        **fields.matrix("camera_matrix", "K", "k"),
        **lens_of(f"{fields.where}: D", lens, given),
        size_px=fields.size(("image_width", "image_height"), ("width", "height")),
    )


def _kalibr(fields: Fields, name: str) -> Calibration:
    camera = fields.part(chosen(fields.where, name, [k for k in fields.data if str(k).startswith("cam")]))
    lens_model(f"{camera.where}: camera_model", camera.word("camera_model", default="pinhole"))
    fx, fy, cx, cy = camera.numbers("intrinsics", lengths=(4,))
    size = whole(camera.where, *camera.numbers("resolution", lengths=(2,)))
    lens = camera.word("distortion_model", default="none")
    if lens == "fov":
        (omega,) = camera.numbers("distortion_coeffs", lengths=(1,))
        return Calibration("", **fov_lens((fx, fy), (cx, cy), size, omega), size_px=size)
    given = [] if lens == "none" else camera.numbers("distortion_coeffs", lengths=(0, 4, 5, 8))
    model = lens_model(f"{camera.where}: distortion_model", lens)
    coefficients = lens_of(f"{camera.where}: distortion_coeffs", model, given)
    return Calibration("", (fx, fy), (cx, cy), **coefficients, size_px=size)


def _orb_slam(fields: Fields, name: str) -> Calibration:
    first = [f"Camera{n}." for n in ("", "0", "1") if f"Camera{n}.fx" in fields.data]
    prefix = f"{name}." if name else first[0] if first else "Camera."
    own = Fields(
        fields.where,
        {str(k).removeprefix(prefix): v for k, v in fields.data.items() if str(k).startswith(prefix)},
    )
    general = Fields(fields.where, {str(k).removeprefix("Camera."): v for k, v in fields.data.items()})
    kind = own.word("type", "model", default=general.word("type", "model", default="PinHole"))
    return _by_names(own, lens_model(f"{fields.where}: Camera.type", kind), general)


def _stella(fields: Fields, name: str) -> Calibration:
    camera = fields.part("Camera")
    return _by_names(
        camera, lens_model(f"{camera.where}: model", camera.word("model", default="perspective")), camera
    )


def _by_names(own: Fields, model: LensModel, general: Fields) -> Calibration:
    """A camera whose coefficients have a key each."""
    given = [own.maybe(key) or 0.0 for key in DISTORTION_KEYS[model]]
    return Calibration(
        "",
        (own.number("fx"), own.number("fy")),
        (own.number("cx"), own.number("cy")),
        **lens_of(own.where, model, given),
        size_px=general.size(("width", "height"), ("cols", "rows"), ("w", "h")),
        fps=general.maybe("fps"),
    )


def _vins(fields: Fields, name: str) -> Calibration:
    model = lens_model(f"{fields.where}: model_type", fields.word("model_type", default="PINHOLE"))
    of = fields.part("projection_parameters")
    size = fields.size(("image_width", "image_height"))
    if model == "equidistant":
        focal, centre = (of.number("mu"), of.number("mv")), (of.number("u0"), of.number("v0"))
        given = [of.number(key) for key in ("k2", "k3", "k4", "k5")]
    else:
        focal, centre = (of.number("fx"), of.number("fy")), (of.number("cx"), of.number("cy"))
        lens = fields.part("distortion_parameters")
        given = [lens.number(key) for key in ("k1", "k2", "p1", "p2")]
    return Calibration("", focal, centre, **lens_of(fields.where, model, given), size_px=size)


def euroc_sensor(fields: Fields, name: str = "") -> Calibration:
    """The camera of a sensor.yaml in the EuRoC form."""
    fx, fy, cx, cy = fields.numbers("intrinsics", lengths=(4,))
    lens_model(f"{fields.where}: camera_model", fields.word("camera_model", default="pinhole"))
    model = lens_model(f"{fields.where}: distortion_model", fields.word("distortion_model"))
    given = fields.numbers("distortion_coefficients", lengths=(0, 4, 5, 8))
    lens = lens_of(f"{fields.where}: distortion_coefficients", model, given)
    size = whole(fields.where, *fields.numbers("resolution", lengths=(2,)))
    return Calibration("", (fx, fy), (cx, cy), **lens, size_px=size, fps=fields.maybe("rate_hz"))


def _replica(fields: Fields, name: str) -> Calibration:
    of = fields.part("camera")
    focal, centre = (of.number("fx"), of.number("fy")), (of.number("cx"), of.number("cy"))
    return Calibration("", focal, centre, size_px=of.size(("w", "h")))


def transforms_camera(fields: Fields, name: str = "") -> Calibration:
    """The one camera of a transforms.json."""
    listed = fields.data.get("frames", [])
    frames = [f for f in listed if isinstance(f, Mapping)] if isinstance(listed, list) else []
    if len({repr([f.get(k) for k in _OF_A_FRAME]) for f in frames}) > 1:
        raise InputError(f"{fields.where}: frames", "have cameras of their own", "give images of one camera")
    if frames and "fl_x" not in fields.data:
        fields = Fields(fields.where, {**fields.data, **frames[0]})
    size = fields.size(("w", "h"))
    if "fl_x" in fields.data:
        fx = fields.number("fl_x")
        fy = fields.maybe("fl_y") or fx
    elif size:
        fx = fy = size[0] / (2 * math.tan(fields.number("camera_angle_x") / 2))
    else:
        raise InputError(f"{fields.where}: fl_x", "is missing", "add it, with fl_y, cx, cy, w and h")
    width, height = size or (None, None)
    cx = fields.number("cx") if "cx" in fields.data or width is None else width / 2
    cy = fields.number("cy") if "cy" in fields.data or height is None else height / 2
    model = lens_model(f"{fields.where}: camera_model", fields.word("camera_model", default="OPENCV"))
    given = [fields.maybe(key) or 0.0 for key in DISTORTION_KEYS[model]]
    lens = lens_of(fields.where, model, given)
    centre = (cx - CORNER, cy - CORNER)
    fps = fields.maybe("fps")
    return Calibration("nerfstudio transforms", (fx, fy), centre, **lens, size_px=size, fps=fps)


_OF_A_FRAME = ("fl_x", "fl_y", "cx", "cy", "w", "h")
_MATRIX = (
    "camera_matrix",
    "cameraMatrix",
    "Camera_Matrix",
    "CameraMatrix",
    "intrinsic_matrix",
    "K",
    "M1",
    "mtx",
)
_DISTORTION = (
    "distortion_coefficients",
    "distCoeffs",
    "Distortion_Coefficients",
    "dist_coeffs",
    "distortion",
    "D",
    "D1",
    "dist",
)
_SIZES = (
    ("image_width", "image_height"),
    ("image_Width", "image_Height"),
    ("width", "height"),
    ("imageWidth", "imageHeight"),
)


def _has(data: Mapping[Any, Any], keys: tuple[str, ...]) -> bool:
    return any(key in data for key in keys)


def _kalibr_like(data: Mapping[Any, Any]) -> bool:
    return any(
        isinstance(v, Mapping) and "intrinsics" in v and str(k).startswith("cam") for k, v in data.items()
    )


_FORMS: tuple[tuple[str, Callable[[Mapping[Any, Any]], bool], Callable[[Fields, str], Calibration]], ...] = (
    ("Kalibr camchain", _kalibr_like, _kalibr),
    ("ORB-SLAM settings", lambda data: any(re.match(r"Camera\d?\.", str(key)) for key in data), _orb_slam),
    ("stella_vslam settings", lambda data: isinstance(data.get("Camera"), Mapping), _stella),
    ("VINS settings", lambda data: "projection_parameters" in data or "mirror_parameters" in data, _vins),
    ("EuRoC sensor.yaml", lambda data: "intrinsics" in data and "resolution" in data, euroc_sensor),
    ("Replica cam_params", lambda data: isinstance(data.get("camera"), Mapping), _replica),
    (
        "nerfstudio transforms",
        lambda data: _has(data, ("fl_x", "camera_angle_x", "frames")),
        transforms_camera,
    ),
    (
        "ROS camera_info",
        lambda data: "distortion_model" in data and _has(data, ("camera_matrix", "K", "k")),
        camera_info,
    ),
    ("OpenCV FileStorage", lambda data: _has(data, _MATRIX), _opencv),
)
