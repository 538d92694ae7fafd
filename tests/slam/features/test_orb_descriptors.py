import math

import cv2
import numpy as np
import pytest

from dslab.slam.features._brief_pattern import BRIEF_PAIRS
from dslab.slam.features._orb_kernels import BORDER_PX, descriptors, orientations

HEIGHT, WIDTH = 260, 340


def textured(seed=0):
    noise = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
    smooth = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3), None, 0, 255, cv2.NORM_MINMAX)
    return cv2.addWeighted(smooth, 0.8, noise, 0.2, 0)


def positions(n, seed=1):
    rng = np.random.default_rng(seed)
    xs = rng.integers(BORDER_PX, WIDTH - BORDER_PX, n).astype(np.int32)
    ys = rng.integers(BORDER_PX, HEIGHT - BORDER_PX, n).astype(np.int32)
    xs[:2], ys[:2] = (BORDER_PX, WIDTH - BORDER_PX - 1), (BORDER_PX, HEIGHT - BORDER_PX - 1)
    return xs, ys


def blur_of_opencv_orb(image):
    kernel = cv2.getGaussianKernel(7, 2)
    return cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)


def slow_descriptor(blurred, x, y, angle_deg):
    angle = np.float32(angle_deg) * np.float32(math.pi / 180)
    a, b = np.float32(math.cos(angle)), np.float32(math.sin(angle))
    px, py = BRIEF_PAIRS.reshape(-1, 2).T.astype(np.float32)
    u, v = np.rint(px * a - py * b).astype(int), np.rint(px * b + py * a).astype(int)
    values = blurred[y + v, x + u].reshape(256, 2)
    return np.packbits(values[:, 0] < values[:, 1], bitorder="little").view(np.uint64)


def test_pattern_reaches_as_far_as_the_border():
    assert BRIEF_PAIRS.shape == (256, 4) and BRIEF_PAIRS.min() == -13 and BRIEF_PAIRS.max() == 12
    assert len(np.unique(BRIEF_PAIRS, axis=0)) == 256
    reach = 0
    for angle in np.radians(np.arange(0, 360, 0.5)):
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        reach = max(reach, np.abs(np.rint(BRIEF_PAIRS.reshape(-1, 2) @ turn.T)).max())
    assert reach == BORDER_PX


def test_descriptors_agree_with_numpy_up_to_the_border():
    blurred = blur_of_opencv_orb(textured())
    xs, ys = positions(60)
    angles = np.random.default_rng(2).uniform(0, 360, 60).astype(np.float32)
    angles[:4] = 225, 45, 0, 90  # farthest reach on both axes at the extreme positions
    ours = descriptors(blurred, xs, ys, angles)
    assert ours.dtype == np.uint64 and ours.shape == (60, 4)
    for k in range(60):
        assert np.array_equal(ours[k], slow_descriptor(blurred, xs[k], ys[k], angles[k]))


@pytest.mark.parametrize("seed", range(3))
def test_descriptors_equal_those_of_opencv_bit_for_bit(seed):
    image = textured(seed)
    rng = np.random.default_rng(seed)
    xs, ys = positions(2000, seed)
    angles = rng.uniform(0, 360, 2000).astype(np.float32)
    angles[:8] = np.arange(8) * 45
    keypoints = [
        cv2.KeyPoint(float(x), float(y), 31.0, float(a), float(k), 0)
        for k, (x, y, a) in enumerate(zip(xs, ys, angles, strict=True))
    ]
    # OpenCV drops keypoints near the edge, silently; the response tells which are left.
    orb = cv2.ORB_create(nlevels=1, edgeThreshold=BORDER_PX)
    left, theirs = orb.compute(image, keypoints)
    rows = np.array([round(k.response) for k in left])
    assert len(rows) > 1000
    ours = descriptors(blur_of_opencv_orb(image), xs[rows], ys[rows], angles[rows])
    assert np.array_equal(ours.view(np.uint8), theirs)


def test_orientations_equal_those_of_opencv():
    image = textured(4)
    found = cv2.ORB_create(3000, nlevels=1, edgeThreshold=BORDER_PX, fastThreshold=5).detect(image)
    xs, ys = np.array([k.pt for k in found]).astype(np.int32).T.copy()
    angles = orientations(image, xs, ys)
    off = (angles - np.array([k.angle for k in found]) + 180) % 360 - 180
    assert len(found) > 300 and np.abs(off).max() < 0.02  # cv2.fastAtan2 is that coarse


def test_orientations_agree_with_numpy_up_to_the_border():
    image = textured(5)
    xs, ys = positions(50)
    half = [15, 15, 15, 15, 14, 14, 14, 13, 13, 12, 11, 10, 9, 8, 6, 3]
    disc = [(u, v) for v in range(-15, 16) for u in range(-half[abs(v)], half[abs(v)] + 1)]
    assert {(v, u) for u, v in disc} == set(disc)
    angles = orientations(image, xs, ys)
    for x, y, angle in zip(xs, ys, angles, strict=True):
        m_x = sum(u * int(image[y + v, x + u]) for u, v in disc)
        m_y = sum(v * int(image[y + v, x + u]) for u, v in disc)
        assert angle == pytest.approx(math.degrees(math.atan2(m_y, m_x)) % 360, abs=1e-3)


@pytest.mark.parametrize("turn_deg", [0, 37, 90, 200, 359.99999])
def test_orientation_points_to_the_bright_side(turn_deg):
    v, u = np.mgrid[-30:31, -30:31]
    ramp = u * math.cos(math.radians(turn_deg)) + v * math.sin(math.radians(turn_deg))
    image = np.clip(127 + 2.5 * ramp, 0, 255).astype(np.uint8)
    middle = np.array([30], np.int32)
    angle = orientations(image, middle, middle)[0]
    assert 0 <= angle < 360
    assert abs((angle - turn_deg + 180) % 360 - 180) < 1


def test_flat_patch_has_an_orientation_and_a_descriptor_of_no_bits():
    flat = np.full((61, 61), 200, np.uint8)
    middle = np.array([30], np.int32)
    angles = orientations(flat, middle, middle)
    assert angles[0] == 0
    assert (descriptors(flat, middle, middle, angles) == 0).all()
