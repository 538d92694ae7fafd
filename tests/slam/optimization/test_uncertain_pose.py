"""Pose, noise and right matches together: known truth, calibrated covariances, what must not be bought."""

import numpy as np
import pytest
from scipy.stats import chi2
from slam_scenes import CAMERA, rigid

from dslab.slam.optimization.student import TAILS
from dslab.slam.optimization.uncertain_pose import MOST_NOISE2, uncertain_pose

K = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
CELL_PX = 80.0
NO_PRIOR = np.zeros((6, 6))


def student(rng, n):
    """(n, 2) errors of unit variance, with the tails of right matches."""
    scale = (TAILS - 2) / rng.chisquare(TAILS, n)
    return rng.normal(size=(n, 2)) * np.sqrt(scale)[:, None]


def seen(
    rng, n=200, noise_px=1.0, depth_deviation=0.0, wrong=0, window_px=30.0, T=None, within=(10, 10, 630, 470),
    depths=(3, 8),
):  # fmt: skip
    """Points in the view of the origin, as a map has them, and their keypoints at T; the first are wrong."""
    pixels = rng.uniform(within[:2], within[2:], (n, 2))
    z = rng.uniform(*depths, n)
    rays = np.column_stack([(pixels - K[2:]) / K[:2], np.ones(n)])
    xyz = rays * z[:, None]
    along = depth_deviation * z
    covariance = np.einsum("n,ni,nj->nij", along**2, rays, rays) + 1e-12 * np.eye(3)
    seen_at = xyz if T is None else xyz @ T[:3, :3].T + T[:3, 3]
    pixels = seen_at[:, :2] / seen_at[:, 2:] * K[:2] + K[2:]
    xyz = xyz + (along * rng.normal(size=n))[:, None] * rays
    octave = rng.integers(0, 4, n)
    information = 1.0 / 1.2 ** (2 * octave)
    pixels = pixels + noise_px * student(rng, n) / np.sqrt(information)[:, None]
    pixels[:wrong] += rng.uniform(-window_px / 2, window_px / 2, (wrong, 2))
    six = covariance[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return xyz, six, pixels, information


def estimate(of, start, noise2=1.0, window_px=30.0, spread_px2=25.0, prior=NO_PRIOR):
    area = np.full(len(of[0]), window_px**2)
    return uncertain_pose(start, *of, area, noise2, spread_px2, prior, K, CELL_PX)


def twist_to_truth(T):
    """Of a pose near the identity."""
    return np.r_[T[:3, 3], [T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]] * np.array(0.5)]


START = rigid((0.02, -0.01, 0.03), (0.3, -0.4, 0.2))


@pytest.mark.parametrize("noise_px", [0.4, 1.0, 2.0])
def test_a_frame_tells_its_noise_in_either_direction(noise_px):
    rng = np.random.default_rng(1)
    found = estimate(seen(rng, n=600, noise_px=noise_px, wrong=60), START)
    assert np.sqrt(found.noise2) == pytest.approx(noise_px, rel=0.15)
    assert np.linalg.norm(found.T_cam_map[:3, 3]) < 0.02 * noise_px


def test_wrong_matches_are_told_from_right_ones_from_a_pose_that_is_pixels_off():
    rng = np.random.default_rng(2)
    of = seen(rng, wrong=80)
    found = estimate(of, START, window_px=60.0)
    off = np.abs(of[2] - (of[0][:, :2] / of[0][:, 2:] * K[:2] + K[2:])).max(1) * np.sqrt(of[3])
    assert (found.right[80:] > 0.5).mean() > 0.97
    assert (found.right[:80][off[:80] > 5] < 0.5).all()


def test_errors_of_poses_have_the_size_that_their_covariance_says():
    rng = np.random.default_rng(3)
    squared = []
    for _ in range(150):
        found = estimate(seen(rng, n=60, depth_deviation=0.05), np.eye(4))
        error = twist_to_truth(found.T_cam_map)
        squared.append(error @ np.linalg.solve(found.covariance, error))
    assert 0.9 < np.mean(np.array(squared) < chi2.ppf(0.95, 6)) < 0.99
    assert np.mean(squared) == pytest.approx(6, rel=0.15)


