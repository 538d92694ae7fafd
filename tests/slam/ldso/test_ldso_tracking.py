"""Tracker: twins of its kernels, and known motions against exact depths."""

import numpy as np
import pytest
from ldso_scenes import CAMERA, CONFIG, INTRINSICS, RECTIFIER, motion, view

from dslab.slam.direct.selection import select
from dslab.slam.ldso._reference_kernels import gather, halved_sums, splat
from dslab.slam.ldso._tracking_kernels import mean_squared_flow
from dslab.slam.ldso.tracking import Expected, PhotometricTracker, TrackingReference


def reference():
    image, depth = view(np.eye(4))
    pyramid = RECTIFIER.pyramid(image)
    xy = select(pyramid).xy
    return TrackingReference(
        pyramid, INTRINSICS, xy.astype(float), 1 / depth[xy[:, 1], xy[:, 0]], np.ones(len(xy))
    )


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.8, 12.0)])
@pytest.mark.parametrize(
    "twist", [np.zeros(6), [0.06, 0.03, -0.05, 0.01, -0.02, 0.02], [0, 0, 0, 0.02, 0.03, -0.04]]
)
def test_a_known_motion_is_found(twist, gain, offset):
    ref, T = reference(), motion(twist)
    tracker = PhotometricTracker(CONFIG.photometric, CONFIG.tracking)
    found = tracker.track(ref, RECTIFIER.pyramid(view(T, gain, offset)[0]), [np.eye(4)], np.zeros(2), 3.0)
    assert found is not None and found.error < 3 and found.visible > 0.5
    off = found.T_frame_ref @ np.linalg.inv(T)
    assert np.linalg.norm(off[:3, 3]) < 1e-3  # 0.1 px at this depth
    assert np.abs(off[:3, :3] - np.eye(3)).max() < 5e-4
    assert (
        np.abs(found.affine - [np.log(gain), offset]) < [0.05, 6.0]
    ).all()  # interpolation takes some contrast


def test_residuals_are_those_that_the_tracker_settled_with():
    ref, T = reference(), motion([0.06, 0.03, -0.05, 0.01, -0.02, 0.02])
    pyramid = RECTIFIER.pyramid(view(T, 0.8, 12.0)[0])
    tracker = PhotometricTracker(CONFIG.photometric, CONFIG.tracking)
    found = tracker.track(ref, pyramid, [np.eye(4)], np.zeros(2), 3.0)
    uv, residual = ref.residuals(pyramid, found.T_frame_ref, found.affine)
    size, huber = np.abs(residual), CONFIG.photometric.huber
    size = np.minimum(size, max(huber, 3 * 1.4826 * np.median(size)))
    cost = np.where(size <= huber, size**2, huber * (2 * size - huber)).mean()
    assert np.sqrt(cost) == pytest.approx(found.error, rel=0.02)
    assert len(uv) == pytest.approx(found.visible * len(ref.levels[0].uv), rel=0.02)
    _, in_other_light = ref.residuals(pyramid, found.T_frame_ref, np.zeros(2))
    assert np.abs(in_other_light).mean() > 3 * np.abs(residual).mean()


def test_views_that_show_nothing_in_common_are_not_aligned():
    away = np.eye(4)
    away[:3, 3] = 50.0, 0.0, 0.0
    tracker = PhotometricTracker(CONFIG.photometric, CONFIG.tracking)
    blank = RECTIFIER.pyramid(np.full((CAMERA.height_px, CAMERA.width_px), 90, np.uint8))
    assert tracker.track(reference(), blank, [away], np.zeros(2), 3.0) is None


