"""Alignment of trajectories by a similarity that its quarters judge."""

import numpy as np
import pytest
from odometry_scripts import CAMERA, walk
from scipy.spatial.transform import Rotation

from dslab.slam.framework.alignment import SeamConfig, SeenPoints, align
from dslab.slam.optimization.sim3 import moved, sim3_decompose, sim3_matrix

S = sim3_matrix(2.5, Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix(), np.array([3.0, -1.0, 2.0]))
SEAM = SeamConfig()


def noisy(T: np.ndarray, sigma: float, seed: int = 0) -> np.ndarray:
    out = T.copy()
    out[:, :3, 3] += np.random.default_rng(seed).normal(0, sigma, (len(T), 3))
    return out


def test_a_similarity_is_found_again_though_a_quarter_of_the_poses_is_wrong():
    T = walk(40)
    other = moved(S, noisy(T, 0.005))
    other[::4, :3, 3] += [2.0, -3.0, 1.0]
    other[::4, :3, :3] = Rotation.from_rotvec([0.4, 0.2, 0.0]).as_matrix() @ other[::4, :3, :3]
    found = align(T, other, SeamConfig(position_share=10.0, scale_share=1.0))
    s, R, t = sim3_decompose(found.S_b_a)
    assert found.refused == "" and found.poses == 40
    assert s == pytest.approx(2.5, rel=0.01)
    assert np.rad2deg(Rotation.from_matrix(R @ sim3_decompose(S)[1].T).magnitude()) < 0.2
    np.testing.assert_allclose(t, S[:3, 3], atol=0.15)


def test_a_straight_path_leaves_the_rotation_to_the_orientations():
    T = np.tile(np.eye(4), (30, 1, 1))
    T[:, 2, 3] = np.linspace(0, 3, 30)
    found = align(T, moved(S, T), SEAM)
    assert found.refused == ""
    np.testing.assert_allclose(found.S_b_a, S, atol=1e-6)


def test_noise_of_either_side_leaves_the_scale_alone():
    """Least squares of one side on the other would shrink it by the noise of the first."""
    scales = []
    for seed in range(30):
        a, b = noisy(walk(30), 0.15, seed), noisy(moved(S, walk(30)), 2.5 * 0.15, 100 + seed)
        scales.append(sim3_decompose(align(a, b, SEAM).S_b_a)[0])
    assert np.median(scales) == pytest.approx(2.5, rel=0.02)


def test_what_cannot_be_aligned_is_refused_with_a_reason():
    T = walk(40)
    turning = T.copy()
    turning[:, :3, 3] = np.random.default_rng(1).normal(0, 0.01, (40, 3))
    other_turn = noisy(turning, 0.01, 2)
    growing = T.copy()
    growing[:, :3, 3] = np.cumsum(
        np.diff(T[:, :3, 3], axis=0, prepend=0) * np.linspace(1, 1.25, 40)[:, None], axis=0
    )
    curling = T.copy()
    bend = Rotation.from_rotvec(np.outer(np.linspace(0, 0.25, 40), [0, 1, 0])).as_matrix()
    curling[:, :3, :3] = bend @ T[:, :3, :3]
    breathing = T.copy()  # its halves agree
    breathing[:, :3, 3] = np.cumsum(
        np.diff(T[:, :3, 3], axis=0, prepend=0) * (1 + 0.12 * (np.abs(np.arange(40) - 19.5) < 10))[:, None],
        axis=0,
    )
    assert align(T[:19], T[:19], SEAM).refused == "too_short"
    assert align(T, breathing, SeamConfig(scale_share=0.08)).refused == "scale"
    assert align(turning, other_turn, SEAM).refused == "residual"
    assert align(T, growing, SEAM).refused == "scale"
    assert align(T, curling, SEAM).refused == "rotation"
    assert align(T, noisy(T, 0.2), SEAM).refused == "residual"


def walls(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points all around the walk, and three times as many at all depths behind them."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(40_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    far = 40.0 * np.exp(rng.uniform(0, 0.4, (30_000, 1)))
    return 40.0 * directions[:10_000], far * directions[10_000:]


def scale_with(T: np.ndarray, other: np.ndarray, a: np.ndarray, b: np.ndarray | None) -> float:
    """Scale by trajectories, and by points if there are some."""
    points = None if b is None else SeenPoints(CAMERA, a, b)
    found = align(T, other, SeamConfig(), points)
    assert found.refused == ""
    return sim3_decompose(found.S_b_a)[0]


def test_depths_tell_the_scale_where_the_motion_is_told_wrong():
    T, (near, far) = walk(40), walls()
    other = T.copy()
    other[:, :3, 3] *= 1.08
    other = moved(S, other)
    seen_again = near + np.random.default_rng(1).normal(0, 1.0, near.shape)  # other points of the same wall
    s, R, t = sim3_decompose(S)
    placed = s * seen_again @ R.T + t
    everything = np.concatenate([near, far])
    assert scale_with(T, other, near, None) == pytest.approx(2.5 * 1.08, rel=0.005)
    assert scale_with(T, other, near, placed) == pytest.approx(2.5, rel=0.02)
    assert scale_with(T, other, everything, placed) == pytest.approx(2.5, rel=0.03), "a wall hides the rest"
    for few in (placed[:0], placed[:50]):
        assert scale_with(T, other, near, few) == pytest.approx(2.5 * 1.08, rel=0.005)


def test_depths_that_differ_from_quarter_to_quarter_are_refused():
    T, (near, _) = walk(40), walls()
    growing = near * np.exp(0.006 * near[:, :1])  # to the side that the walk turns to
    assert align(T, T, SEAM, SeenPoints(CAMERA, near, near)).refused == ""
    assert align(T, T, SEAM, SeenPoints(CAMERA, near, growing)).refused in ("scale", "residual")
