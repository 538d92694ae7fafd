"""Recovery by SIFT features: scenes in which ORB with a motion model fails, and its components."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from dual_scenes import STEP_M
from recovery_scenes import FADED, faded_scene, same_map
from slam_scenes import CAMERA, VIEW, make_frame, rigid, toy

from dslab.slam.dual.recovery.interface import RecoveryConfig
from dslab.slam.dual.recovery.registry import ThreadSpec, build_thread
from dslab.slam.dual.recovery.sift import SiftRecoveryConfig, detector
from dslab.slam.features import sift, tracks
from dslab.slam.features.sift import SiftFrame
from dslab.slam.features.sift_detector import SiftDetector
from dslab.slam.map.invariants import check_map

# -- a scene in which the motion model fails -----------------------------------------------------------------


@pytest.fixture(scope="module")
def faded_run():
    """The result of the SIFT thread, and the frames whose images it used."""
    scene, used = faded_scene(), []
    task = scene.again()
    task = replace(task, image_of=lambda index: used.append(index) or scene.images[index])
    return build_thread(ThreadSpec("sift")).run(task), used


@pytest.fixture(scope="module")
def faded(faded_run):
    return faded_run[0]


@pytest.mark.slow
def test_the_orb_thread_fails_to_cross_faded_frames():
    """No limit of unusable frames helps."""
    result = faded_scene().run("orb", RecoveryConfig(max_unusable_s=float("inf")))
    assert not result.success
    assert result.frames_passed_over >= len(FADED)


def test_the_sift_thread_crosses_faded_frames(faded):
    assert faded.success and (faded.stage, faded.reason) == ("", "")
    assert abs(faded_scene().scale_error(faded)) < 0.05
    check_map(faded.map)


def test_it_tracks_the_camera_without_orb_features(faded):
    """Over a path of 4.5 m, whose ends share no view."""
    errors = faded_scene().errors_m(faded)
    assert set(FADED) <= set(errors)
    assert max(errors.values()) < 0.1
    seen = {f.features.index: (f.point >= 0).sum() for f in faded.frames}
    assert sum(seen[i] == 0 for i in FADED) > 25


def test_the_map_grows_again_beyond_the_faded_frames(faded):
    m = faded.map
    beyond = [k for k in m.keyframes() if m.frame_index(int(k)) < FADED.start]
    assert len(beyond) >= 2
    assert all((m.observed_points(int(k)) >= 0).sum() > 100 for k in beyond)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_recovery_bit_by_bit(faded):
    again = faded_scene().run("sift")
    assert same_map(again.map, faded.map)
    assert again.alignment.S_old_new.tobytes() == faded.alignment.S_old_new.tobytes()


def test_each_image_is_used_once(faded_run):
    result, used = faded_run
    task = faded_scene().task
    first = task.first.features.index
    assert used == list(range(first, first - result.frames_covered - 1, -1))


# -- features ------------------------------------------------------------------------------------------------


def view_of(xy, descriptors, T=None):
    frame = make_frame(0, np.random.default_rng(0), n=5, T=T)
    return SiftFrame(frame, xy, np.ones(len(xy)), descriptors)


def random_views(rng, n=60):
    """Two frames with the same features, shuffled and slightly changed, and further ones."""
    base = rng.integers(0, 120, (n, 128)).astype(np.uint8)
    order = rng.permutation(n)
    changed = np.clip(base[order].astype(int) + rng.integers(-6, 7, (n, 128)), 0, 255).astype(np.uint8)
    other = rng.integers(0, 120, (20, 128)).astype(np.uint8)
    a = view_of(rng.uniform(0, 400, (n, 2)), base)
    b = view_of(rng.uniform(0, 400, (n + 20, 2)), np.concatenate([changed, other]))
    return a, b, order


def test_matches_are_mutual_nearest_neighbours_that_pass_the_ratio_test():
    a, b, order = random_views(np.random.default_rng(1))
    pairs = sift.match(a, b, 0.8)
    assert len(pairs) == len(order)
    assert (order[pairs[:, 1]] == pairs[:, 0]).all()
    there = cv2.BFMatcher(cv2.NORM_L2).knnMatch(
        a.descriptors.astype(np.float32), b.descriptors.astype(np.float32), k=2
    )
    clear = {(m.queryIdx, m.trainIdx) for m, n in there if m.distance < 0.8 * n.distance}
    back = {
        (m.trainIdx, m.queryIdx)
        for m in cv2.BFMatcher(cv2.NORM_L2).match(
            b.descriptors.astype(np.float32), a.descriptors.astype(np.float32)
        )
    }
    assert {tuple(p) for p in pairs.tolist()} == clear & back


def test_ambiguous_features_are_not_matched():
    a, b, _ = random_views(np.random.default_rng(2))
    twice = view_of(np.concatenate([b.xy, b.xy[:1]]), np.concatenate([b.descriptors, b.descriptors[:1]]))
    pairs = sift.match(a, twice, 0.8)
    assert not np.isin(pairs[:, 1], (0, len(b.xy))).any()
    assert len(pairs) == 59


@pytest.mark.parametrize(
    ("width_px", "height_px", "finest_px"), [(640, 480, 1.6), (1240, 376, 1.6), (1600, 1200, 3.1)]
)
def test_fine_things_count_but_in_a_very_large_image(width_px, height_px, finest_px):
    """As on a drive, where all that is in view still behind a gap is far."""
    noise = np.random.default_rng(0).integers(0, 256, (height_px, width_px), np.uint8)
    found = detector(SiftRecoveryConfig()).detect(noise)
    assert finest_px <= np.percentile(found.sigma_px, 1) < 1.5 * finest_px


def test_a_blank_image_has_no_features():
    frame = make_frame(0, np.random.default_rng(0), n=5)
    detector = SiftDetector(100, 0.04, 4, 640 * 480)
    nothing = sift.sift_frame(detector.detect(np.full((480, 640), 90, np.uint8)), frame, CAMERA)
    assert nothing.xy.shape == (0, 2) and nothing.descriptors.shape == (0, 128)
    assert nothing.depth == 0.0
    a, _, _ = random_views(np.random.default_rng(3))
    assert len(sift.match(a, nothing, 0.8)) == len(sift.match(nothing, a, 0.8)) == 0


def test_features_are_undistorted_and_limited_in_number():
    bent = replace(CAMERA, distortion=(-0.2, 0.05, 0.0, 0.0, 0.0))
    image = cv2.resize(toy(20, 0, STEP_M)[0][0], (640, 480))
    frame = make_frame(0, np.random.default_rng(0), n=5)
    detector = SiftDetector(200, 0.005, 4, 640 * 480)
    found = detector.detect(image)
    plain, undone = (sift.sift_frame(found, frame, camera) for camera in (CAMERA, bent))
    assert 200 <= len(plain.xy) <= 260 and (plain.inv_sigma2 <= 1).all()
    np.testing.assert_allclose(undone.xy, bent.undistort_points(plain.xy.astype(np.float32)), atol=1e-3)


def test_a_feature_takes_the_depth_of_a_nearby_map_point():
    xy = np.array([[100.0, 100.0], [300.0, 200.0], [500.0, 400.0]])
    seen = view_of(xy, np.zeros((3, 128), np.uint8))
    T = rigid((0.3, -0.2, 0.5), (3, 8, -5))
    beside = np.array([[104.0, 101.0], [330.0, 200.0], [500.0, 397.0]])
    xyz_cam = tracks.rays(beside, VIEW) * np.array([[4.0], [5.0], [6.0]])
    xyz = (xyz_cam - T[:3, 3]) @ T[:3, :3]
    tracks.take_depth_from_points(seen, xyz, beside, T, VIEW, 6.0)
    assert seen.known.tolist() == [True, False, True]
    np.testing.assert_allclose(seen.xyz_cam[[0, 2]], tracks.rays(xy[[0, 2]], VIEW) * [[4.0], [6.0]])
    assert seen.depth == pytest.approx(5.0)
    np.testing.assert_allclose(seen.positions(np.array([0]), T)[0] @ T[:3, :3].T + T[:3, 3], seen.xyz_cam[0])


def test_triangulation_of_pairs_rejects_what_is_inconsistent():
    rng = np.random.default_rng(5)
    xyz = np.column_stack([rng.uniform(-2, 2, (6, 2)), rng.uniform(4, 7, 6)])
    T_2 = rigid((-0.5, 0.1, 0.05), (1, -3, 2))
    T_1 = np.stack([rigid((0.1 * i, 0.0, 0.0), (0, i, 0)) for i in range(6)])
    T_1[3] = T_2  # no parallax
    rays_1 = np.stack([T[:3, :3] @ x + T[:3, 3] for T, x in zip(T_1, xyz, strict=True)])
    rays_2 = xyz @ T_2[:3, :3].T + T_2[:3, 3]
    rays_1, rays_2 = rays_1 / rays_1[:, 2:], rays_2 / rays_2[:, 2:]
    rays_1[4, 1] += 0.05  # off the epipolar line
    found, disagrees = tracks.triangulate_pairs(
        T_1, rays_1, T_2, rays_2, np.full(6, 1e-5), float(np.cos(np.deg2rad(1.0)))
    )
    assert disagrees.tolist() == [False] * 4 + [True, False]
    assert np.isfinite(found[:, 0]).tolist() == [True, True, True, False, False, True]
    np.testing.assert_allclose(found[[0, 1, 2, 5]], xyz[[0, 1, 2, 5]], atol=1e-6)
