import cv2
import numpy as np
import pytest

from dslab.slam.features._fast_kernels import corner_contrast, refine_corners, select_corners

CIRCLE = [
    *((0, 3), (1, 3), (2, 2), (3, 1), (3, 0), (3, -1), (2, -2), (1, -3)),
    *((0, -3), (-1, -3), (-2, -2), (-3, -1), (-3, 0), (-3, 1), (-2, 2), (-1, 3)),
]
IMAGES = ("noise", "smooth", "binary", "extremes")


def make_image(kind, height=90, width=131):
    rng = np.random.default_rng(3)
    noise = rng.integers(0, 256, (height, width), dtype=np.uint8)
    if kind == "smooth":
        return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX)
    if kind == "binary":
        return (cv2.GaussianBlur(noise, (0, 0), 2) > 127).astype(np.uint8) * 200 + 20
    if kind == "extremes":
        return (noise > 127).astype(np.uint8) * 255
    return noise


def slow_contrast(image):
    """The definition: the best arc of nine, over all sixteen arcs and both signs."""
    height, width = image.shape
    inner = image[3:-3, 3:-3].astype(int)
    ring = np.stack([image[3 + v : height - 3 + v, 3 + u : width - 3 + u] for u, v in CIRCLE]) - inner
    arcs = np.stack([np.roll(ring, -k, axis=0)[:9] for k in range(16)])
    return np.maximum(np.maximum(arcs.min(axis=1).max(axis=0), (-arcs).min(axis=1).max(axis=0)), 0)


def contrast_of(image, margin=3):
    out = np.full(image.size, 77, np.uint8)
    corner_contrast(image, margin, out)
    return out.reshape(image.shape)


def corners_of(image, border=4, threshold=20, min_threshold=20, cell_px=30, occupied=None):
    height, width = image.shape
    if occupied is None:
        occupied = np.zeros([max((size - 2 * border) // cell_px, 1) for size in image.shape], np.bool_)
    most = image.size // 4 + height + width
    xs, ys, contrasts = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most, np.uint8)
    flat = contrast_of(image, border - 1).ravel()
    n = select_corners(
        flat, height, width, border, np.uint8(threshold), np.uint8(min_threshold), occupied, xs, ys, contrasts
    )
    return list(zip(xs[:n].tolist(), ys[:n].tolist(), contrasts[:n].tolist(), strict=True))


@pytest.mark.parametrize("kind", IMAGES)
def test_contrast_agrees_with_numpy(kind):
    image = make_image(kind)
    assert np.array_equal(contrast_of(image)[3:-3, 3:-3], slow_contrast(image))


def test_contrast_does_not_write_the_margin():
    out = contrast_of(make_image("noise"), margin=5)
    out[5:-5, 5:-5] = 77
    assert (out == 77).all()


def test_contrast_of_a_too_small_image_writes_nothing():
    assert (contrast_of(np.zeros((6, 6), np.uint8)) == 77).all()
    assert corners_of(np.zeros((8, 8), np.uint8)) == []


@pytest.mark.parametrize("kind", IMAGES)
@pytest.mark.parametrize("threshold", [1, 7, 20, 60])
def test_corners_and_scores_equal_those_of_opencv(kind, threshold):
    image = make_image(kind)
    height, width = image.shape
    theirs = {
        (round(k.pt[0]), round(k.pt[1]), round(k.response))
        for k in cv2.FastFeatureDetector_create(threshold, True).detect(image)
        if 4 <= k.pt[0] < width - 4 and 4 <= k.pt[1] < height - 4
    }
    ours = corners_of(image, threshold=threshold, min_threshold=threshold)
    # OpenCV's score is the greatest threshold that is passed, one less than the contrast.
    assert {(x, y, contrast - 1) for x, y, contrast in ours} == theirs
    assert kind == "binary" or len(ours) > 3 or threshold == 60
    assert len(ours) == len(theirs)


@pytest.mark.parametrize("cell_px", [9, 30, 1000])
def test_weak_corners_only_fill_cells_without_strong_ones(cell_px):
    image = make_image("smooth", 150, 220)
    image[:, 110:] = 110 + image[:, 110:] // 8  # half of it faint
    border, threshold, min_threshold = 18, 30, 4
    everything = corners_of(image, border, min_threshold, min_threshold, cell_px)
    n, rows = 220 - 2 * border, 150 - 2 * border
    n_cells, n_bands = max(n // cell_px, 1), max(rows // cell_px, 1)
    starts = [border + rows * b // n_bands for b in range(n_bands)]

    def cell(corner):
        band = sum(corner[1] >= start for start in starts) - 1
        return band, (corner[0] - border) * n_cells // n

    strong = {cell(c) for c in everything if c[2] > threshold}
    expected = [c for c in everything if c[2] > threshold or cell(c) not in strong]
    found = corners_of(image, border, threshold, min_threshold, cell_px)
    assert found == expected
    assert strong and len(found) < len(everything)
    assert any(c[2] <= threshold for c in found) == (cell_px < 1000)


def test_corners_are_found_in_free_cells_and_occupy_them():
    image = make_image("smooth", 150, 220)
    border, occupied = 18, np.zeros((4, 6), np.bool_)
    occupied[1, 2:4] = True
    free = ~occupied
    everything = corners_of(image, border, 30, 30, occupied=np.zeros((4, 6), np.bool_))
    found = corners_of(image, border, 30, 30, occupied=occupied)
    starts = [border + 114 * band // 4 for band in range(4)]
    cells = [(sum(y >= start for start in starts) - 1, (x - border) * 6 // 184) for x, y, _ in everything]
    assert found == [corner for corner, cell in zip(everything, cells, strict=True) if free[cell]]
    assert 0 < len(found) < len(everything)
    with_corners = np.zeros((4, 6), np.bool_)
    with_corners[tuple(np.transpose(cells))] = True
    assert np.array_equal(occupied, with_corners | ~free)


def test_corners_are_not_in_the_border():
    xs, ys = np.array([c[:2] for c in corners_of(make_image("noise"), border=18)]).T
    assert xs.min() >= 18 and xs.max() < 131 - 18 and ys.min() >= 18 and ys.max() < 90 - 18
    assert 18 in xs and 131 - 19 in xs and 18 in ys and 90 - 19 in ys


@pytest.mark.parametrize("kind", IMAGES)
def test_summits_agree_with_least_squares(kind):
    image = make_image(kind)
    corners = np.array(corners_of(image, threshold=7, min_threshold=7))
    contrast = contrast_of(image)
    v, u = (axis.ravel() for axis in np.mgrid[-1:2, -1:2])
    terms = np.stack([u**0, u, v, u * u / 2, u * v, v * v / 2], axis=1)
    expected = []
    for x, y, _ in corners:
        around = contrast[y - 1 : y + 2, x - 1 : x + 2].ravel().astype(float)
        _, *slope, xx, xy, yy = np.linalg.lstsq(terms, around, rcond=None)[0]
        curved = np.array([[xx, xy], [xy, yy]])
        is_summit = np.linalg.eigvalsh(curved).max() < -1e-9
        expected.append(np.clip(np.linalg.solve(curved, -np.array(slope)), -1, 1) if is_summit else (0, 0))
    found = refine_corners(contrast.ravel(), image.shape[1], *np.ascontiguousarray(corners.T[:2], np.int32))
    assert len(corners) > 20
    assert np.allclose(found, expected, atol=1e-5)
