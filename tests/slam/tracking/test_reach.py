"""How far a lost camera can have come."""

import numpy as np
import pytest

from dslab.slam.core.results import MapTrajectory
from dslab.slam.tracking.reach import Reach, ReachConfig


@pytest.fixture
def reach():
    """The camera went 1 m/s along x and was lost at x = 3, at 3 s."""
    T = np.tile(np.eye(4), (31, 1, 1))
    stamps_s = np.arange(31) / 10
    T[:, 0, 3] = stamps_s
    return Reach.of(MapTrajectory(0, np.arange(31), stamps_s, T), ReachConfig())


def test_reach_grows_with_the_usual_speed(reach):
    assert reach.speed == pytest.approx(1.0)
    far = 3 + 1.25 * 2.5  # two seconds on, and half a second that may have been wrong before
    assert reach.allows(np.array([far - 0.01, 0, 0]), 5.0)
    assert not reach.allows(np.array([3, far - 2.9, 0]), 5.0)


def test_a_place_that_was_out_of_reach_does_not_come_into_it(reach):
    """Unless nothing like it was seen for a while: then the camera may have gone there."""
    stamps_s = np.arange(4.0, 14.0, 0.1)
    along = np.stack([np.full(100, 3.0), 8 - 0.2 * (stamps_s - 4), np.zeros(100)], 1)
    assert not any(reach.allows(c, t) for c, t in zip(along, stamps_s, strict=True))
    assert reach.allows(np.array([5.0, 0, 0]), 14.0), "elsewhere it may be"
    assert not reach.allows(along[-1], 15.5)
    assert reach.allows(along[-1], 18.0)
