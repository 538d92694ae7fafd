from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from dslab.slam.core.frame import Features
from dslab.slam.features.orb import OrbConfig, OrbExtractor, share_out
from dslab.slam.features.remembered import Remembered
from dslab.slam.matching.brute_force import match_brute_force

WIDTH, HEIGHT = 640, 480
REAL_FRAMES = Path(__file__).parents[4] / "shared" / "data" / "sevenscenes_redkitchen" / "images"


def extract(image, **config):
    return OrbExtractor(image.shape[1], image.shape[0], OrbConfig(**config)).extract(image)


def uneven_image():
    """Faint texture everywhere and a few patches with by far the strongest corners."""
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (HEIGHT, WIDTH)).astype(np.float32)
    texture = cv2.GaussianBlur(noise, (0, 0), 1.5)
    texture = (texture - texture.mean()) / texture.std()
    gain = np.full((HEIGHT, WIDTH), 9, np.float32)
    for x, y in ((80, 60), (400, 100), (250, 330), (500, 400)):
        gain[y : y + 90, x : x + 110] = 50
    return np.clip(120 + gain * texture, 0, 255).astype(np.uint8)


def occupied_cells(xy, width=WIDTH, height=HEIGHT):
    cells = np.floor((np.asarray(xy) + 0.5) / (width / 20, height / 15)).astype(int)
    return len(np.unique(cells, axis=0))


def assert_well_formed(features, n_levels=8):
    n = len(features)
    kinds = {
        "xy": ((n, 2), np.float32),
        "octave": ((n,), np.int32),
        "angle_deg": ((n,), np.float32),
        "response": ((n,), np.float32),
        "descriptors": ((n, 4), np.uint64),
    }
    for name, (shape, dtype) in kinds.items():
        column = getattr(features, name)
        assert column.shape == shape and column.dtype == dtype and column.flags.c_contiguous, name
    assert ((features.angle_deg >= 0) & (features.angle_deg < 360)).all()
    assert ((features.octave >= 0) & (features.octave < n_levels)).all()
    assert (np.diff(features.octave) >= 0).all()


def assert_equal(a, b):
    for column in fields(Features):
        assert np.array_equal(getattr(a, column.name), getattr(b, column.name)), column.name


def test_features_are_well_formed_and_as_many_as_requested():
    features = extract(uneven_image())
    assert_well_formed(features)
    assert 984 <= len(features) <= 1000
    assert len(np.unique(features.octave)) == 8
    assert features.response.min() > 7


def test_spread_on_an_uneven_image():
    image = uneven_image()
    theirs = cv2.ORB_create(1000).detect(image)
    assert occupied_cells([k.pt for k in theirs]) < 100
    assert occupied_cells(extract(image).xy) >= 170


