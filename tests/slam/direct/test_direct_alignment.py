"""Photometric alignment: twins of the kernels, derivatives, known motions, images without content."""

import cv2
import numpy as np
import pytest
from numba import njit

from dslab.slam.core.camera import PinholeCamera
from dslab.slam.direct._alignment_kernels import (
    PATTERN,
    damped_system,
    linearise,
    mean_costs,
    model_of_step,
    residual_bound,
    residual_energy,
    sample_patterns,
)
from dslab.slam.direct._blur_kernels import line_of_light
from dslab.slam.direct._outer_products import add_outer_products
from dslab.slam.direct.alignment import Reference, align
from dslab.slam.direct.pyramid import ImagePyramid, Rectifier
from dslab.slam.direct.selection import select
from dslab.slam.optimization._se3 import retract

WIDTH, HEIGHT = 320, 240
CAMERA = PinholeCamera(WIDTH, HEIGHT, 250.0, 250.0, 159.5, 119.5, 30.0)
RECTIFIER = Rectifier(CAMERA)
TEXTURE = cv2.GaussianBlur(np.random.default_rng(1).normal(size=(1200, 1200)).astype(np.float32), (0, 0), 4.0)
TEXTURE = 120 + 45 * TEXTURE / TEXTURE.std()
HUBER, CUTOFF = 9.0, 60.0


def motion(twist):
    T = np.eye(4)
    retract(np.eye(4), np.asarray(twist, float), T)
    return T


