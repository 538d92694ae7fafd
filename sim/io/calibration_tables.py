"""Calibrations as tables of numbers: COLMAP's cameras.txt, DSO's camera.txt, KITTI's calib.txt.

KITTI counts pixels from the centre of the first one, as the lab does; COLMAP and DSO from its corner.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import SETTINGS_BYTES
from dslab.sim.io.calibration import (
    CORNER,
    Calibration,
    chosen,
    fov_lens,
    is_number,
    lens_model,
    lens_of,
    whole,
)
from dslab.sim.io.text import check_words, read_rows, to_numbers
from dslab.sim.sensors.camera import DISTORTION_KEYS

KITTI_FPS = 10.0
"""Images per second of the data set."""
_PROJECTION = r"P\d|P_rect_\d\d"
COLMAP_MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "FOV": "fx fy cx cy omega",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
}
"""Parameters of COLMAP's models, which stand in the order of their numbers."""
_DSO_MODELS = {
    **dict.fromkeys(("pinhole", "fov", "atan"), "fx fy cx cy omega"),
    **dict.fromkeys(("equidistant", "kannalabrandt"), "fx fy cx cy k1 k2 k3 k4"),
    "radtan": "fx fy cx cy k1 k2 p1 p2",
}


def _colmap(path: Path, name: str) -> Calibration:
    rows = {words[0]: (where, words[1], words[2:]) for where, words in read_rows(path, "") if len(words) > 4}
    return colmap_camera(*rows[chosen(str(path), name, list(rows), alone=True)])


def colmap_camera(where: str, kind: str, words: list[str]) -> Calibration:
    """A camera of COLMAP by its model's name, and width, height and parameters.

    Raises:
        InputError: the model is not supported, or has other parameters.
    """
    if kind not in COLMAP_MODELS:
        lens_model(where, kind)
        raise InputError(where, f"{kind!r} is no known lens model", f"use {', '.join(COLMAP_MODELS)}")
    names = ["width", "height", *COLMAP_MODELS[kind].split()]
    check_words(where, words, names)
    values = dict(zip(names, to_numbers(where, words, names), strict=True))
    size = whole(where, values["width"], values["height"])
    focal = (values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0)))
    centre = (values["cx"] - CORNER, values["cy"] - CORNER)
    return _of_text("COLMAP cameras.txt", where, kind, values, focal, centre, size)


def _dso(path: Path, name: str) -> Calibration:
    rows = list(read_rows(path, ""))
    (where, words), (size_at, size_words) = rows[:2]
    kind = words[0].lower() if not is_number(words[0]) else "radtan" if len(words) == 8 else "fov"
    words = words if is_number(words[0]) else words[1:]
    if kind not in _DSO_MODELS:
        raise InputError(where, f"{kind!r} is no known lens model", "use Pinhole, FOV, RadTan or EquiDistant")
    names = _DSO_MODELS[kind].split()
    check_words(where, words, names)
    values = dict(zip(names, to_numbers(where, words, names), strict=True))
    check_words(size_at, size_words, ["width", "height"])
    size = whole(size_at, *to_numbers(size_at, size_words, ["width", "height"]))
    focal, centre = (values["fx"], values["fy"]), (values["cx"], values["cy"])
    if max(centre) <= 1:
        # Relative to the image, whose origin is the corner of the first pixel.
        focal = (focal[0] * size[0], focal[1] * size[1])
        centre = (centre[0] * size[0] - CORNER, centre[1] * size[1] - CORNER)
    return _of_text("DSO camera.txt", where, kind, values, focal, centre, size)


def _of_text(
    form: str,
    where: str,
    kind: str,
    values: Mapping[str, float],
    focal: tuple[float, float],
    centre: tuple[float, float],
    size: tuple[int, int],
) -> Calibration:
    if "omega" in values:
        return Calibration(form, **fov_lens(focal, centre, size, values["omega"]), size_px=size)
    model = "equidistant" if "FISHEYE" in kind else lens_model(where, kind)
    given = [values.get(key, 0.0) for key in DISTORTION_KEYS[model]]
    return Calibration(form, focal, centre, **lens_of(where, model, given), size_px=size)


def kitti_projection(path: Path, name: str = "") -> Calibration:
    """The camera of a projection in KITTI's calib.txt or calib_cam_to_cam.txt; the first without a name.

    Raises:
        InputError: it is missing, there twice, or no projection of a rectified camera.
    """
    rows: dict[str, list[tuple[str, list[str]]]] = {}
    for where, words in read_rows(
        path, "add it with lines such as `P0: ` and 12 numbers", most_bytes=SETTINGS_BYTES
    ):
        rows.setdefault(words[0].rstrip(":"), []).append((where, words[1:]))
    wanted = name if name in rows or not name.isdecimal() else f"P_rect_{int(name):02d}"
    key = wanted or next((key for key in rows if re.fullmatch(_PROJECTION, key)), "P0")
    if key not in rows:
        shown = ", ".join(key for key in rows if re.fullmatch(_PROJECTION, key)) or "none"
        raise InputError(
            f"{path}: {key}", "is missing", f"add the line `{key}: ` and 12 numbers, it has {shown}"
        )
    if len(rows[key]) > 1:
        raise InputError(f"{rows[key][1][0]}: {key}", "appears twice", "keep one of them")
    where, words = rows[key][0]
    names = [f"{key}[{i}]" for i in range(12)]
    check_words(where, words, names)
    fx, skew, cx, _, other, fy, cy, _, *last = to_numbers(where, words, names)
    if skew or other or last[:3] != [0, 0, 1]:
        remedy = "write fx 0 cx 0 0 fy cy 0 0 0 1 0"
        raise InputError(f"{where}: {key}", "is no projection of a rectified camera", remedy)
    size = None
    for size_at, size_words in rows.get(key.replace("P_", "S_"), []) if key.startswith("P_rect") else []:
        check_words(size_at, size_words, ["width", "height"])
        size = whole(size_at, *to_numbers(size_at, size_words, ["width", "height"]))
    return Calibration("KITTI calibration", (fx, fy), (cx, cy), size_px=size, fps=KITTI_FPS)


def _all_match(pattern: str, lines: list[str]) -> bool:
    return bool(lines) and all(re.match(pattern, line) for line in lines)


def _dso_like(lines: list[str]) -> bool:
    lens, size = lines[:1], lines[1:2]
    return _all_match(r"\s*([A-Za-z]+\s+)?[-+.\deE]+(\s+[-+.\deE]+){4,7}\s*$", lens) and _all_match(
        r"\s*\d+\s+\d+\s*$", size
    )


TABLES: tuple[tuple[Callable[[list[str]], bool], Callable[[Path, str], Calibration]], ...] = (
    (lambda lines: any(re.match(rf"({_PROJECTION}):\s", line) for line in lines), kitti_projection),
    (lambda lines: _all_match(r"\d+\s+[A-Z_]{3,}\s+\d+\s+\d+\s", lines), _colmap),
    (_dso_like, _dso),
)
"""Of each form: true for its lines, and its reader."""