@pytest.mark.skipif(not REAL_FRAMES.is_dir(), reason="no real frames here")
@pytest.mark.parametrize("index", [100, 300, 700])
def test_spread_on_a_real_frame(index):
    image = cv2.imread(str(sorted(REAL_FRAMES.iterdir())[index]), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    height, width = image.shape
    theirs = cv2.ORB_create(1000).detect(image)
    assert occupied_cells([k.pt for k in theirs], width, height) < 100
    assert occupied_cells(extract(image).xy, width, height) >= 170


def dots(rng, scale):
    """Blobs at known sub-pixel centres, each one corner on the level with this scale."""
    sigma, step = 1.1 * scale, max(12 * scale, 14)
    grid = np.meshgrid(
        np.arange(24 * scale, 633 - 24 * scale, step), np.arange(24 * scale, 471 - 24 * scale, step)
    )
    centres = np.stack(grid, axis=-1).reshape(-1, 2)
    centres += rng.uniform(-0.15 * step, 0.15 * step, centres.shape)
    # Blobs do not overlap: the sum over all is a product of matrices.
    in_y = np.exp(-((np.arange(471)[:, None] - centres[:, 1]) ** 2) / (2 * sigma**2))
    in_x = np.exp(-((np.arange(633)[None] - centres[:, :1]) ** 2) / (2 * sigma**2))
    return np.clip(30 + 200 * (in_y @ in_x), 0, 255).astype(np.uint8), centres


@pytest.mark.parametrize("octave", range(8))
def test_a_point_has_the_same_position_in_every_octave(octave):
    rng = np.random.default_rng(octave)
    scale = 1.2**octave
    extractor = OrbExtractor(633, 471, OrbConfig(n_features=4000))  # sizes that no level divides evenly
    off = []
    for _ in range(4):
        image, centres = dots(rng, scale)
        features = extractor.extract(image)
        xy = features.xy[features.octave == octave]
        to_nearest = xy - centres[cKDTree(centres).query(xy, p=np.inf)[1]]
        off.append(to_nearest[np.abs(to_nearest).max(axis=1) < 2 * scale])
    off = np.concatenate(off)
    # Without the shift of pixel centres the mean would be off by 0.5 - 0.5 / scale: 0.08 in octave 1, 0.36 in
    # octave 7.
    assert len(off) > 200
    assert np.abs(off.mean(axis=0) / scale).max() < 0.05


@pytest.mark.parametrize(("dx", "dy"), [(0.5, 0.0), (0.3, 0.7), (0.25, -0.4)])
def test_corners_follow_a_shift_by_parts_of_a_pixel(dx, dy):
    image = uneven_image()
    shifted = cv2.warpAffine(
        image, np.float32([[1, 0, dx], [0, 1, dy]]), (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC
    )

    def errors(subpixel):
        a, b = (extract(each, subpixel=subpixel) for each in (image, shifted))
        matches = match_brute_force(a.descriptors, b.descriptors, 40, 0.8)
        off = b.xy[matches[:, 1]] - a.xy[matches[:, 0]] - (dx, dy)
        return np.abs(off / 1.2 ** a.octave[matches[:, 0], None])

    between, whole = errors(True), errors(False)
    assert len(between) > 300
    assert np.median(between) < 0.12
    assert np.median(between) < 0.4 * np.median(whole)


def test_a_rotated_image_gives_rotated_features():
    image = uneven_image()
    turned = np.ascontiguousarray(np.rot90(image, -1))  # (x, y) -> (HEIGHT - 1 - y, x)
    a, b = extract(image, n_levels=1), extract(turned, n_levels=1)
    expected = np.stack([HEIGHT - 1 - a.xy[:, 1], a.xy[:, 0]], axis=1)
    matches = match_brute_force(a.descriptors, b.descriptors, 40, 0.8)
    same = np.abs(expected[matches[:, 0]] - b.xy[matches[:, 1]]).max(axis=1) < 0.01
    assert len(matches) > 300 and same.mean() > 0.95
    turn = (b.angle_deg[matches[:, 1]] - a.angle_deg[matches[:, 0]])[same] % 360
    assert np.abs(turn - 90).max() < 0.01


def test_zoomed_image_is_matched_over_the_octaves():
    image = uneven_image()
    smaller = cv2.resize(image, (444, 333), interpolation=cv2.INTER_AREA)
    a, b = extract(image), extract(smaller)
    matches = match_brute_force(a.descriptors, b.descriptors, 50, 0.8)
    expected = (a.xy[matches[:, 0]] + 0.5) * (444 / WIDTH, 333 / HEIGHT) - 0.5
    right = np.abs(expected - b.xy[matches[:, 1]]).max(axis=1) < 3
    step = (a.octave[matches[:, 0]] - b.octave[matches[:, 1]])[right]
    assert right.sum() > 100 and right.mean() > 0.9
    assert abs(step.mean() - 2) < 0.3  # 640 / 444 is two steps of 1.2


def corner_image():
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    image[200:, 300:] = 220
    return image


@pytest.mark.parametrize("value", [0, 128, 255])
def test_constant_image_has_no_features(value):
    features = extract(np.full((HEIGHT, WIDTH), value, np.uint8))
    assert_well_formed(features)
    assert len(features) == 0


def test_a_single_corner_is_found_at_its_position():
    features = extract(corner_image())
    assert_well_formed(features)
    assert 1 <= len(features) <= 60
    off = np.abs(features.xy - (299.5, 199.5)).max(axis=1)
    assert (off < 4 * 1.2**features.octave).all()


@pytest.mark.parametrize("kind", ["noise", "checkers", "stripes", "saturated", "gradient"])
def test_hard_content_never_raises(kind):
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    image = {
        "noise": np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH)),
        "checkers": (u // 4 + v // 4) % 2 * 255,
        "stripes": u // 3 % 2 * 255,
        "saturated": np.where((u // 50 + v // 50) % 2, 255, 250),
        "gradient": u * 255 // WIDTH,
    }[kind].astype(np.uint8)
    features = extract(image)
    assert_well_formed(features)
    assert len(features) <= 1000


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((HEIGHT, WIDTH), np.float32), "uint8"),
        (np.zeros((HEIGHT, WIDTH), bool), "uint8"),
        (np.zeros((HEIGHT, WIDTH, 3), np.uint8), "shape"),
        (np.zeros((WIDTH, HEIGHT), np.uint8), "shape"),
        (np.zeros((0, 0), np.uint8), "shape"),
        ([[0, 1], [2, 3]], "uint8"),
        (None, "uint8"),
    ],
)
def test_wrong_image_is_refused(image, message):
    with pytest.raises(ValueError, match=message):
        OrbExtractor(WIDTH, HEIGHT).extract(image)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("n_features", 0),
        ("n_levels", 0),
        ("scale_factor", 1.0),
        ("scale_factor", float("nan")),
        ("fast_threshold", 255),
        ("fast_min_threshold", 0),
        ("fast_min_threshold", 21),
        ("cell_px", 0),
        ("noise_px", 0.0),
    ],
)
def test_wrong_config_is_refused_by_name(field, value):
    with pytest.raises(ValueError, match=field):
        OrbConfig(**{field: value})