def test_far_out_errors_weigh_less_so_that_a_pose_is_better_than_by_least_squares():
    def worst(noise_px, draws=40):
        rng = np.random.default_rng(9)
        poses = [estimate(seen(rng, noise_px=noise_px, n=100), np.eye(4)).T_cam_map for _ in range(draws)]
        return np.sqrt(np.mean([twist_to_truth(T) ** 2 for T in poses], axis=0))

    def least_squares(draws=40):
        rng, squares = np.random.default_rng(9), []
        for _ in range(draws):
            xyz, _, pixels, information = seen(rng, n=100)
            x, y, z = xyz.T
            o = np.zeros(len(z))
            u, v = x / z, y / z
            J = np.stack([K[0] * np.stack([1 / z, o, -u / z, -u * v, 1 + u * u, -v], 1),
                          K[1] * np.stack([o, 1 / z, -v / z, -1 - v * v, u * v, u], 1)], 1)  # fmt: skip
            e = pixels - np.column_stack([u, v]) * K[:2] - K[2:]
            H = np.einsum("nri,n,nrj->ij", J, information, J)
            squares.append(np.linalg.solve(H, np.einsum("nri,n,nr->i", J, information, e)) ** 2)
        return np.sqrt(np.mean(squares, axis=0))

    assert (worst(1.0) / least_squares()).mean() < 0.9


def test_an_uncertain_point_counts_by_its_covariance():
    rng, moved = np.random.default_rng(4), rigid((0.6, 0.0, 0.0))
    sure, vague = seen(rng, depth_deviation=0.01, T=moved), seen(rng, depth_deviation=0.2, T=moved)
    both = [np.concatenate(pair) for pair in zip(sure, vague, strict=True)]
    sure, vague, both = (np.linalg.det(estimate(of, moved).covariance) for of in (sure, vague, both))
    assert both < sure < 0.1 * vague


def test_a_wrong_pose_does_not_buy_itself_noise():
    rng = np.random.default_rng(5)
    xyz, covariance, pixels, information = seen(rng, n=40)
    scattered = rng.uniform((10, 10), (630, 470), pixels.shape)
    found = estimate((xyz, covariance, scattered, information), np.eye(4), window_px=100.0)
    assert found.noise2 <= MOST_NOISE2 and (found.right > 0.5).sum() < 12


def test_a_place_that_disagrees_draws_the_pose():
    rng = np.random.default_rng(6)
    rest, place = seen(rng, n=60), seen(rng, n=60, within=(20, 20, 80, 80))
    together = [np.concatenate(pair) for pair in zip(rest, place, strict=True)]
    calm = estimate(together, np.eye(4)).drawn
    together[2][60:] += (2.0, 0.0)
    assert calm < 4 < estimate(together, np.eye(4)).drawn


@pytest.mark.parametrize("n", [0, 2])
def test_too_few_points_leave_the_pose_open(n):
    of = seen(np.random.default_rng(7), n=n)
    found = estimate(of, START)
    assert (
        np.isinf(found.covariance).all() and np.array_equal(found.T_cam_map, START) and not found.right.any()
    )


def test_a_prior_holds_what_points_leave_open():
    of = seen(np.random.default_rng(8), n=2)
    found = estimate(of, START, prior=np.eye(6) * 1e4)
    assert np.isfinite(found.covariance).all()
    assert np.abs(twist_to_truth(found.T_cam_map @ np.linalg.inv(START))).max() < 0.05


def test_a_step_before_a_wall_does_not_come_out_short():
    """Inverse depths err as much as they spread: least squares finds two thirds of the step."""
    step = rigid((-0.4, 0.0, 0.0), (0.0, 1.0, 0.0))
    for off in (-0.1, 0.1):
        found = []
        for seed in range(8):
            rng, within = np.random.default_rng(seed), (220, 140, 420, 340)
            of = seen(rng, 600, 0.3, depth_deviation=0.06, T=step, within=within, depths=(4.5, 5.5))
            of = of[0], of[1] / 0.3**2, *of[2:]  # at unit noise
            found.append(estimate(of, step @ rigid((off, 0.0, 0.0))).T_cam_map[0, 3] / step[0, 3])
        assert np.mean(found) == pytest.approx(1.0, abs=0.04)


def test_what_tells_no_noise_is_as_noisy_as_it_says():
    rng = np.random.default_rng(5)
    sharp, smeared = seen(rng, 100, 0.5), seen(rng, 100, 3.0)
    both = tuple(np.concatenate(each) for each in zip(smeared, sharp, strict=True))
    area = np.full(200, 900.0)
    found = uncertain_pose(np.eye(4), *both, area, 1.0, 25.0, NO_PRIOR, K, CELL_PX, telling=100)
    assert np.sqrt(found.noise2) == pytest.approx(2.6, abs=0.6)
    alone = estimate(smeared, np.eye(4))
    assert np.trace(found.covariance) < 0.2 * np.trace(alone.covariance)
