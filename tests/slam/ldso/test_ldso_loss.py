"""Loss and the motion that is expected: what neither image nor motion tells is not known."""

import numpy as np
import pytest
from ldso_scenes import motion

from dslab.slam.ldso.config import LossConfig
from dslab.slam.ldso.loss import reason_of_loss
from dslab.slam.ldso.motion import MotionFilter, log_twist
from dslab.slam.ldso.tracking import Tracked

DEPTH = 2.0
SURE = 1e8 * np.eye(6)
SEEN = Tracked(np.eye(4), np.zeros(2), 3.0, 0.9, 0.0, 0.98, (1.0, 1.0), SURE)
STEP = np.array([0.04, 0.0, 0.01, 0.0, 0.02, 0.0])


def steady(frames=40, jitter=1e-3, information=SURE):
    """A filter that has seen a camera go steadily, and the last pose."""
    rng, expects, T = np.random.default_rng(1), MotionFilter(), np.eye(4)
    units = np.repeat([DEPTH, 1.0], 3)
    for _ in range(frames):
        there = motion((STEP + rng.normal(0, jitter, 6)) * units) @ T
        expects.take(T, there, information, DEPTH)
        T = there
    return expects, T


def test_a_twist_is_what_the_motion_was_made_of():
    twist = np.array([0.3, -0.1, 0.2, 0.4, -0.2, 0.1])
    np.testing.assert_allclose(log_twist(motion(twist)), twist, atol=1e-12)


def test_a_steady_camera_is_expected_where_it_goes_and_its_covariance_says_how_well():
    expects, T = steady()
    ahead, covariance = expects.ahead(T, DEPTH)
    off = log_twist(ahead @ np.linalg.inv(motion(STEP * np.repeat([DEPTH, 1.0], 3)) @ T))
    assert np.abs(off).max() < 0.004
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), 1.6e-3, rtol=0.5)


def test_the_filter_is_that_of_the_textbook():
    """One step against the form of Joseph with gain and measurement."""
    expects, T = steady(5)
    A = np.diag([1e5, 2e5, 3e4, 1e6, 1e3, 1e5])
    P = expects._predicted()
    H = np.hstack([np.eye(6), np.zeros((6, 6))])
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.linalg.inv(A))
    rest = np.eye(12) - K @ H
    expected = rest @ P @ rest.T + K @ np.linalg.inv(A) @ K.T
    velocity = expects.velocity.copy()
    # An alignment with the prior ends at the posterior mean.
    seen = np.array([0.01, 0.0, 0.005, 0.02, -0.01, 0.0])
    mean = (K @ seen)[:6]
    there = motion(mean * np.repeat([DEPTH, 1.0], 3)) @ expects.ahead(T, DEPTH)[0]
    expects.take(T, there, A, DEPTH)
    np.testing.assert_allclose(expects.covariance, expected, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(expects.velocity - velocity, (K @ seen)[6:], rtol=1e-4, atol=1e-7)


def test_what_no_image_tells_becomes_unknown_with_time():
    expects, T = steady()
    blind = SURE.copy()
    blind[4, 4] = 0.0
    unknown = [expects.uncertainty(SURE)]
    for _ in range(12):
        unknown.append(expects.uncertainty(blind))
        there = expects.ahead(T, DEPTH)[0]
        expects.take(T, there, blind, DEPTH)
        T = there
    assert unknown[0] < 1e-3 and np.all(np.diff(unknown[1:]) > 0) and unknown[-1] > 0.01
    assert expects.uncertainty(SURE) < 1e-3  # one good look, and it is known again


@pytest.mark.parametrize(
    ("changed", "uncertainty", "reason"),
    [
        ({}, 0.01, ""),
        ({"error": 60.0}, 0.01, ""),  # other light
        ({"likeness": 0.4}, 0.01, "images_differ"),
        ({"visible": 0.1}, 0.01, "too_little_in_view"),
        ({}, 0.06, "pose_unknown"),
    ],
)
def test_a_frame_is_lost_for_a_reason(changed, uncertainty, reason):
    tracked = Tracked(**{**vars(SEEN), **changed})
    assert reason_of_loss(tracked, uncertainty, LossConfig()) == reason


def test_a_frame_that_is_not_aligned_is_lost():
    assert reason_of_loss(None, np.inf, LossConfig()) == "too_little_in_view"
