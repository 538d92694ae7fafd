"""How well a pose is known along the axis in which it is known least."""

import numpy as np
import pytest

from dslab.slam.core.results import RelativePose

RNG = np.random.default_rng(1)
FACTORS = {
    "any": RNG.normal(size=(3, 3)),
    "flat": RNG.normal(size=(3, 1)) @ RNG.normal(size=(1, 3)),
    "round": 0.3 * np.eye(3),
    "two alike": np.diag([2.0, 2.0, 0.1]),
    "tiny": 1e-9 * RNG.normal(size=(3, 3)),
    "nothing": np.zeros((3, 3)),
}


@pytest.mark.parametrize("name", FACTORS)
def test_standard_deviations_are_the_roots_of_the_largest_eigenvalues(name):
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = FACTORS[name] @ FACTORS[name].T
    covariance[3:, 3:] = 4 * covariance[:3, :3]
    pose = RelativePose(0, np.eye(4), covariance)
    expected = np.sqrt(max(np.linalg.eigvalsh(covariance[:3, :3])[-1], 0.0))
    assert pose.position_sd == pytest.approx(expected, rel=1e-7)
    assert pose.direction_sd_rad == pytest.approx(2 * expected, rel=1e-7)


def test_what_is_not_determined_is_not_known_at_all():
    pose = RelativePose(0, np.eye(4), np.full((6, 6), np.inf))
    assert pose.position_sd == pose.direction_sd_rad == np.inf
