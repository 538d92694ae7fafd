"""The rule of loss: motions that no image tells apart."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dslab.slam.ldso.config import LossConfig
from dslab.slam.ldso.loss import LossRule
from dslab.slam.ldso.tracking import Tracked

DEPTH = 2.0
SEEN = Tracked(np.eye(4), np.zeros(2), 3.0, 0.9, 0.0, 0.98, (1.0, 1.0))


def step(shift: float, turn_deg: float, axis: int = 0) -> np.ndarray:
    """Motion that shifts the image's centre by this, and turns it likewise."""
    T = np.eye(4)
    T[axis, 3] = shift * DEPTH
    turn = np.deg2rad(turn_deg)
    T[:3, :3] = Rotation.from_rotvec([0, turn, 0] if axis == 0 else [-turn, 0, 0]).as_matrix()
    return T


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    ("shift", "turn_deg", "reason"),
    [
        (0.05, 0.6, ""),
        (0.01, 2.8, "turn_for_shift"),
        (0.09, -1.8, "turn_for_shift"),
        (0.01, 0.6, ""),  # it stops
        (0.05, 3.5, ""),  # it turns
        (0.09, 2.8, ""),  # frames were dropped
        (0.04, 1.1, ""),  # by little
    ],
)
def test_a_turn_in_the_place_of_a_shift_is_no_tracking(shift, turn_deg, reason, axis):
    rule = LossRule(LossConfig())
    assert rule.reason(SEEN, step(0.01, 2.8, axis), DEPTH) == ""  # nothing to compare it with
    for _ in range(3):
        rule.tracked(SEEN, step(0.05, 0.5, axis), DEPTH)
    assert rule.reason(SEEN, step(shift, turn_deg, axis), DEPTH) == reason


@pytest.mark.parametrize("axis", [0, 1])
def test_such_a_turn_moves_the_image_as_the_shift_does(axis):
    ahead = np.array([0, 0, DEPTH, 1.0])
    shifted, turned = step(0.03, 0.0, axis) @ ahead, step(0.0, np.rad2deg(0.03), axis) @ ahead
    assert shifted[axis] / shifted[2] == pytest.approx(turned[axis] / turned[2], rel=1e-3)
