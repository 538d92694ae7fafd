"""Bundle adjustment where errors are of Student's t."""

from dataclasses import replace

import numpy as np
import pytest
from bundle_scenes import moved, n_parameters, scene

from dslab.slam.optimization.bundle_adjustment import likeliest_bundle, local_bundle_adjust
from dslab.slam.optimization.student import TAILS


def test_the_likeliest_bundle_is_where_the_likelihood_of_student_errors_is_greatest():
    _, start = scene(4, cameras=4, n_points=12, spread=0.01)
    start.pixels[::9] += 6.0

    def deviance(T, points):
        chi2 = (start.whitened(T, points) ** 2).sum(axis=1)
        return -2 * np.log((1 + chi2 / (TAILS - 2)) ** (-TAILS / 2 - 1)).sum()

    result, _ = likeliest_bundle(*start.arguments(), iterations=200)
    least = deviance(result.T_cam_map, result.points)
    assert result.cost_final == pytest.approx(least) and least < 0.9 * deviance(start.T, start.points)
    found = replace(start, T=result.T_cam_map, points=result.points)
    step = 1e-4 * np.eye(n_parameters(start))
    slope = [deviance(*moved(found, s)) - deviance(*moved(found, -s)) for s in step]
    bend = [deviance(*moved(found, s)) + deviance(*moved(found, -s)) - 2 * least for s in step]
    assert min(bend) > 0 and (np.square(slope) / (8 * np.array(bend))).max() < 0.01  # what is left to gain


def test_errors_of_student_s_t_are_adjusted_better_without_a_cut():
    errors, kept = [], []
    for seed in range(12):
        truth, start = scene(seed, noise=0.0, n_points=80)
        rng = np.random.default_rng(seed)
        scale = np.sqrt((TAILS - 2) / rng.chisquare(TAILS, len(start.camera)) / start.inv_sigma2)
        start.pixels = truth.pixels + rng.normal(size=truth.pixels.shape) * scale[:, None]
        both = likeliest_bundle(*start.arguments()), local_bundle_adjust(*start.arguments())
        errors.append([np.abs(r.T_cam_map[2:, :3, 3] - truth.T[2:, :3, 3]).mean() for r, _ in both])
        kept.append(both[0][1].mean())
    assert np.mean(errors, axis=0)[0] < 0.95 * np.mean(errors, axis=0)[1]
    assert np.mean(kept) > 0.98


def test_it_ends_where_the_poses_stand_though_wrong_observations_are_still_leaving():
    """These go on gaining for many more steps, with no say in the poses."""
    left = 0.0
    for seed in range(4):
        _, start = scene(seed, cameras=6, n_points=120)
        rng = np.random.default_rng(seed)
        wrong = rng.random(len(start.camera)) < 0.15
        start.pixels[wrong] += rng.normal(0, 8, (wrong.sum(), 2))
        result, _ = likeliest_bundle(*start.arguments())
        soon, _ = likeliest_bundle(*start.arguments(), iterations=20)
        assert np.array_equal(soon.T_cam_map, result.T_cam_map)
        later = result
        for _ in range(10):
            later, _ = likeliest_bundle(*replace(start, T=later.T_cam_map, points=later.points).arguments())
        left += result.cost_final - later.cost_final
        assert (
            np.abs(later.T_cam_map - result.T_cam_map).max() < 0.01 * np.abs(result.T_cam_map - start.T).max()
        )
    assert left > 0.3
