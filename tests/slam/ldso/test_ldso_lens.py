"""The lens from windows: derivatives, elimination, a known lens found, a system that goes on with it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from ldso_scenes import (
    CAMERA,
    CONFIG,
    HEIGHT,
    INTRINSICS,
    POSES,
    RECTIFIER,
    WIDTH,
    motion,
    position_error,
    round_room,
    smooth_level,
    window_of,
)

from dslab.slam.config import SlamConfig
from dslab.slam.core import events as ev
from dslab.slam.core.camera import undistort_residual
from dslab.slam.direct.pyramid import Rectifier
from dslab.slam.factory import build_system
from dslab.slam.ldso.adjustment import adjust, affine_prior, gauge
from dslab.slam.ldso.config import LensConfig
from dslab.slam.ldso.lens import LensEstimator, displacements, lens_information, lens_model
from dslab.slam.ldso.model import model_of
from dslab.slam.ldso.replay import replayed
from dslab.slam.ldso.start import Starter, Waiting
from dslab.slam.ldso.system import DsoSlam

PHOTOMETRIC = CONFIG.photometric
LENS = (0.03, -0.02, 0.002, -0.001)
RADIAL = (0.03, -0.02, 0.0, 0.0)  # on a round, decentring looks much like another turn
MORE = [motion([0.3, 0.0, 0.1, 0.0, 0.05, 0.02]), motion([0.1, -0.15, 0.15, 0.04, 0.0, -0.03])]


def taken(image, residual=LENS):
    """The image (H, W) as a camera with a residual distortion takes it."""
    x, y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    at = undistort_residual(np.column_stack([x.ravel(), y.ravel()]), residual, CAMERA.intrinsics)
    at = at.astype(np.float32).reshape(HEIGHT, WIDTH, 2)
    return cv2.remap(image, at, None, cv2.INTER_CUBIC, None, cv2.BORDER_REFLECT)


def shift_px(residual):
    """Root mean square shift over the image."""
    x, y = np.meshgrid(np.linspace(0, WIDTH - 1, 15), np.linspace(0, HEIGHT - 1, 15))
    rays = np.stack([(x - CAMERA.cx) / CAMERA.fx, (y - CAMERA.cy) / CAMERA.fy], axis=-1)
    shift = CAMERA.fx * displacements(rays) @ np.asarray(residual)
    return float(np.sqrt((shift**2).sum(axis=-1).mean()))


def test_the_model_is_the_derivative_of_the_cost(monkeypatch):
    """A change of the lens moves host pixels, and samples the other images elsewhere."""
    monkeypatch.setattr("dslab.slam.ldso.model.PATTERN", np.zeros((8, 2)))
    window = window_of(POSES[:3], 90)
    window.images[window.slots] = smooth_level()
    window.outlier[:] = 1e12
    p, (fx, fy, cx, cy) = window.active, INTRINSICS[0]
    p.intensity = p.intensity + np.random.default_rng(6).normal(0, 8, p.intensity.shape)
    p.seen = model_of(window, p, p.seen >= 0, PHOTOMETRIC.huber).seen
    model = lens_model(window, PHOTOMETRIC)
    uv, (y, x) = p.uv.copy(), np.mgrid[:HEIGHT, :WIDTH].astype(float)
    grid = np.stack([(x - cx) / fx, (y - cy) / fy], axis=-1)
    host = (uv - [cx, cy]) / [fx, fy]

    def cost(change):
        at = np.stack([x, y], axis=-1) + displacements(grid) @ change * [fx, fy]
        level = 20 + 0.3 * at[..., 0] + 0.4 * at[..., 1] + 0.002 * at[..., 0] * at[..., 1]
        window.images[window.slots, ..., 0] = level
        p.uv = uv - displacements(host) @ change * [fx, fy]
        return model_of(window, p, p.seen >= 0, PHOTOMETRIC.huber).cost

    for k, h in enumerate((1e-3, 1e-3, 1e-3, 1e-3)):
        e = np.zeros(4)
        e[k] = h
        numeric = (cost(e) - cost(-e)) / (4 * h)
        # Terms of thousands cancel, of which images of single precision leave a thousandth.
        assert numeric == pytest.approx(model.b[k], abs=1e-2 * np.abs(model.b).max())


def test_elimination_equals_a_dense_one():
    window = window_of(POSES, 200)
    lens = lens_model(window, PHOTOMETRIC)
    seen = lens.window.information > 1
    window.active = window.active.of(seen)
    lens = lens_model(window, PHOTOMETRIC)
    model, used = lens.window, np.concatenate([np.arange(8 * s, 8 * s + 8) for s in window.slots])
    strength, pull = affine_prior(window, PHOTOMETRIC)
    A = (model.H + np.diag(strength))[np.ix_(used, used)]
    dense = np.block([[A, model.cross[:, used].T], [model.cross[:, used], np.diag(model.information)]])
    link = np.concatenate([lens.with_keyframes[used], lens.with_depths])
    gradient = np.concatenate([(model.b + pull)[used], model.gradient])
    # Held still: what no image determines, of which depths have a part as well.
    still = np.concatenate([gauge(window)[used], np.zeros((len(window.active), 7))])
    dense = dense + 1e9 * still @ still.T
    H = lens.H - link.T @ np.linalg.solve(dense, link)
    b = lens.b - link.T @ np.linalg.solve(dense, gradient)
    found_H, found_b = lens_information(window, PHOTOMETRIC)
    np.testing.assert_allclose(found_H, H, rtol=1e-4, atol=1e-5 * np.abs(H).max())
    np.testing.assert_allclose(found_b, b, rtol=1e-3, atol=1e-4 * np.abs(b).max())


@pytest.mark.parametrize("residual", [(0.0, 0.0, 0.0, 0.0), LENS])
@pytest.mark.slow
def test_a_window_says_what_the_lens_is(residual):
    window = window_of(POSES + MORE, 900)
    for slot in window.slots:
        image = np.clip(window.images[slot, ..., 0], 0, 255).astype(np.uint8)
        window.see(slot, RECTIFIER.pyramid(taken(image, residual)))
    window.active = window.active.moved(window.pyramids, window.active.uv, PHOTOMETRIC)
    adjust(window, PHOTOMETRIC, 30)
    H, b = lens_information(window, PHOTOMETRIC)
    found = -np.linalg.solve(H, b)
    assert shift_px(found - residual) < 0.05 + 0.2 * shift_px(residual)


def test_windows_that_say_nothing_are_not_read():
    window = window_of(POSES + MORE, 60)
    window.active = window.active.of(np.zeros(len(window.active), bool))
    estimator = LensEstimator(CAMERA, LensConfig(every=1, least_windows=1))
    for _ in range(3):
        estimator.take(window, PHOTOMETRIC)
    assert estimator.change(1.0) is None


@pytest.fixture(scope="module")
def rounds():
    """Frames of a third of a round, and the true positions."""
    frames = list(round_room(np.linspace(0, 2.0, 70), seed=1))
    return [image for image, _ in frames], np.array([T[:3, 3] for _, T in frames])


def run(images, **lens):
    dso = replace(CONFIG, lens=replace(LensConfig(), **lens))
    system = DsoSlam(CAMERA, 0, dso=dso, loops=True)
    for number, image in enumerate(images):
        system.process(image, number / 30)
    system.finish()
    return system, [e for e in system.events if isinstance(e, ev.CameraRefined)]


@pytest.mark.slow
def test_the_system_goes_on_with_the_lens_that_it_finds(rounds):
    images, centres = rounds
    seen = [taken(image, RADIAL) for image in images]
    (system, refined), (given, none) = run(seen), run(seen, every=0)
    assert not none and refined
    assert refined[0].significance >= LensConfig().least_significance
    assert shift_px(np.subtract(system.camera.residual, RADIAL)) < 0.5 * shift_px(RADIAL)
    errors = [position_error(s.trajectories()[0], centres) for s in (system, given)]
    assert errors[0] < 0.5 * errors[1]
    kept, _ = run(seen[:20], most_replayed=0)
    anew, _ = run(seen[:20])
    paths = [s.trajectories()[0] for s in (kept, anew)]
    np.testing.assert_array_equal(paths[0].frames, paths[1].frames)
    assert position_error(paths[1], centres) < position_error(paths[0], centres)


@pytest.mark.slow
def test_a_map_begun_anew_is_that_of_a_camera_known_from_the_start(rounds):
    images = [taken(image, RADIAL) for image in rounds[0][:35]]
    camera = replace(CAMERA, residual=RADIAL)
    system = DsoSlam(camera, 0, dso=replace(CONFIG, lens=replace(LensConfig(), every=0)))
    for number, image in enumerate(images):
        system.process(image, number / 30)
    path = system.trajectories()[0]
    frames = [Waiting(k, k / 30, image) for k, image in enumerate(images) if k >= path.frames[0]]
    rectifier = Rectifier(camera)
    starter = Starter(camera, rectifier.intrinsics, rectifier.pyramid, 0, SlamConfig(), system.dso)
    again = replayed(frames, starter, rectifier, 0).odometry.trajectory(0)
    np.testing.assert_array_equal(again.frames, path.frames)
    np.testing.assert_array_equal(again.T_map_cam, path.T_map_cam)


@pytest.mark.slow
def test_a_lens_that_is_as_given_is_left_alone(rounds):
    images, _ = rounds
    system, refined = run(images)
    assert not refined and system.camera.residual == (0.0, 0.0, 0.0, 0.0)
    assert build_system("dso", CAMERA).settings["dso"]["lens"]["every"] == LensConfig().every


@pytest.mark.parametrize("count", [5, 30])
@pytest.mark.slow
def test_chance_alone_is_rarely_significant(monkeypatch, count):
    """How far a few windows scatter is not well known: they have to say the same more clearly than many."""
    rng, root = np.random.default_rng(count), np.diag([300.0, 100.0, 500.0, 400.0])
    monkeypatch.setattr(
        "dslab.slam.ldso.lens.lens_information", lambda *_: (root @ root, root @ rng.normal(size=4))
    )
    window, bar, n = window_of(POSES + MORE, 8), 9.49, 600  # by chance once in twenty
    config = LensConfig(
        every=1, least_windows=count, least_significance=bar, least_shift_px=0.0, most_share=1.0
    )
    found = 0
    for _ in range(n):
        estimator = LensEstimator(CAMERA, config)
        for _ in range(count):
            estimator.take(window, PHOTOMETRIC)
        found += estimator.change(1.0) is not None
    assert 0.03 < found / n < 0.07
