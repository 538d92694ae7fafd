"""``dslab camera``: a calibration of any known form as camera.yaml."""

import re
from pathlib import Path
from typing import Annotated

import typer

from dslab.experiments.cli.console import err, out
from dslab.scenarios.errors import InputError

_Size = Annotated[
    str | None,
    typer.Option(
        metavar="WxH",
        help="Size of the images, where the file does not say it.",
        show_default=False,
    ),
]


def camera_command(
    file: Annotated[
        Path,
        typer.Argument(
            help="camera.yaml, or a calibration of OpenCV, ROS, Kalibr, ORB-SLAM, stella_vslam, VINS, "
            "COLMAP, nerfstudio, DSO, EuRoC or KITTI; FILE:NAME for one of several, such as calib.txt:P2."
        ),
    ],
    scale: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Size of the images as you have them.", show_default=False),
    ] = None,
    size: _Size = None,
    fps: Annotated[
        float | None, typer.Option(help="Frame rate, where the file does not say it.", show_default=False)
    ] = None,
) -> None:
    """Print what a calibration says, as a camera.yaml.

    Example: `dslab camera camchain.yaml:cam1 --fps 20 --scale 640x480 > camera.yaml`
    """
    from dslab.sim.io.camera_file import camera_and_form, camera_text, check_camera

    camera, form = camera_and_form(file, _size("--size", size), fps)
    if to := _size("--scale", scale):
        if abs(to[0] * camera.height_px - to[1] * camera.width_px) > max(camera.width_px, camera.height_px):
            shape = f"{camera.width_px}x{camera.height_px}"
            err.print(
                f"{shape} to {to[0]}x{to[1]} is another shape: right if images were stretched, not cropped"
            )
        camera = camera.scaled(*to)
        check_camera(file, camera)
    lines = f"# {file}, read as {form}\n{camera_text(camera)}"
    out.print(lines, end="", soft_wrap=True)


def _size(option: str, text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,6})[xX](\d{1,6})", text)
    if not found or not all(map(int, found.groups())):
        raise InputError(option, f"{text!r} is no size", "give width and height in pixels, such as 640x480")
    return int(found[1]), int(found[2])