def plane_depth(T_cam_world):
    """(H, W) depth of the textured plane z = 2 + .3 x, seen from a camera, and (H, W, 2) place on it."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    rays = np.stack([(x - 159.5) / 250, (y - 119.5) / 250, np.ones_like(x)], axis=-1)
    R, centre = T_cam_world[:3, :3].T, -T_cam_world[:3, :3].T @ T_cam_world[:3, 3]
    d = rays @ R.T
    depth = (2.0 + 0.3 * centre[0] - centre[2]) / (d[..., 2] - 0.3 * d[..., 0])
    return depth, (centre + depth[..., None] * d)[..., :2]


def view(T_cam_world, gain=1.0, offset=0.0):
    """Image of the plane and its depth."""
    depth, at = plane_depth(T_cam_world)
    place = (300 * at + 600).astype(np.float32)
    image = cv2.remap(TEXTURE, place[..., 0], place[..., 1], cv2.INTER_LINEAR, None, cv2.BORDER_REFLECT)
    return np.clip(gain * image + offset, 0, 255).astype(np.uint8), depth


def reference():
    image, depth = view(np.eye(4))
    pyramid = RECTIFIER.pyramid(image)
    xy = select(pyramid).xy
    return Reference(pyramid, RECTIFIER.intrinsics, xy, 1 / depth[xy[:, 1], xy[:, 0]])


def twin(level, camera, uv, d, intensity, weight, T, affine, huber, cutoff):
    """Energy and its model, pixel by pixel."""
    fx, fy, cx, cy = camera
    H, gradient, energy, seen, saturated = np.zeros((8, 8)), np.zeros(8), 0.0, 0, 0
    for i, k in np.argwhere(weight > 0):
        u, v = uv[i] + PATTERN[k]
        X = T[:3, :3] @ [(u - cx) / fx, (v - cy) / fy, 1.0] + T[:3, 3] * d[i]
        if X[2] <= 1e-6:
            continue
        x, y = X[:2] / X[2]
        u, v = fx * x + cx, fy * y + cy
        if not (0 <= u < level.shape[1] - 1 and 0 <= v < level.shape[0] - 1):
            continue
        c, r = int(u), int(v)
        p, q = u - c, v - r
        corners = level[r : r + 2, c : c + 2].astype(float)
        value = np.einsum("y,x,yxc->c", [1 - q, q], [1 - p, p], corners)
        residual = value[0] - np.exp(affine[0]) * intensity[i, k] - affine[1]
        if abs(residual) > cutoff:
            energy += weight[i, k] * huber * (2 * cutoff - huber)
            seen, saturated = seen + 1, saturated + 1
            continue
        if not np.isfinite(value).all():
            continue
        size, near = abs(residual), d[i] / X[2]
        energy += weight[i, k] * (size**2 if size <= huber else huber * (2 * size - huber))
        seen += 1
        image = np.array([value[1] * fx, value[2] * fy])
        moves = np.array(
            [[near, 0, -near * x, -x * y, 1 + x * x, -y], [0, near, -near * y, -1 - y * y, x * y, x]]
        )
        J = np.append(image @ moves, [-np.exp(affine[0]) * intensity[i, k], -1.0])
        w = weight[i, k] * min(1.0, huber / size if size else 1.0)
        H += w * np.outer(J, J)
        gradient += w * J * residual
    return energy, seen, saturated, H, gradient


@pytest.mark.parametrize("level", [0, 2])
def test_kernels_equal_their_twins(level):
    ref, rng = reference(), np.random.default_rng(2)
    target = RECTIFIER.pyramid(view(motion([0.05, 0.02, -0.04, 0.01, -0.02, 0.03]))[0]).levels[level].copy()
    target[20:30, 5:15] = np.nan
    p, camera = ref.levels[level], ref.intrinsics[level]
    some = rng.choice(len(p.uv), 150, replace=False)
    args = p.uv[some], p.inverse_depth[some]
    patches = p.intensity[some], p.weight[some]
    T, affine = motion([0.04, 0, -0.03, 0.02, -0.01, 0.03]), np.array([0.1, -5.0])
    H, gradient = np.empty((8, 8)), np.empty(8)
    found = linearise(target, camera, *args, PATTERN, *patches, T, affine, HUBER, 25.0, H, gradient)
    expected = twin(target, camera, *args, *patches, T, affine, HUBER, 25.0)
    assert 0 < found[2] < found[1] == expected[1] and found[2] == expected[2]
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-9)
    np.testing.assert_allclose(H, expected[3], rtol=1e-9, atol=1e-9 * np.abs(H).max())
    np.testing.assert_allclose(gradient, expected[4], rtol=1e-9, atol=1e-9 * np.abs(gradient).max())
    alone = residual_energy(target, camera, *args, PATTERN, *patches, T, affine, HUBER, 25.0)
    # It needs no gradients, which are unknown one pixel farther in from what is unknown itself.
    assert 0 <= alone[1] - found[1] < 0.05 * found[1]
    np.testing.assert_allclose(alone[0] / alone[1], found[0] / found[1], rtol=0.05)
    bound = residual_bound(target, camera, *args, PATTERN, *patches, T, affine, 0.0)
    deviation = bound / 3
    within = residual_energy(target, camera, *args, PATTERN, *patches, T, affine, HUBER, deviation / 1.4826)
    assert within[2] == pytest.approx(0.5 * within[1], abs=1)


@njit
def outer_products(J, w, r, count, sums):
    add_outer_products(J, w, r, count, sums)


def test_outer_products_have_the_bits_of_plain_loops():
    rng, count = np.random.default_rng(4), 50
    J, w, r = rng.normal(0, 30, (count + 3, 8)), rng.random(count + 3), rng.normal(0, 9, count + 3)
    sums, expected = np.ones((9, 8)), np.ones((9, 8))
    outer_products(J, w, r, count, sums)
    for i in range(count):
        for m in range(8):
            expected[8, m] += w[i] * J[i, m] * r[i]
            for n in range(8):
                expected[m, n] += w[i] * J[i, m] * J[i, n]
    np.testing.assert_array_equal(sums, expected)


def test_a_step_is_the_damped_minimum_of_the_model_and_its_cost_that_of_the_moved_alignment():
    ref, rng = reference(), np.random.default_rng(5)
    target, p = RECTIFIER.pyramid(view(motion([0.02, 0, 0, 0, 0.01, 0]))[0]), ref.levels[1]
    views = (target.levels[1], ref.intrinsics[1], p.uv, p.inverse_depth, PATTERN, p.intensity, p.weight)
    T, affine, step, prior = np.eye(4), np.array([0.1, -2.0]), rng.normal(0, 0.01, 8), np.array([900.0, 0.2])
    there, affine_there, H, gradient = np.eye(4), np.empty(2), np.empty((8, 8)), np.empty(8)
    cost = model_of_step(*views, T, affine, step, HUBER, 25.0, prior, 100.0, there, affine_there, H, gradient)
    np.testing.assert_allclose(there, motion(step[:6]), atol=1e-12)
    np.testing.assert_array_equal(affine_there, affine + step[6:])
    H_alone, gradient_alone = np.empty((8, 8)), np.empty(8)
    energy, seen, _ = linearise(*views, there, affine_there, HUBER, 25.0, H_alone, gradient_alone)
    np.testing.assert_allclose(cost, (energy + prior @ affine_there**2) / seen, rtol=1e-12)
    np.testing.assert_allclose(H - H_alone, np.diag([0.0] * 6 + [900.0, 0.2]), atol=1e-6)
    np.testing.assert_allclose(gradient - gradient_alone, [0.0] * 6 + list(prior * affine_there), atol=1e-6)
    scale, A, b = rng.random(8), np.empty((8, 8)), np.empty(8)
    damped_system(H, gradient, scale, 0.3, 1e-9, A, b)
    D = np.diag(scale)
    np.testing.assert_allclose(A, D @ (H + 0.3 * np.diag(H.diagonal())) @ D + 1e-9 * np.eye(8), rtol=1e-12)
    np.testing.assert_allclose(b, scale * gradient, rtol=1e-12)


def test_mean_costs_are_infinite_where_too_little_is_in_view():
    ref = reference()
    target, p = RECTIFIER.pyramid(view(np.eye(4))[0]), ref.levels[2]
    views = (target.levels[2], ref.intrinsics[2], p.uv, p.inverse_depth, PATTERN, p.intensity, p.weight)
    T = np.array([np.eye(4), motion([0, 0, 0, 0, 1.5, 0])])
    affine, prior = np.array([[0.2, 1.0], [0.2, 1.0]]), np.array([900.0, 0.2])
    costs = mean_costs(*views, T, affine, HUBER, 25.0, prior, p.least_pixels)
    energy, seen, _ = residual_energy(*views, T[0], affine[0], HUBER, 25.0)
    np.testing.assert_allclose(costs, [(energy + prior @ affine[0] ** 2) / seen, np.inf], rtol=1e-12)


@pytest.mark.parametrize("direction", [[1.0, 0.0], [0.6, -0.8]])
def test_a_line_of_light_holds_all_of_it_about_the_middle(direction):
    light = line_of_light(np.array(direction), np.linspace(-3.0, 3.0, 28), 9)
    y, x = np.mgrid[-4:5, -4:5]
    assert light.dtype == np.float32
    np.testing.assert_allclose(light.sum(), 28, rtol=1e-6)
    np.testing.assert_allclose([(light * x).sum(), (light * y).sum()], [0, 0], atol=1e-4)
    on_line = np.abs(x * direction[1] - y * direction[0]) < np.sqrt(2)
    assert (light[~on_line] == 0).all() and (light[on_line] > 0).sum() >= 7


@pytest.mark.slow
def test_the_gradient_is_the_derivative_of_the_energy():
    """On an image that bilinear interpolation and central differences reproduce exactly."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    level = np.full((HEIGHT, WIDTH, 3), np.nan)
    level[..., 0] = 20 + 0.3 * x + 0.4 * y + 0.002 * x * y
    level[..., 1], level[..., 2] = 0.3 + 0.002 * y, 0.4 + 0.002 * x
    rng = np.random.default_rng(3)
    uv, d = rng.uniform([40, 40], [280, 200], (60, 2)), rng.uniform(0.2, 1.0, 60)
    intensity, weight = np.empty((60, 8)), np.empty((60, 8))
    sample_patterns(level, uv, PATTERN, 50.0, intensity, weight)
    assert (weight > 0.9).all()
    intensity += rng.normal(0, 12, intensity.shape)
    T, affine = motion([0.1, -0.05, 0.1, 0.02, 0.03, -0.05]), np.array([0.05, 3.0])
    camera = RECTIFIER.intrinsics[0]

    def energy(step):
        moved = np.eye(4)
        retract(T, np.ascontiguousarray(step[:6]), moved)
        return residual_energy(
            level, camera, uv, d, PATTERN, intensity, weight, moved, affine + step[6:], HUBER, 1e9
        )[0]

    H, gradient = np.empty((8, 8)), np.empty(8)
    linearise(level, camera, uv, d, PATTERN, intensity, weight, T, affine, HUBER, 1e9, H, gradient)
    h = 1e-6
    numeric = [(energy(h * e) - energy(-h * e)) / (4 * h) for e in np.eye(8)]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-6, atol=1e-6 * np.abs(gradient).max())


