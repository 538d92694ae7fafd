"""Motion blur at outlines: against layers moved exactly, against NumPy, and without outlines."""

import cv2
import numpy as np
import pytest

from dslab.scenarios.seeds import rng_for
from dslab.sim.sensors import exposure, outlines
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.exposure import expose
from dslab.sim.sensors.tone import linear_to_srgb, srgb_to_linear

CAMERA = Intrinsics(160, 120, 100.0, 100.0, 79.5, 59.5, 30.0)
K = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy], np.float32)
SHAPE = (CAMERA.height_px, CAMERA.width_px)
NEAR_M, FAR_M = 1.0, 4.0
CARD = np.s_[40:90, 60:100]


def texture(seed: int, low: float, high: float) -> np.ndarray:
    noise = rng_for(seed, "texture").standard_normal(SHAPE).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3), None, low, high, cv2.NORM_MINMAX).astype(
        np.uint8
    )


def card_before_wall() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sharp frame, its depth, the wall behind the card, and where the card is."""
    wall, card = texture(1, 20, 110), np.zeros(SHAPE, bool)
    card[CARD] = True
    depth_m = np.where(card, NEAR_M, FAR_M).astype(np.float32)
    return np.where(card, texture(2, 170, 250), wall), depth_m, wall, card


def sideways(offset_m: float) -> np.ndarray:
    T = np.eye(4)
    T[0, 3] = offset_m
    return T


def moved_by(image: np.ndarray, shift_px: float) -> np.ndarray:
    there = np.array([[1, 0, shift_px], [0, 1, 0]])
    return cv2.warpAffine(image.astype(np.float32), there, SHAPE[::-1], borderMode=cv2.BORDER_REPLICATE)


def psnr_db(image: np.ndarray, truth: np.ndarray, where: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / np.mean((image - truth)[where] ** 2)))


def test_a_near_card_smears_over_the_far_wall_and_uncovers_it():
    sharp, depth_m, wall, card = card_before_wall()
    half_m = 0.12
    light = np.zeros(SHAPE)
    for s in (np.arange(64) + 0.5) / 32 - 1:
        near_px, far_px = (-s * half_m * CAMERA.fx / z for z in (NEAR_M, FAR_M))
        cover = moved_by(card, near_px)
        moved_card = moved_by(srgb_to_linear(sharp / 255) * card, near_px)
        light += moved_card + (1 - cover) * moved_by(srgb_to_linear(wall / 255), far_px)
    truth = 255 * linear_to_srgb(light / 64)

    image, _ = expose(sharp, depth_m, CAMERA, sideways(-half_m), sideways(half_m))
    sides = np.zeros(SHAPE, bool)
    sides[40:90, 46:74] = sides[40:90, 86:114] = True
    assert psnr_db(image, truth, sides) >= 36

    # The same with one depth along each pixel's path, as it is away from outlines.
    opening, closing = (np.ascontiguousarray(sideways(x)[:3], np.float32) for x in (-half_m, half_m))
    linear, nowhere = exposure.DECODE[sharp], np.full((15, 20), -1, np.float32)
    plain = exposure.integrate(sharp, linear, depth_m, K, opening, closing, exposure.ENCODE, nowhere)
    assert psnr_db(plain, truth, sides) < 26
    away = np.ones(SHAPE, bool)
    away[24:112, 32:128] = False
    np.testing.assert_array_equal(image[away], plain[away])


def test_a_card_uncovers_the_wall_beside_it_and_never_itself():
    sharp, depth_m, _, card = card_before_wall()
    sharp = np.where(card, 255, 40).astype(np.uint8)
    image, _ = expose(sharp, depth_m, CAMERA, sideways(-0.25), sideways(0.25))
    # Just inside the card's right edge: the card in the first half, then wall that the sharp frame hides.
    half_of_each = 255 * linear_to_srgb(0.53 + 0.47 * srgb_to_linear(np.array(40 / 255)))
    assert abs(float(np.median(image[45:85, 98])) - half_of_each) < 12
    np.testing.assert_array_equal(image[45:85, 128:150], 40)


def integrate_in_numpy(linear, inverse_depth, T_open, T_close, near, far, row, column):
    """One pixel in double precision, its rays followed in steps of a tenth of a pixel."""

    def places(T, inverse):
        ray = T[:, :3] @ [(column - K[2]) / K[0], (row - K[3]) / K[1], 1]
        # The point on the ray that the sharp frame sees at this inverse depth.
        z = (1 / inverse - T[2, 3]) / ray[2]
        to = (ray * z + T[:, 3]) * inverse
        return np.array([K[0] * to[0] + K[2] - column, K[1] * to[1] + K[3] - row])

    ends = [[places(T.astype(float), m) for T in (T_open, T_close)] for m in (near, far)]
    length = max(np.linalg.norm(closing - opening) for opening, closing in ends)
    count = int(np.clip(length / outlines.PX_PER_RAY + 1, 2, outlines.MAX_RAYS))
    samples = []
    for s in (2 * np.arange(count) + 1) / count - 1:
        begin, end = (np.array([column, row]) + s * (c - o) / 2 + s * s * (c + o) / 2 for o, c in ends)
        parts = np.linspace(0, 1, 10 * int(np.abs(end - begin).max() + 1) + 1)
        way = begin + parts[:, None] * (end - begin)
        met = inverse_depth[tuple(np.rint(way[:, ::-1]).astype(int).T)]
        at = np.flatnonzero(np.abs(met - (near + parts * (far - near))) < 0.06)
        if len(at):
            x, y = begin + (near - met[at[0]]) / (near - far) * (end - begin)
            samples.append(cv2.getRectSubPix(linear, (1, 1), (float(x), float(y)))[0, 0])
    return np.mean(samples), len(samples) == count


def test_the_kernel_agrees_with_numpy_where_nothing_is_hidden():
    sharp, depth_m, _, _ = card_before_wall()
    linear, inverse_depth = exposure.DECODE[sharp], outlines.inverse_depths(depth_m)
    T_open, T_close = (np.ascontiguousarray(sideways(x)[:3], np.float32) for x in (-0.12, 0.12))
    T_close[2, 3] = 0.05
    near, far = outlines.outline_tiles(inverse_depth, K, T_open, T_close)
    out = sharp.copy()
    outlines.integrate_outlines(out, linear, inverse_depth, K, T_open, T_close, exposure.ENCODE, near, far)
    errors = []
    for row in range(44, 88, 4):
        for column in range(48, 112, 3):
            tile = row // outlines.TILE_PX, column // outlines.TILE_PX
            if near[tile] < 0:
                continue
            mean, all_met = integrate_in_numpy(
                linear, inverse_depth, T_open, T_close, near[tile], far[tile], row, column
            )
            if all_met:
                errors.append(abs(out[row, column] - 255 * linear_to_srgb(mean)))
    assert len(errors) > 60
    # On an outline, a ray may meet either of two neighbouring pixels.
    assert np.median(errors) <= 1.0
    assert np.quantile(errors, 0.9) <= 6.0


@pytest.mark.parametrize("name", ["wall", "ground"])
def test_smooth_surfaces_have_no_outlines(name):
    rows = np.arange(SHAPE[0], dtype=np.float32)[:, None] * np.ones(SHAPE[1], np.float32)
    inverse_depth = (
        np.full(SHAPE, 0.25, np.float32) if name == "wall" else np.maximum(rows - 59.5, 0.01) / 150
    )
    T_open, T_close = (np.ascontiguousarray(sideways(x)[:3], np.float32) for x in (-0.12, 0.12))
    near, far = outlines.outline_tiles(inverse_depth.astype(np.float32), K, T_open, T_close)
    assert (near == -1).all()
    assert (far == -1).all()


def test_turning_alone_has_no_outlines():
    _, depth_m, _, _ = card_before_wall()
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.array([0.02, 0.3, 0.1]))[0]
    opening, closing = (np.ascontiguousarray(T[:3], np.float32) for T in (turn.T, turn))
    near, _ = outlines.outline_tiles(outlines.inverse_depths(depth_m), K, opening, closing)
    assert (near == -1).all()


@pytest.mark.parametrize("turn_rad", [0.5, 3.1])
def test_any_motion_gives_a_frame(turn_rad):
    sharp, depth_m, _, _ = card_before_wall()
    T = sideways(1.5)
    T[2, 3] = 1.2
    T[:3, :3] = cv2.Rodrigues(np.array([0.1, turn_rad, 0.2]))[0]
    before = sharp.copy(), depth_m.copy()
    image, _ = expose(sharp, depth_m, CAMERA, np.linalg.inv(T), T)
    again, _ = expose(sharp, depth_m, CAMERA, np.linalg.inv(T), T)
    np.testing.assert_array_equal(image, again)
    np.testing.assert_array_equal(sharp, before[0])
    np.testing.assert_array_equal(depth_m, before[1])
