"""Alignment recovers known transforms and reports undefined ones."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.experiments.evaluation.alignment import (
    Similarity,
    Undefined,
    align_poses,
    rotation_angle_deg,
    umeyama,
)


def random_similarity(rng) -> Similarity:
    return Similarity(
        float(rng.uniform(0.05, 20)), Rotation.random(rng=rng).as_matrix(), rng.uniform(-50, 50, 3)
    )


def random_poses(rng, n: int) -> np.ndarray:
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.random(n, rng=rng).as_matrix()
    T[:, :3, 3] = rng.normal(0, 3, (n, 3))
    return T


@pytest.mark.parametrize("align", [lambda a, b: umeyama(a[:, :3, 3], b[:, :3, 3]), align_poses])
@pytest.mark.parametrize("seed", range(5))
def test_a_known_similarity_is_recovered_exactly(align, seed):
    rng = np.random.default_rng(seed)
    S = random_similarity(rng)
    T_map_cam = random_poses(rng, 20)
    found = align(T_map_cam, S.poses(T_map_cam))
    assert found.scale == pytest.approx(S.scale, rel=1e-9)
    np.testing.assert_allclose(found.R_world_map, S.R_world_map, atol=1e-9)
    np.testing.assert_allclose(found.t_world_map, S.t_world_map, atol=1e-7)


def test_a_mirrored_path_is_not_matched_by_a_reflection():
    p = np.random.default_rng(0).normal(size=(30, 3))
    found = umeyama(p, p * [1, 1, -1])
    assert np.linalg.det(found.R_world_map) == pytest.approx(1)


def test_no_other_similarity_fits_noisy_points_better():
    rng = np.random.default_rng(3)
    p_map = rng.normal(size=(40, 3))
    p_world = random_similarity(rng).points(p_map) + rng.normal(0, 0.1, (40, 3))
    best = umeyama(p_map, p_world)

    def cost(S):
        return ((S.points(p_map) - p_world) ** 2).sum()

    for _ in range(50):
        turned = best.R_world_map @ Rotation.from_rotvec(rng.normal(0, 0.01, 3)).as_matrix()
        other = Similarity(best.scale * rng.uniform(0.99, 1.01), turned, best.t_world_map)
        assert cost(other) >= cost(best)


@pytest.mark.parametrize(
    ("positions", "why"),
    [
        (np.random.default_rng(0).normal(size=(2, 3)), "2 poses"),
        (np.full((20, 3), 1e6 / 3), "does not move"),
    ],
)
def test_too_few_positions_and_a_path_that_stands_still_are_undefined(positions, why):
    moves = np.random.default_rng(1).normal(size=positions.shape)
    for pair in ((positions, moves), (moves, positions)):
        found = umeyama(*pair)
        assert isinstance(found, Undefined) and why in found.reason


def test_a_straight_true_path_leaves_only_the_roll_about_it_open():
    rng = np.random.default_rng(2)
    along = np.array([1.0, 2, 3]) / np.sqrt(14)
    p_world = np.outer(np.linspace(0, 10, 30), along) + 5
    p_map = random_similarity(rng).points(p_world + rng.normal(0, 0.1, (30, 3)))
    found = umeyama(p_map, p_world)

    def errors(S):
        return np.linalg.norm(S.points(p_map) - p_world, axis=1)

    middle = p_world.mean(axis=0)
    for angle in (1.0, 2.5):
        R = Rotation.from_rotvec(angle * along).as_matrix()
        rolled = Similarity(found.scale, R @ found.R_world_map, R @ (found.t_world_map - middle) + middle)
        np.testing.assert_allclose(errors(rolled), errors(found), atol=1e-12)
    # No rotation, nor scale, near it fits better.
    for _ in range(50):
        R = Rotation.from_rotvec(rng.normal(0, 0.01, 3)).as_matrix() @ found.R_world_map
        scale = found.scale * rng.uniform(0.99, 1.01)
        other = Similarity(scale, R, middle - scale * R @ p_map.mean(axis=0))
        assert (errors(other) ** 2).sum() >= (errors(found) ** 2).sum()


def test_orientations_determine_the_rotation_about_a_straight_path():
    rng = np.random.default_rng(4)
    S = random_similarity(rng)
    T = random_poses(rng, 20)
    T[:, :3, 3] = np.outer(np.linspace(0, 2, 20), [1.0, 0, 0])
    found = align_poses(T, S.poses(T))
    np.testing.assert_allclose(found.R_world_map, S.R_world_map, atol=1e-9)
    assert found.scale == pytest.approx(S.scale)


def test_a_path_that_stands_still_has_no_scale():
    T = random_poses(np.random.default_rng(0), 20)
    still = T.copy()
    still[:, :3, 3] = [1.0, 2, 3]
    assert isinstance(align_poses(still, T), Undefined)


def test_angles_are_correct_from_tiny_to_half_a_turn():
    angles = np.array([0.0, 1e-7, 0.1, 90, 179.99999, 180])
    axis = np.array([1, 2, -2]) / 3
    R = Rotation.from_rotvec(np.radians(angles)[:, None] * axis).as_matrix()
    np.testing.assert_allclose(rotation_angle_deg(R), angles, rtol=1e-6, atol=1e-9)