@pytest.mark.parametrize("brightness", [(1.0, 0.0), (0.8, 15.0)])
@pytest.mark.parametrize(
    "twist", [np.zeros(6), [0.1, 0.04, -0.08, 0.01, -0.02, 0.04], [0, 0, 0, 0.02, 0.03, -0.06]]
)
def test_a_known_motion_is_found(twist, brightness):
    ref, T = reference(), motion(twist)
    found = align(ref, RECTIFIER.pyramid(view(T, *brightness)[0]), [np.eye(4)])
    assert found is not None and found.visible > 0.6 and found.saturated < 0.05 and found.error < 4
    off = np.linalg.inv(T) @ found.T_target_ref
    assert np.linalg.norm(off[:3, 3]) < 0.002 * ref.depth
    assert np.degrees(np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1))) < 0.05
    np.testing.assert_allclose(np.exp(found.affine[0]), brightness[0], atol=0.05)
    assert np.linalg.eigvalsh(found.information).min() > 0


def test_the_best_of_several_guesses_is_followed():
    turn = motion([0, 0, 0, 0.0, 0.5, 0.0])
    ref, target = reference(), RECTIFIER.pyramid(view(turn)[0])
    lost = align(ref, target, [np.eye(4)])
    assert lost is None or not np.allclose(lost.T_target_ref, turn, atol=0.02)
    near = [np.eye(4), motion([0, 0, 0, 0, -0.45, 0]), motion([0, 0, 0, 0, 0.45, 0])]
    np.testing.assert_allclose(align(ref, target, near).T_target_ref, turn, atol=2e-3)


@pytest.mark.parametrize("value", [0, 255])
def test_an_image_without_content_raises_nothing(value):
    blank = RECTIFIER.pyramid(np.full((HEIGHT, WIDTH), value, np.uint8))
    found = align(reference(), blank, [np.eye(4)])
    assert found is None or found.error > 9 or found.saturated > 0.5 or np.isfinite(found.T_target_ref).all()
    empty = Reference(blank, RECTIFIER.intrinsics, np.empty((0, 2)), np.empty(0))
    assert align(empty, blank, [np.eye(4)]) is None


def test_a_view_of_something_else_is_too_little_in_common():
    away = motion([0, 0, 0, 0, 3.0, 0])
    assert align(reference(), RECTIFIER.pyramid(view(np.eye(4))[0]), [away]) is None
    nothing = ImagePyramid(
        tuple(np.full_like(x, np.nan) for x in RECTIFIER.pyramid(view(np.eye(4))[0]).levels)
    )
    assert align(reference(), nothing, [np.eye(4)]) is None
