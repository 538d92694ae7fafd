"""Pictures of the direct thread for the documentation, computed on a rendered street."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from stress_pictures import STREET

from dslab.scenarios.spec import Scenario
from dslab.sim.preview import preview
from dslab.sim.sequence_rendering import render_sequence
from dslab.sim.unfinished import scratch_folder
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.core.geometry import share_of_motion
from dslab.slam.direct.alignment import Reference, align, fan
from dslab.slam.direct.appearance import Surface, alike_in
from dslab.slam.direct.blur import align_through_blur
from dslab.slam.direct.pyramid import ImagePyramid, Rectifier
from dslab.slam.direct.selection import SelectionConfig, select

FIRST, AHEAD, EXPOSURE_S = 20, 6, 0.25
_GREEN, _RED, _WHITE = (80, 200, 80), (60, 60, 230), (255, 255, 255)
_LARGE_RESIDUAL = 40.0
_SHIFT = 0.03  # of the median depth, of the wrong alignment


class Scene(NamedTuple):
    """A frame of the street with points of known depth, and a later frame, sharp and blurred."""

    camera: PinholeCamera
    rectifier: Rectifier
    first: np.ndarray
    later: np.ndarray
    blurred: np.ndarray
    xy: np.ndarray
    depth: np.ndarray
    T_later_first: np.ndarray


def draw_direct_pictures(folder: Path) -> None:
    """Write the pictures into a folder, which is made."""
    folder.mkdir()
    scene = _scene()
    pyramid = scene.rectifier.pyramid(scene.first)
    reference = Reference(pyramid, scene.rectifier.intrinsics, scene.xy, 1 / scene.depth)
    target = scene.rectifier.pyramid(scene.later)
    found = align(reference, target, fan(np.eye(4), scene.rectifier.intrinsics))
    if found is None:
        raise RuntimeError("the street's frames are not aligned")
    _write(folder / "points.jpg", _points(scene))
    before, after = (_residuals(scene, reference, target, T) for T in (np.eye(4), found.T_target_ref))
    _write(folder / "alignment.jpg", before, after)
    _write(folder / "blur.jpg", *_through_blur(scene, reference, pyramid))
    shifted = scene.T_later_first.copy()
    shifted[0, 3] += _SHIFT * np.median(scene.depth)
    right, wrong = (_looks(scene, pyramid, target, T) for T in (scene.T_later_first, shifted))
    _write(folder / "looks.jpg", right, wrong)


def _scene() -> Scene:
    walk = STREET | {"duration_s": 2.5, "trajectory": {"kind": "handheld", "gaze_deg": 50}}
    blur = {"kind": "motion_blur", "start_s": 1.0, "duration_s": 1.0, "exposure_s": EXPOSURE_S}
    later = FIRST + AHEAD
    with scratch_folder() as cache:
        clean = render_sequence(Scenario.model_validate(walk), cache_dir=cache, depth=True)
        if clean.depths is None or clean.T_world_cam is None:
            raise RuntimeError("the street is rendered without depth")
        first, sharp, depth = clean.frames[FIRST], clean.frames[later], clean.depths[FIRST]
        T = np.linalg.inv(clean.T_world_cam[later]) @ clean.T_world_cam[FIRST]
        c = clean.camera
    camera = PinholeCamera(c.width_px, c.height_px, c.fx, c.fy, c.cx, c.cy, c.fps)
    blurred = preview(Scenario.model_validate(walk | {"segments": [blur]})).expose_frames([later])[0][0]
    rectifier = Rectifier(camera)
    xy = select(rectifier.pyramid(first), SelectionConfig(points=1500)).xy
    depths = depth[xy[:, 1], xy[:, 0]].astype(float)
    known = depths > 0
    return Scene(camera, rectifier, first, sharp, blurred, xy[known].astype(float), depths[known], T)


def _points(scene: Scene) -> np.ndarray:
    """The selected pixels, from near to far in the colours from red to blue."""
    picture = cv2.cvtColor(scene.first, cv2.COLOR_GRAY2BGR)
    rank = np.argsort(np.argsort(1 / scene.depth)) * 255 // max(1, len(scene.depth) - 1)
    colors = cv2.applyColorMap(rank.astype(np.uint8)[:, None], cv2.COLORMAP_JET)[:, 0]
    for at, color in zip(scene.xy, colors, strict=True):
        _dot(picture, at, color.tolist())
    return picture


def _residuals(scene: Scene, reference: Reference, target: ImagePyramid, T: np.ndarray) -> np.ndarray:
    """Where a motion puts the points, green where the intensity fits and red where it does not."""
    picture = cv2.cvtColor(scene.later, cv2.COLOR_GRAY2BGR)
    at = _projected(scene, T)
    image = target.levels[0][..., 0]
    value = cv2.remap(image, at[:, :1].astype(np.float32), at[:, 1:].astype(np.float32), cv2.INTER_LINEAR)[
        :, 0
    ]
    middle = reference.levels[0].intensity[:, 4]
    share = np.clip(np.abs(value - middle) / _LARGE_RESIDUAL, 0, 1)
    for place, s in zip(at, share, strict=True):
        _dot(picture, place, [int((1 - s) * g + s * r) for g, r in zip(_GREEN, _RED, strict=True)])
    return picture


def _through_blur(scene: Scene, reference: Reference, source: ImagePyramid) -> list[np.ndarray]:
    """The sharp frame, the blurred one, and where the points of the first lie in the second."""
    velocity = share_of_motion(scene.T_later_first, 1 / AHEAD)
    guesses = fan(np.eye(4), scene.rectifier.intrinsics)
    target = scene.rectifier.pyramid(scene.blurred)
    found = align_through_blur(reference, source, target, scene.rectifier, _xyz(scene), velocity, guesses)
    if found is None:
        raise RuntimeError("the street's blurred frame is not aligned")
    picture = cv2.cvtColor(scene.blurred, cv2.COLOR_GRAY2BGR)
    for at in _projected(scene, found.T_target_ref):
        _dot(picture, at, _GREEN)
    return [cv2.cvtColor(scene.blurred, cv2.COLOR_GRAY2BGR), picture]


def _looks(scene: Scene, source: ImagePyramid, target: ImagePyramid, T: np.ndarray) -> np.ndarray:
    """Where an alignment puts the points, green where the patches about them look alike."""
    picture = cv2.cvtColor(scene.later, cv2.COLOR_GRAY2BGR)
    alike = alike_in(Surface(source, scene.xy, 1 / scene.depth), target, scene.rectifier.intrinsics, T, 0.7)
    for at, told, fits in zip(_projected(scene, T), *alike, strict=True):
        if told:
            _dot(picture, at, _GREEN if fits else _RED)
    return picture


def _xyz(scene: Scene) -> np.ndarray:
    """(n, 3) the points in the first frame's camera."""
    c = scene.camera
    rays = np.column_stack([(scene.xy - (c.cx, c.cy)) / (c.fx, c.fy), np.ones(len(scene.xy))])
    return rays * scene.depth[:, None]


def _projected(scene: Scene, T: np.ndarray) -> np.ndarray:
    """(n, 2) pixels of the points under a motion, clipped to the image."""
    c = scene.camera
    moved = _xyz(scene) @ T[:3, :3].T + T[:3, 3]
    at = moved[:, :2] / np.maximum(moved[:, 2:], 1e-6) * (c.fx, c.fy) + (c.cx, c.cy)
    return np.clip(at, 0, (c.width_px - 2, c.height_px - 2))


def _dot(picture: np.ndarray, at: np.ndarray, color) -> None:
    cv2.circle(picture, tuple(int(v) for v in np.rint(at)), 1, color, -1, cv2.LINE_AA)


def _write(path: Path, *pictures: np.ndarray) -> None:
    gap = np.full((len(pictures[0]), 8, 3), 255, np.uint8)
    row = [part for picture in pictures for part in (gap, picture)][1:]
    path.write_bytes(cv2.imencode(".jpg", np.hstack(row), [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes())
