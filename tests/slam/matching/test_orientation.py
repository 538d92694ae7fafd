"""Matches that turn as most do are kept."""

import numpy as np
import pytest

from dslab.slam.matching.orientation import WINDOW_DEG, common_turn, keep_common_turn


@pytest.mark.parametrize("turn_deg", [0.0, 6.0, 90.0, 179.0, 359.0])
def test_matches_with_a_common_turn_are_kept_and_strays_are_not(turn_deg):
    rng = np.random.default_rng(10)
    stray = rng.permutation(300) < 60
    turn = turn_deg + np.where(stray, rng.uniform(40, 320, 300), rng.normal(0, 5, 300))
    common = common_turn(turn)
    assert common[~stray].all()
    assert common[stray].sum() <= 0.1 * stray.sum()


def test_the_window_is_that_with_most_on_the_circle():
    rng = np.random.default_rng(1)
    for n in (1, 2, 40):
        turn = rng.uniform(-720, 720, n)
        ahead = (turn[None] - turn[:, None]) % 360.0
        most = (ahead <= WINDOW_DEG).sum(axis=1).max()
        common = common_turn(turn)
        assert common.sum() == most
        held = turn[common]
        assert ((held[None] - held[:, None]) % 360.0 <= WINDOW_DEG).all(axis=1).any()


def test_what_turns_otherwise_is_unset():
    matched = np.arange(50, dtype=np.int32)
    matched[::5] = -1
    turn = np.where(np.arange(50) < 35, 40.0, 200.0)
    assert keep_common_turn(matched, turn) == 28
    assert (np.flatnonzero(matched >= 0) == [i for i in range(35) if i % 5]).all()
    assert keep_common_turn(np.full(3, -1, np.int32), np.zeros(3)) == 0
