"""Triangulation from two views: the least-squares point, or none."""

import numpy as np
import pytest
from numba import njit
from scipy.optimize import least_squares
from two_view_scenes import rigid

from dslab.slam.optimization._triangulation import triangulate


def normalised(T, point):
    q = T[:3, :3] @ point + T[:3, 3]
    return q[0] / q[2], q[1] / q[2]


@pytest.mark.parametrize("baseline", [0.003, 0.03, 0.3, 1.0])
def test_triangulation_is_the_least_squares_point(baseline):
    rng = np.random.default_rng(int(1000 * baseline))
    compared = 0
    for _ in range(40):
        T_1 = rigid(rng.normal(size=3), rng.normal(0, 0.3, 3))
        T_2 = rigid(baseline * rng.normal(size=3), rng.normal(0, 0.1, 3)) @ T_1
        truth = T_1[:3, :3].T @ ([*rng.uniform(-2, 2, 2), rng.uniform(3, 8)] - T_1[:3, 3])
        noise = min(1 / 500, baseline / 50) * rng.normal(size=4)
        seen = np.array([*normalised(T_1, truth), *normalised(T_2, truth)]) + noise

        def residuals(x, T_1=T_1, T_2=T_2, seen=seen):
            return np.array([*normalised(T_1, x), *normalised(T_2, x)]) - seen

        point = np.array(triangulate(T_1, T_2, *seen))
        if not np.isfinite(point).all():
            continue
        oracle = least_squares(residuals, truth, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
        assert (residuals(point) ** 2).sum() <= 2 * oracle.cost * (1 + 1e-6) + 1e-20
        compared += 1
    assert compared >= 35


def test_triangulation_of_perfect_observations_is_exact_at_small_parallax():
    T_1, point = rigid([0.3, 0.1, -0.2], [0.1, 0.2, -0.1]), np.array([1.0, -0.5, 6.0])
    for baseline in (1.0, 1e-2, 1e-4):
        T_2 = rigid([baseline, 0, 0], [0.0, 0.05, 0.0]) @ T_1
        found = triangulate(T_1, T_2, *normalised(T_1, point), *normalised(T_2, point))
        np.testing.assert_allclose(found, point, rtol=1e-11 / baseline)


def test_triangulation_refuses_points_not_in_front_of_both():
    T_1, T_2 = np.eye(4), rigid([-0.5, 0, 0], [0.0, 0, 0])
    assert np.isfinite(triangulate(T_1, T_2, 0.0, 0.0, -0.1, 0.0)).all()
    assert np.isnan(triangulate(T_1, T_2, 0.0, 0.0, 0.1, 0.0)).all()  # rays that part
    assert np.isnan(triangulate(T_1, T_2, 0.0, 0.0, 0.0, 0.0)).all()  # parallel rays
    assert np.isnan(triangulate(T_1, T_1, 0.0, 0.0, 0.1, 0.0)).all()  # no baseline
    away = rigid([0.0, 0, 0], [0.0, np.pi, 0]) @ T_2
    assert np.isnan(triangulate(T_1, away, 0.0, 0.0, 0.1, 0.0)).all()


def test_triangulation_is_callable_from_kernels():
    @njit
    def caller(T_1, T_2):
        x, y, z = triangulate(T_1, T_2, 0.0, 0.0, -0.1, 0.0)
        return x + y + z

    assert caller(np.eye(4), rigid([-0.5, 0, 0], [0.0, 0, 0])) == pytest.approx(5.0)