def test_points_are_spread_as_their_twin_does():
    rng = np.random.default_rng(3)
    uv = rng.uniform(-3, 43, (120, 2))
    d, weight = rng.uniform(0.2, 1.0, 120), rng.uniform(0.5, 2.0, 120)
    total, mass = np.zeros((40, 40)), np.zeros((40, 40))
    splat(uv, d, weight, total, mass)
    expected = np.zeros((2, 40, 40))
    for (x, y), di, wi in zip(np.floor(uv + 0.5).astype(int), d, weight, strict=True):
        if 0 <= x < 40 and 0 <= y < 40:
            expected[:, y, x] += wi * di, wi
    np.testing.assert_allclose([total, mass], expected)
    half = halved_sums(mass)
    np.testing.assert_allclose(half, mass.reshape(20, 2, 20, 2).sum(axis=(1, 3)))

    level = rng.uniform(0, 255, (40, 40, 3)).astype(np.float32)
    level[10, 10, 0] = np.nan
    out = np.empty((1600, 2)), np.empty(1600), np.empty(1600)
    n = gather(total, mass, level, 3, *out)
    rows = []
    for y, x in np.ndindex(40, 40):
        if not (3 <= x < 37 and 3 <= y < 37):
            continue
        t, m = total[y, x], mass[y, x]
        if m == 0:
            beside = [(y, x + 1), (y, x - 1), (y + 1, x), (y - 1, x)]
            t, m = sum(total[at] for at in beside), sum(mass[at] for at in beside)
        if m > 0 and np.isfinite(level[y, x, 0]):
            rows.append([x, y, t / m, level[y, x, 0]])
    np.testing.assert_allclose(np.column_stack([out[0], out[1], out[2]])[:n], rows)


def test_where_images_tell_nothing_a_frame_stays_where_it_is_expected():
    """A wall of upright stripes does not tell how far the camera has gone up."""
    _, x = np.mgrid[:240, :320]
    stripes = np.clip(120 + 60 * np.sin(x / 5.0) + 30 * np.sin(x / 13.0), 0, 255).astype(np.uint8)
    pyramid = RECTIFIER.pyramid(stripes)
    found = select(pyramid)
    uv = found.xy.astype(float)
    ref = TrackingReference(pyramid, INTRINSICS, uv, np.full(len(uv), 0.5), np.ones(len(uv)))
    up = motion([0, 0.05, 0, 0, 0, 0])
    tracker = PhotometricTracker(CONFIG.photometric, CONFIG.tracking)
    for T in (up, np.eye(4)):
        expected = Expected(T, 1e6 * np.eye(6), 1.0)
        tracked = tracker.track(
            ref, pyramid, [motion([0, 0.02, 0, 0, 0, 0])], np.zeros(2), 3.0, 0.0, expected
        )
        np.testing.assert_allclose(tracked.T_frame_ref, T, atol=2e-3)
        across, along = tracked.information[0, 0], tracked.information[1, 1]
        assert along < 1e-3 * across
    seen = RECTIFIER.pyramid(np.roll(stripes, -6, axis=1))  # these tell of the way across, expected or not
    tracked = tracker.track(
        ref, seen, [np.eye(4)], np.zeros(2), 3.0, 0.0, Expected(np.eye(4), 1e2 * np.eye(6), 1.0)
    )
    shift = 250 * (0.5 * tracked.T_frame_ref[0, 3] + tracked.T_frame_ref[0, 2])
    assert shift == pytest.approx(-6, abs=0.3)


def test_flow_is_that_of_projected_points():
    ref, T = reference(), motion([0.1, 0.02, -0.05, 0.02, 0.01, 0.05])
    uv, d = ref.levels[0].uv, ref.levels[0].inverse_depth
    rays = np.column_stack([(uv - INTRINSICS[0][2:]) / INTRINSICS[0][:2], np.ones(len(uv))]) / d[:, None]
    for found, R in zip(mean_squared_flow(INTRINSICS[0], uv, d, T), (np.eye(3), T[:3, :3]), strict=True):
        moved = rays @ R.T + T[:3, 3]
        at = moved[:, :2] / moved[:, 2:] * INTRINSICS[0][:2] + INTRINSICS[0][2:]
        np.testing.assert_allclose(found, ((at - uv) ** 2).sum(axis=1).mean())