def test_too_small_an_image_is_refused_and_the_smallest_works():
    with pytest.raises(ValueError, match="too small"):
        OrbExtractor(36, 480)
    noise = np.random.default_rng(0).integers(0, 256, (37, 37), dtype=np.uint8)
    assert_well_formed(extract(noise))


def test_config_and_features_are_frozen():
    with pytest.raises(FrozenInstanceError):
        OrbConfig().n_features = 2
    with pytest.raises(FrozenInstanceError):
        extract(corner_image()).xy = None


def test_scales_are_the_geometric_series():
    assert np.allclose(OrbConfig(n_levels=4, scale_factor=1.5).scales, [1, 1.5, 2.25, 3.375])


def test_a_repetition_is_bit_equal_and_keeps_earlier_results():
    image = uneven_image()
    extractor = OrbExtractor(WIDTH, HEIGHT)
    first = extractor.extract(image)
    kept = {c.name: getattr(first, c.name).copy() for c in fields(Features)}
    extractor.extract(np.ascontiguousarray(image[::-1]))
    assert all(np.array_equal(getattr(first, name), kept[name]) for name in kept)
    assert_equal(extractor.extract(image), first)
    assert_equal(extract(image), first)


def test_the_image_is_not_changed_and_need_not_be_contiguous():
    image = uneven_image()
    wide = np.zeros((HEIGHT, 2 * WIDTH), np.uint8)
    wide[:, ::2] = image
    wide.setflags(write=False)
    assert_equal(extract(wide[:, ::2]), extract(image))


def test_extractors_in_threads_do_not_disturb_each_other():
    image = uneven_image()
    images = [image, np.ascontiguousarray(image[:, ::-1])] * 2
    alone = [extract(i) for i in images]

    def work(i):
        extractor = OrbExtractor(WIDTH, HEIGHT)
        return [extractor.extract(i) for _ in range(3)]

    with ThreadPoolExecutor(2) as pool:
        for expected, results in zip(alone, pool.map(work, images), strict=True):
            for result in results:
                assert_equal(result, expected)


def test_shares_form_a_geometric_series_with_many_corners():
    shares = share_out(1000, 1.2, [10_000] * 8)
    assert sum(shares) == 1000
    exact = 1000 * 1.2 ** -np.arange(8.0) / (1.2 ** -np.arange(8.0)).sum()
    assert np.abs(np.array(shares) - exact).max() <= 1.5


@pytest.mark.parametrize(
    "n_corners", [[0] * 8, [5] * 8, [0, 0, 0, 900, 800, 400, 200, 90], [4000, 0, 3, 0, 0, 1, 0, 0], [1]]
)
@pytest.mark.parametrize("n_features", [1, 5, 100, 1000])
def test_shares_are_limited_by_the_corners(n_corners, n_features):
    shares = share_out(n_features, 1.2, n_corners)
    assert all(0 <= share <= n for share, n in zip(shares, n_corners, strict=True))
    assert sum(shares) == min(n_features, sum(n_corners))


def test_other_levels_take_over_the_share_of_a_blurred_level():
    smooth = cv2.GaussianBlur(uneven_image(), (0, 0), 5.0).astype(float)
    features = extract(np.clip(120 + 2 * (smooth - 120), 0, 255).astype(np.uint8))
    assert (features.octave == 0).sum() < 150  # of 217 in the series
    assert len(features) >= 900  # 831 if each level kept to its own share


def test_features_are_remembered_by_content_and_shared_by_copies():
    images, found = [np.full((8, 8), v, np.uint8) for v in range(3)], []
    remembered = Remembered(2)
    same = deepcopy(remembered)
    for v in (0, 1, 0, 2, 0, 1):
        result = same.of(images[v].copy(), lambda image: found.append(int(image[0, 0])) or image.sum())
        assert result == 64 * v
    # Of two, the one used longest ago is forgotten: 1 is found anew, 0 is not; an empty result counts too.
    assert found == [0, 1, 2, 1]
    assert same is remembered and remembered.of(images[1], lambda image: -1) == 64
    assert remembered.of(images[1], lambda image: -1, "another kind") == -1


def test_an_extractor_that_remembers_finds_the_same():
    rng = np.random.default_rng(8)
    image = cv2.GaussianBlur(rng.integers(0, 256, (240, 320), dtype=np.uint8), (0, 0), 2.0)
    plain, again = OrbExtractor(320, 240), OrbExtractor(320, 240, remembered=Remembered(4))
    first = again.extract(image)
    assert deepcopy(again).extract(image) is first
    for name in ("xy", "octave", "angle_deg", "response", "descriptors"):
        np.testing.assert_array_equal(getattr(first, name), getattr(plain.extract(image), name))
