"""SIFT keypoints and descriptors: against OpenCV's, against NumPy twins, and as properties."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from dslab.slam.features._dog_kernels import BORDER_PX, find_extrema, refine_extrema
from dslab.slam.features._sift_kernels import _turns
from dslab.slam.features._sift_matching import nearest
from dslab.slam.features.sift_detector import SiftDetector, SiftFeatures

SIZE = 240, 320
ALL = 10**6


def scene(size=SIZE) -> np.ndarray:
    """An image with structure at all scales."""
    rng = np.random.default_rng(4)
    image = sum(
        cv2.GaussianBlur(rng.normal(0, 1, size), (0, 0), sigma) * sigma for sigma in (1.2, 2.5, 5.0, 10.0)
    )
    return np.clip(110 + 35 * image, 0, 255).astype(np.uint8)


def turned(image, degrees, scale):
    """The image turned and scaled about its middle, and the map (2, 3) of its pixels."""
    height, width = image.shape
    change = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, scale)
    return cv2.warpAffine(image, change, (width, height), flags=cv2.INTER_CUBIC, borderValue=110), change


def detect(image, n=400, octaves=4, most_pixels=ALL) -> SiftFeatures:
    return SiftDetector(n, 0.02, octaves, most_pixels).detect(image)


def of_opencv(image, n=400) -> SiftFeatures:
    """OpenCV's features, without those of the doubled image."""
    keypoints, descriptors = cv2.SIFT_create(
        contrastThreshold=0.02, enable_precise_upscale=True
    ).detectAndCompute(image, None)
    undoubled = [i for i, k in enumerate(keypoints) if k.octave & 255 < 128]
    chosen = np.array(sorted(undoubled, key=lambda i: -keypoints[i].response)[:n])
    points = [keypoints[i] for i in chosen]
    return SiftFeatures(
        np.array([k.pt for k in points]),
        np.array([k.size / 2 for k in points]),
        np.array([k.angle / 360 for k in points]),
        descriptors[chosen].astype(np.uint8),
    )


def apart(a, b):
    """Difference of two directions in turns."""
    return np.abs((a - b + 0.5) % 1 - 0.5)


@pytest.fixture(scope="module")
def pairs():
    """Features of one image here and in OpenCV, and rows of the same keypoints with the same orientation."""
    here, there = detect(scene(), 1000), of_opencv(scene(), 1000)
    _, candidates = cKDTree(there.xy).query(here.xy, k=5)
    close = np.linalg.norm(there.xy[candidates] - here.xy[:, None], axis=2) < 1.0
    close &= np.abs(np.log2(there.sigma_px[candidates] / here.sigma_px[:, None])) < 0.15
    close &= apart(there.turns[candidates], here.turns[:, None]) < 0.03
    rows = np.flatnonzero(close.any(axis=1))
    return here, there, rows, candidates[rows, close[rows].argmax(axis=1)]


def test_most_keypoints_are_those_of_opencv(pairs):
    here, there, rows, _ = pairs
    assert len(rows) > 0.85 * len(here.xy) > 100
    assert len(rows) > 0.85 * len(there.xy)


def test_the_descriptors_are_those_of_opencv(pairs):
    here, there, rows, theirs = pairs
    a, b = here.descriptors[rows].astype(float), there.descriptors[theirs].astype(float)
    cosine = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    assert np.median(cosine) > 0.98 and (cosine > 0.9).mean() > 0.95


def test_places_and_scales_are_unbiased(pairs):
    here, there, rows, theirs = pairs
    assert np.abs((here.xy[rows] - there.xy[theirs]).mean(axis=0)).max() < 0.05
    assert abs(np.log2(here.sigma_px[rows] / there.sigma_px[theirs]).mean()) < 0.02


def right_matches(one: SiftFeatures, other: SiftFeatures, change: np.ndarray) -> tuple[int, int]:
    """Matches that pass the ratio test, and those of them that lie where the change puts them."""
    found, best2, second2, _ = nearest(one.descriptors, other.descriptors)
    keep = best2 < 0.8**2 * second2
    moved = one.xy[keep] @ change[:, :2].T + change[:, 2]
    error_px = np.linalg.norm(moved - other.xy[found[keep]], axis=1)
    return int(keep.sum()), int((error_px < 2.5).sum())


