"""Error between start and end: known drifts, and truth at both ends only."""

import numpy as np
import pytest
from slam_fakes import circle

from dslab.experiments.evaluation.alignment import Undefined
from dslab.experiments.evaluation.end_alignment import END_S, end_alignment_error_m
from dslab.slam.core.results import MapTrajectory

FRAMES, FPS = 600, 10.0
STAMPS_S = np.arange(FRAMES) / FPS
TRUTH = circle(FRAMES)


def path(T, frames=None) -> MapTrajectory:
    frames = np.arange(FRAMES) if frames is None else frames
    return MapTrajectory(0, frames, STAMPS_S[frames], T[frames])


def with_truth_at_the_ends() -> np.ndarray:
    inside = (STAMPS_S > END_S) & (STAMPS_S[-1] - END_S > STAMPS_S)
    return np.where(inside[:, None, None], np.nan, TRUTH)


def test_a_path_without_drift_has_none_at_any_scale_and_with_truth_at_the_ends_only():
    scaled = TRUTH.copy()
    scaled[:, :3, 3] *= 0.3
    for truth in (TRUTH, with_truth_at_the_ends()):
        assert end_alignment_error_m(path(scaled), STAMPS_S, truth) == pytest.approx(0, abs=1e-9)


def test_a_jump_in_the_middle_is_the_error():
    """The start says that the rest is 2 m off, the end that the beginning is: 2 m everywhere."""
    jumped = TRUTH.copy()
    jumped[FRAMES // 2 :, 0, 3] += 2.0
    for truth in (TRUTH, with_truth_at_the_ends()):
        assert end_alignment_error_m(path(jumped), STAMPS_S, truth) == pytest.approx(2.0)


def test_a_path_that_does_not_reach_an_end_has_no_error():
    for frames, name in ((np.arange(FRAMES - 150), "end"), (np.arange(150, FRAMES), "start")):
        found = end_alignment_error_m(path(TRUTH, frames), STAMPS_S, TRUTH)
        assert isinstance(found, Undefined) and f"at its {name}" in found.reason
    assert isinstance(end_alignment_error_m(path(TRUTH), STAMPS_S, np.full_like(TRUTH, np.nan)), Undefined)
