"""Motion blur: against averaged sub-frames, against NumPy, and its limits."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.scenarios.seeds import rng_for
from dslab.sim.rendering.mujoco_renderer import MujocoRenderer
from dslab.sim.sensors import exposure
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.exposure import expose
from dslab.sim.sensors.tone import linear_to_srgb, srgb_to_linear
from dslab.sim.worlds.base import Surface, WorldModel

CAMERA = Intrinsics(320, 240, 250.0, 260.0, 150.0, 125.0, 30.0)


def moved(offset_m=(0.0, 0.0, 0.0), turn_deg=(0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.deg2rad(turn_deg)).as_matrix()
    T[:3, 3] = offset_m
    return T


def texture(seed: int, size: int = 512) -> np.ndarray:
    noise = rng_for(seed, "texture").standard_normal((size, size)).astype(np.float32)
    mixed = sum(cv2.GaussianBlur(noise, (0, 0), s) * s for s in (2, 5, 15))
    return cv2.normalize(mixed, None, 10, 245, cv2.NORM_MINMAX).astype(np.uint8)


def slanted_walls() -> WorldModel:
    """Two walls meeting in a corner in front of the camera at the origin looking along +x."""
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    triangles = np.array([[0, 2, 1], [0, 3, 2]], np.int32)
    left = np.array([[1.0, 3, 2], [4, 0, 2], [4, 0, -2], [1, 3, -2]])
    right = np.array([[4.0, 0, 2], [2, -3, 2], [2, -3, -2], [4, 0, -2]])
    walls = [
        Surface(v, t, uv, texture(i), f"wall {i}") for i, v in enumerate((left, right)) for t in (triangles,)
    ]
    return WorldModel(walls, 128.0)


@pytest.fixture(scope="module")
def renderer():
    made = MujocoRenderer(slanted_walls(), CAMERA)
    yield made
    made.close()


LOOK_ALONG_X = np.eye(4)
LOOK_ALONG_X[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]


@pytest.mark.parametrize(
    ("offset_m", "turn_deg"),
    [((0.16, 0.0, 0.0), (0, 0, 0)), ((0.12, 0.05, 0.2), (0.8, 0.4, 2.0))],
    ids=["translation", "everything"],
)
def test_blur_is_the_mean_of_rendered_sub_frames_in_linear_light(renderer, offset_m, turn_deg):
    half_offset, half_turn = np.array(offset_m) / 2, np.array(turn_deg) / 2
    at = [moved(s * half_offset, s * half_turn) for s in (np.arange(64) + 0.5) / 32 - 1]
    light = [srgb_to_linear(renderer.render(LOOK_ALONG_X @ T)[0] / 255) for T in at]
    truth = 255 * linear_to_srgb(np.mean(light, axis=0))

    sharp, depth_m = renderer.render(LOOK_ALONG_X)
    opening, closing = moved(-half_offset, -half_turn), moved(half_offset, half_turn)
    blurred, length_px = expose(sharp, depth_m, CAMERA, opening, closing)
    assert 10 < length_px < 24
    # Within the frame's border, where the light comes from inside the sharp frame.
    inside = np.s_[12:-12, 12:-12]
    error = blurred[inside] - truth[inside]
    assert 10 * np.log10(255**2 / np.mean(error**2)) >= 38
    plain = sharp[inside] - truth[inside]
    assert 10 * np.log10(255**2 / np.mean(plain**2)) < 32


def integrate_in_numpy(gray, linear, depth_m, k, T_open, T_close):
    """The kernel in double precision, all pixels at once, at the sample count of each pixel."""
    rows, columns = np.mgrid[: gray.shape[0], : gray.shape[1]].astype(float)
    pixels = np.stack([columns, rows])

    def shift(T):
        rays = np.stack([(columns - k[2]) / k[0], (rows - k[3]) / k[1], np.ones_like(rows)])
        z = np.where(depth_m > 0, depth_m, 1e4)
        to = np.einsum("ij,jhw->ihw", T[:, :3], rays * z) + T[:, 3, None, None]
        return np.stack([k[0] * to[0] / to[2] + k[2], k[1] * to[1] / to[2] + k[3]]) - pixels

    opening, closing = shift(T_open.astype(float)), shift(T_close.astype(float))
    length = np.linalg.norm(closing - opening, axis=0)
    count = np.clip(np.floor(length / exposure.PX_PER_SAMPLE) + 1, 2, exposure.MAX_SAMPLES)
    light, seen = np.zeros(gray.shape), np.zeros(gray.shape)
    for sample in range(exposure.MAX_SAMPLES):
        s = (2 * sample + 1) / count - 1
        x, y = pixels + s * (closing - opening) / 2 + s * s * (closing + opening) / 2
        use = (sample < count) & (x >= 0) & (y >= 0) & (x < gray.shape[1] - 1) & (y < gray.shape[0] - 1)
        left, top = (np.where(use, np.floor(a), 0).astype(int) for a in (x, y))
        fx, fy = x - left, y - top
        value = (1 - fy) * ((1 - fx) * linear[top, left] + fx * linear[top, left + 1])
        value += fy * ((1 - fx) * linear[top + 1, left] + fx * linear[top + 1, left + 1])
        light += np.where(use, value, 0)
        seen += use
    mean = 255 * linear_to_srgb(light / np.maximum(seen, 1))
    return np.where((length < exposure.SHARP_PX) | (seen == 0), gray, mean), length


@pytest.mark.parametrize("px", [0.1, 7.0, 60.0])
def test_the_kernel_agrees_with_numpy(px):
    rng = np.random.default_rng(3)
    gray = texture(5, 64)[:48]
    depth_m = rng.uniform(1.5, 2.5, gray.shape).astype(np.float32)
    depth_m[:4] = 0
    k = np.array([50, 52, 30.5, 25], np.float32)
    T_open = moved((-px / 50, 0.2 * px / 50, 0.01), (0, 0, -px / 30))[:3].astype(np.float32)
    T_close = moved((px / 50, 0.0, 0.02), (0.1, 0, px / 20))[:3].astype(np.float32)
    linear = exposure.DECODE[gray]
    no_outlines = np.full((6, 8), -1, np.float32)
    out = exposure.integrate(gray, linear, depth_m, k, T_open, T_close, exposure.ENCODE, no_outlines)
    expected, length = integrate_in_numpy(gray, linear, depth_m, k, T_open, T_close)
    # Where a length lies on the edge between two sample counts, single precision may take the other.
    steps = length / exposure.PX_PER_SAMPLE
    sure = (np.abs(steps - np.rint(steps)) > 1e-3) & (np.abs(length - exposure.SHARP_PX) > 1e-3)
    assert sure.mean() > 0.9
    # A sample on the frame's edge may count in one and not in the other.
    assert np.quantile(np.abs(out - expected)[sure], 0.99) <= 1.0
    on_grid = exposure.smear_lengths(depth_m, k, T_open, T_close)
    np.testing.assert_allclose(on_grid, length[::16, ::16].ravel(), rtol=1e-3, atol=1e-3)


def test_linear_light_is_summed():
    """Half black, half white over the exposure is half the light: level 188, not 128."""
    stripes = np.where(np.arange(320) // 16 % 2, 255, 0).astype(np.uint8)
    gray = np.tile(stripes, (240, 1))
    depth_m = np.full(gray.shape, 2.0, np.float32)
    half = moved((16 / CAMERA.fx * 2.0, 0, 0))
    blurred, length_px = expose(gray, depth_m, CAMERA, np.linalg.inv(half), half)
    assert length_px == pytest.approx(32, abs=0.1)
    assert abs(np.median(blurred[:, 40:-40]) - 188) < 6


def test_without_motion_the_frame_stays_as_it_was():
    gray = texture(0, 320)[:240]
    depth_m = np.full(gray.shape, 2.0, np.float32)
    before = gray.copy()
    out, length_px = expose(gray, depth_m, CAMERA, np.eye(4), np.eye(4))
    np.testing.assert_array_equal(out, gray)
    assert length_px == 0
    assert out is not gray
    expose(gray, depth_m, CAMERA, moved((-0.1, 0, 0)), moved((0.1, 0, 0)))
    np.testing.assert_array_equal(gray, before)


def test_the_transfer_curve_is_its_own_inverse_and_covers_every_level():
    levels = np.arange(256) / 255
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(levels)), levels, atol=1e-6)
    codes = np.rint(srgb_to_linear(levels) * (len(exposure.ENCODE) - 1)).astype(int)
    np.testing.assert_array_equal(exposure.ENCODE[codes], np.arange(256))
