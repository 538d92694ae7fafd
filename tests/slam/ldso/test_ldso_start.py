"""First depths by intensities alone: motion and depths of surfaces without a corner, and what tells none."""

import cv2
import numpy as np
import pytest
from ldso_scenes import CAMERA, CONFIG, HEIGHT, INTRINSICS, RECTIFIER, WIDTH, depth_of, motion

from dslab.slam.ldso.first_depths import IntensityStart

_SHADING = cv2.GaussianBlur(np.random.default_rng(5).normal(size=(700, 700)).astype(np.float32), (0, 0), 12.0)
_SHADING /= _SHADING.std()


def surface(x, y, slant, relief):
    return 2.0 + slant * x + relief * np.sin(2.0 * x) * np.cos(1.5 * y)


def view(T, slant, relief, contrast):
    """Image of soft shading on a surface, and its depth."""
    depth, at = depth_of(T, lambda x, y: surface(x, y, slant, relief))
    place = (100 * at + 350).astype(np.float32)
    shade = cv2.remap(_SHADING, place[..., 0], place[..., 1], cv2.INTER_CUBIC, None, cv2.BORDER_REFLECT)
    return np.clip(120 + contrast * shade, 0, 255).astype(np.uint8), depth


def started(step, slant, relief, contrast=25.0, frames=40):
    """What is found, the exact motion, and exact inverse depths."""
    start = IntensityStart(CAMERA, INTRINSICS, CONFIG)
    _, depth = view(np.eye(4), slant, relief, contrast)
    for k in range(frames):
        T = motion(np.asarray(step, float) * k)
        found = start.offer(k, RECTIFIER.pyramid(view(T, slant, relief, contrast)[0]))
        if found is not None:
            xy = found.uv.astype(int)
            return found, T, 1 / depth[xy[:, 1], xy[:, 0]]
    return None


@pytest.mark.parametrize(
    ("step", "slant", "relief"),
    [
        ([0.015, 0.0, 0.0, 0.0, 0.002, 0.0], 0.0, 0.3),
        ([0.010, -0.008, 0.004, 0.001, 0.0, 0.002], 0.3, 0.15),
        ([0.015, 0.0, 0.0, 0.0, 0.0, 0.0], 0.6, 0.0),
    ],
    ids=["relief", "slant and relief", "plane"],
)
def test_motion_and_depths_are_found_without_a_corner(step, slant, relief):
    found, T, exact = started(step, slant, relief)
    assert found.first == 0 and found.inverse_depth.mean() == pytest.approx(1.0)
    exact = exact / exact.mean()
    assert np.median(np.abs(found.inverse_depth - exact)) < 0.03
    assert np.corrcoef(found.inverse_depth, exact)[0, 1] > 0.9
    a, b = found.T_second_first[:3, 3], T[:3, 3]
    assert np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))) < 6


def test_of_two_motions_that_explain_a_plane_alike_none_is_taken():
    """Straight ahead to a slanted wall is, by its images, aslant to an upright one."""
    assert started([0.0, 0.0, 0.02, 0.0, 0.0, 0.0], 0.6, 0.0, frames=14) is None


def test_turning_alone_tells_no_depths():
    assert started([0, 0, 0, 0.002, 0.006, 0.0], 0.2, 0.3) is None


@pytest.mark.parametrize("value", [0, 128, 255])
def test_nothing_begins_with_a_constant_image(value):
    start = IntensityStart(CAMERA, INTRINSICS, CONFIG)
    pyramid = RECTIFIER.pyramid(np.full((HEIGHT, WIDTH), value, np.uint8))
    assert [start.offer(k, pyramid) for k in range(3)] == [None] * 3
