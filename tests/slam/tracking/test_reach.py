"""How far a lost camera can have come."""

import numpy as np
import pytest

from dslab.slam.core.results import MapTrajectory
from dslab.slam.tracking.reach import Reach


@pytest.fixture
def reach():
    """The camera went 1 m/s along x and was lost at x = 3, at 3 s."""
    T = np.tile(np.eye(4), (31, 1, 1))
    stamps_s = np.arange(31) / 10
    T[:, 0, 3] = stamps_s
    return Reach.of(MapTrajectory(0, np.arange(31), stamps_s, T))


def test_a_camera_has_usually_come_as_far_as_its_speed_says(reach):
    assert reach.speed == pytest.approx(1.0)
    assert reach.unseen(np.array([5.0, 0, 0]), 6.0, 2.0) == pytest.approx((3.0, 1.5, 1.0))
    assert np.isnan(reach.unseen(np.zeros(3), 6.0, 0.0).radius), "without a depth"