@pytest.mark.parametrize(("degrees", "scale"), [(25, 0.8), (-80, 1.2), (0, 0.6)])
def test_features_are_found_again_as_often_as_opencvs(degrees, scale):
    other, change = turned(scene(), degrees, scale)
    matches, right = right_matches(detect(scene()), detect(other), change)
    their_matches, their_right = right_matches(of_opencv(scene()), of_opencv(other), change)
    assert right >= 0.9 * their_right > 50
    assert right / matches >= their_right / their_matches - 0.03


def test_extrema_are_those_among_their_26_neighbours():
    dog = np.random.default_rng(1).normal(0, 1, (5, 40, 50)).astype(np.float32)
    dog = np.stack([cv2.GaussianBlur(layer, (0, 0), 1.0) for layer in dog])
    found = np.empty((4000, 3), np.int32)
    count = find_extrema(dog, np.float32(0.1), found)
    extreme = (dog == maximum_filter(dog, 3)) & (dog > 0.1) | (dog == minimum_filter(dog, 3)) & (dog < -0.1)
    inner = np.zeros_like(extreme)
    inner[1:-1, BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    np.testing.assert_array_equal(found[:count], np.argwhere(extreme & inner))
    assert count > 20


def blob(x, y, s, size=2.0, bend=(1.0, 1.0)):
    """Differences of Gaussians with a quadric's peak at (x, y) in layer ``s``."""
    layers, rows, columns = np.mgrid[:5, :30, :40].astype(float)
    fall = bend[0] * (columns - x) ** 2 + bend[1] * (rows - y) ** 2 + (layers - s) ** 2
    return (size - 0.1 * fall).astype(np.float32)


def refined(dog, at, least=0.5):
    found, out = np.array([at], np.int32), np.empty((1, 5))
    return out[0] if refine_extrema(dog, found, 1, least, out) else None


def test_refinement_finds_the_peak_of_a_quadric_even_from_a_neighbour():
    x, y, scale, size, layer = refined(blob(18.3, 14.8, 1.7), (2, 15, 19))
    np.testing.assert_allclose([x, y, scale, size], [18.3, 14.8, 1.7, 2.0], atol=1e-4)
    assert layer == 2


def test_weak_extrema_and_edges_are_dropped():
    assert refined(blob(18.3, 14.8, 2.0, size=0.4), (2, 15, 18)) is None
    assert refined(blob(18.3, 14.8, 2.0, bend=(8.0, 1.0)), (2, 15, 18)) is not None
    assert refined(blob(18.3, 14.8, 2.0, bend=(14.0, 1.0)), (2, 15, 18)) is None


def test_directions_are_those_of_arctan():
    dx, dy = np.random.default_rng(2).normal(0, 1, (2, 500)).astype(np.float32)
    turns = np.array([_turns(y, x) for x, y in zip(dx, dy, strict=True)])
    assert apart(turns, np.arctan2(dy, dx) / (2 * np.pi)).max() < 1e-5


def test_a_reduced_image_gives_the_same_places_and_scales():
    image = scene((480, 640))
    whole, half = detect(image, ALL), detect(image, ALL, most_pixels=240 * 320)
    distance, row = cKDTree(whole.xy).query(half.xy)
    same = (distance < 1.0) & (np.abs(np.log2(whole.sigma_px[row] / half.sigma_px)) < 0.15)
    assert same.mean() > 0.5
    assert np.abs((half.xy - whole.xy[row])[same].mean(axis=0)).max() < 0.05
    assert whole.sigma_px.min() < 2.0
    assert half.sigma_px.min() > 3.2


def test_the_strongest_are_kept_and_octaves_end_where_asked():
    few, many = detect(scene(), 50), detect(scene(), 400)
    assert 50 <= len(few.xy) <= 75
    assert {tuple(p) for p in few.xy} < {tuple(p) for p in many.xy}
    assert detect(scene(), octaves=1).sigma_px.max() < 1.6 * 2 ** (3.5 / 3) + 1e-9 < many.sigma_px.max()


def test_a_detector_forgets_the_images_before():
    detector = SiftDetector(400, 0.02, 4, ALL)
    once = detector.detect(scene())
    detector.detect(turned(scene(), 40, 1.0)[0])
    detector.detect(scene((100, 140)))
    again = detector.detect(scene())
    for field in ("xy", "sigma_px", "turns", "descriptors"):
        assert getattr(once, field).tobytes() == getattr(again, field).tobytes()


def test_tiny_images_have_no_features():
    assert len(detect(np.arange(64, dtype=np.uint8).reshape(8, 8)).xy) == 0
