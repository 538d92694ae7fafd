"""SVO over a TUM-form folder, through the package svo-cpp.

    python svo_driver.py SEQUENCE OUT SETTINGS.json

Writes trajectory.txt and frames.csv into OUT. The poses are those that were given: nothing moves them later.
It runs in an environment of its own.
"""

import ctypes
import json
import sys
from pathlib import Path

import cv2
import numpy as np
import svo_cpp  # pyright: ignore[reportMissingImports]
from driver_files import Clock, Frames, Log

_DRIVER_KEYS = ("speed",)
_TRACKING = "DEFAULT_FRAME"
_HEADER_BYTES = 16  # of a Python object, before the pointer to what it wraps


def main(sequence: Path, out: Path, settings: dict) -> None:
    """Feed every frame and note its pose."""
    cv2.setNumThreads(1)
    frames = Frames(sequence, settings["speed"])
    svo_cpp.set_svo_config({key: value for key, value in settings.items() if key not in _DRIVER_KEYS})
    camera = frames.camera
    straighten = straightener(camera)
    size, focal = (camera["width"], camera["height"]), (camera["fx"], camera["fy"])
    svo = svo_cpp.SVO(svo_cpp.PinholeCamera(*size, *focal, camera["cx"], camera["cy"]))
    svo.start()
    log = Log(out, "trajectory.txt")
    for stamp_s, image in frames:
        straight = straighten(image)
        with Clock() as clock:
            svo.addImage(straight, stamp_s)
        stage = svo.stage().name
        log.frame(stamp_s, stage, clock.ms, clock.cpu_ms)
        if stage == _TRACKING:
            # The frame holds the pose and must live as long.
            frame = svo.lastFrame()
            T_map_cam = frame.T_f_w.inverse()
            log.pose(stamp_s, np.ravel(T_map_cam.translation()), quaternion_of(T_map_cam))
    log.close()


def quaternion_of(T: object) -> list[float]:
    """The rotation of a pose, (x, y, z, w).

    The package names a method for it that cannot give its result to Python. A pose is four numbers of the
    quaternion and three of the translation in memory: the translation, which can be asked for, and the length
    tell whether that is so.

    Raises:
        RuntimeError: it is not so.
    """
    address = ctypes.c_void_p.from_address(id(T) + _HEADER_BYTES).value
    numbers = np.array((ctypes.c_double * 7).from_address(address)) if address else np.zeros(7)
    translation = np.ravel(T.translation())  # type: ignore[attr-defined]
    if abs(np.linalg.norm(numbers[:4]) - 1) > 1e-6 or not np.array_equal(numbers[4:], translation):
        raise RuntimeError("this version of svo-cpp keeps poses otherwise: their rotation cannot be read")
    return numbers[:4].tolist()


def straightener(camera: dict):
    """A function that takes the lens distortion out of an image, as SVO's camera has none."""
    fisheye = camera.get("model", "radtan") == "equidistant"
    keys = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    lens = np.array([camera.get(key, 0.0) for key in keys])
    if not lens.any():
        return lambda image: image
    K = np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1.0]])
    size = int(camera["width"]), int(camera["height"])
    maps_of = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
    maps = maps_of(K, lens, np.eye(3), K, size, cv2.CV_16SC2)
    return lambda image: cv2.remap(image, *maps, cv2.INTER_LINEAR)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), json.loads(Path(sys.argv[3]).read_text()))
