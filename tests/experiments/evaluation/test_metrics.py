"""Accuracy figures: known answers, invariances, and agreement with evo."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slam_fakes import circle

from dslab.experiments.evaluation.alignment import Similarity, Undefined
from dslab.experiments.evaluation.metrics import (
    PosePairs,
    associate,
    ate,
    coverage,
    path_length_m,
    rpe,
    scale_along,
)
from dslab.slam.core.results import MapTrajectory

S = Similarity(0.3, Rotation.from_euler("xyz", [0.4, 1.0, -2.0]).as_matrix(), np.array([3.0, -1, 7]))


def noisy_pairs(seed: int = 0, n: int = 200, noise_m: float = 0.02, noise_deg: float = 0.5) -> PosePairs:
    """A true circle and its noisy estimate in another frame and scale, with missing frames."""
    rng = np.random.default_rng(seed)
    truth = circle(n)
    T = truth.copy()
    T[:, :3, 3] += rng.normal(0, noise_m, (n, 3))
    T[:, :3, :3] = (
        T[:, :3, :3] @ Rotation.from_rotvec(np.radians(rng.normal(0, noise_deg, (n, 3)))).as_matrix()
    )
    keep = np.flatnonzero(rng.random(n) > 0.1)
    return PosePairs(keep, S.poses(T[keep]), truth[keep])


def test_ate_of_a_perfect_estimate_at_any_scale_is_zero():
    truth = circle(50)
    result = ate(PosePairs(np.arange(50), S.poses(truth), truth))
    assert result.rmse_m < 1e-12
    assert result.alignment.scale == pytest.approx(1 / 0.3)


def test_ate_of_one_displaced_pose_is_the_known_value():
    n, off = 1000, 0.5
    truth = circle(n)
    estimate = truth.copy()
    estimate[500, 2, 3] += off
    # One pose of many hardly moves the alignment.
    result = ate(PosePairs(np.arange(n), estimate, truth))
    assert result.rmse_m == pytest.approx(off / np.sqrt(n), rel=0.02)
    assert result.errors_m.max() == pytest.approx(off, rel=0.02)
    assert np.median(result.errors_m) < 0.01 * off


def test_rpe_of_a_constant_turn_error_is_that_turn():
    truth = circle(100)
    estimate = truth.copy()
    turn = Rotation.from_rotvec(np.radians(np.arange(100)[:, None] * [0, 0.2, 0])).as_matrix()
    estimate[:, :3, :3] = truth[:, :3, :3] @ turn
    result = rpe(PosePairs(np.arange(100), estimate, truth), 10)
    assert result.pairs == 90
    assert result.rotation_rmse_deg == pytest.approx(2.0, rel=1e-6)


def test_rpe_in_frames_uses_only_steps_posed_at_both_ends():
    truth = circle(20)
    frames = np.array([0, 1, 2, 7, 8, 12])
    pairs = PosePairs(frames, truth[frames], truth[frames])
    assert rpe(pairs, 5).pairs == 2  # 2-7, 7-12
    assert isinstance(rpe(pairs, 15), Undefined)


def test_degenerate_input_gives_no_figures():
    truth = circle(50)
    for few in (0, 1, 2):
        pairs = PosePairs(np.arange(few), truth[:few], truth[:few])
        assert isinstance(ate(pairs), Undefined)
        assert isinstance(rpe(pairs, 5), Undefined)


def test_frames_without_truth_are_left_out():
    truth = circle(30)
    truth[10:20] = np.nan
    stamps = np.arange(30) / 30
    pairs = associate(MapTrajectory(0, np.arange(30), stamps, circle(30)), stamps, truth)
    assert set(pairs.frames) == {*range(10), *range(20, 30)}
    assert ate(pairs).rmse_m < 1e-12


def test_an_estimate_of_another_sequence_is_refused():
    stamps = np.arange(30) / 30
    with pytest.raises(ValueError, match="time stamps"):
        associate(MapTrajectory(0, np.arange(30), stamps + 0.01, circle(30)), stamps, circle(30))
    with pytest.raises(ValueError, match="of a sequence"):
        associate(MapTrajectory(0, np.array([30]), np.array([1.0]), circle(1)), stamps, circle(30))


def test_coverage_counts_steps_between_consecutive_posed_frames():
    T = np.tile(np.eye(4), (11, 1, 1))
    T[:, 0, 3] = np.arange(11)
    covered = coverage(np.array([0, 1, 2, 5, 6, 10]), T)
    assert covered.path_m == pytest.approx(3.0)
    assert covered.share == pytest.approx(0.3)
    T[3] = np.nan
    assert path_length_m(T) == pytest.approx(8.0)


@pytest.mark.parametrize("seed", [13, 21, 23, 29])
def test_no_share_of_a_path_is_above_1(seed):
    """Of these paths the steps after a stand add to more than all steps, by rounding."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (rng.integers(20, 400), 1, 1))
    T[:, :3, 3] = np.cumsum(rng.normal(size=(len(T), 3)), 0)
    T[:5, :3, 3] = T[4, :3, 3]
    steps = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    assert steps[4:].sum() > steps.sum() and coverage(np.arange(4, len(T)), T).share == 1.0


# -- evo as the oracle -------------------------------------------------------------------------------------


def evo_trajectories(pairs: PosePairs):
    trajectory = pytest.importorskip("evo.core.trajectory")
    make = trajectory.PoseTrajectory3D
    stamps = pairs.frames / 30
    return make(poses_se3=list(pairs.T_world_cam), timestamps=stamps), make(
        poses_se3=list(pairs.T_map_cam), timestamps=stamps
    )


def ate_of_evo(pairs: PosePairs) -> dict[str, float]:
    evo_metrics = pytest.importorskip("evo.core.metrics")
    reference, estimate = evo_trajectories(pairs)
    estimate.align(reference, correct_scale=True)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data((reference, estimate))
    return ape.get_all_statistics()


@pytest.mark.parametrize("seed", range(3))
def test_ate_agrees_with_evo(seed):
    pairs = noisy_pairs(seed)
    ours, theirs = ate(pairs), ate_of_evo(pairs)
    assert ours.rmse_m == pytest.approx(theirs["rmse"], rel=1e-9)
    assert np.median(ours.errors_m) == pytest.approx(theirs["median"], rel=1e-9)
    assert ours.errors_m.max() == pytest.approx(theirs["max"], rel=1e-9)


def test_ate_on_a_line_agrees_with_evo_a_hair_off_it():
    pairs = noisy_pairs()
    pairs.T_world_cam[:, :3, 3] = np.linspace(0, 4, len(pairs))[:, None] * [0.6, 0, 0.8]
    estimate = pairs.T_world_cam.copy()
    estimate[:, :3, 3] += np.random.default_rng(0).normal(0, 0.05, (len(pairs), 3))
    on_line = PosePairs(pairs.frames, S.poses(estimate), pairs.T_world_cam)
    ours = ate(on_line)
    on_line.T_world_cam[:, :3, 3] += np.random.default_rng(1).normal(0, 1e-6, (len(pairs), 3))
    theirs = ate_of_evo(on_line)  # on the line itself evo refuses
    assert ours.rmse_m == pytest.approx(theirs["rmse"], rel=1e-5)
    assert ours.errors_m.max() == pytest.approx(theirs["max"], rel=1e-4)


def test_rpe_agrees_with_evo():
    evo_metrics = pytest.importorskip("evo.core.metrics")
    pairs = noisy_pairs(7)
    # evo counts poses, not frames: without gaps the two are the same.
    pairs = PosePairs(np.arange(len(pairs)), pairs.T_map_cam, pairs.T_world_cam)
    scale = ate(pairs).alignment.scale
    reference, estimate = evo_trajectories(pairs)
    estimate.scale(scale)
    ours = rpe(pairs, 10, scale)
    for relation, value in (
        (evo_metrics.PoseRelation.translation_part, ours.translation_rmse_m),
        (evo_metrics.PoseRelation.rotation_angle_deg, ours.rotation_rmse_deg),
    ):
        theirs = evo_metrics.RPE(
            relation, 10, evo_metrics.Unit.frames, all_pairs=True, pairs_from_reference=True
        )
        theirs.process_data((reference, estimate))
        assert value == pytest.approx(theirs.get_statistic(evo_metrics.StatisticsType.rmse), rel=1e-9)


def test_scale_along_follows_steps_that_grow_and_skips_gaps():
    n = 401
    truth = np.tile(np.eye(4), (n, 1, 1))
    truth[:, 2, 3] = np.arange(n)
    estimate = truth.copy()
    growing = np.linspace(1.0, 1.04, n - 1)  # estimated length of each step of one metre
    estimate[1:, 2, 3] = 0.3 * np.cumsum(growing)
    whole = PosePairs(np.arange(n), estimate, truth)
    found = scale_along(whole)
    assert found.first_over_last == pytest.approx(1.03, abs=1e-3)
    assert found.relative == pytest.approx(np.median(growing) / growing[20::40], abs=1e-3)
    # A pose that is missing takes its two steps away, nothing else; one far off in a gap is no step.
    with_gap = whole.where(np.arange(n) % 50 != 25)
    assert scale_along(with_gap).steps == n - 1 - 2 * 8
    assert scale_along(with_gap).first_over_last == pytest.approx(1.03, abs=1e-3)


def test_scale_along_of_a_perfect_estimate_is_one_and_of_no_motion_undefined():
    truth = circle(80)
    perfect = scale_along(PosePairs(np.arange(80), S.poses(truth), truth))
    assert perfect.first_over_last == pytest.approx(1.0, abs=1e-9)
    assert perfect.relative == pytest.approx(np.ones(10), abs=1e-9)
    still = np.tile(np.eye(4), (5, 1, 1))
    assert isinstance(scale_along(PosePairs(np.arange(5), still, still)), Undefined)
    assert isinstance(scale_along(PosePairs(np.arange(80), np.tile(np.eye(4), (80, 1, 1)), truth)), Undefined)


@pytest.mark.parametrize("rests", [slice(0, 30), slice(51, 81)], ids=["first", "last"])
def test_scale_along_is_undefined_where_the_truth_rests_in_an_outer_quarter(rests):
    truth = np.tile(np.eye(4), (81, 1, 1))
    steps = np.zeros(81)
    steps[40] = 1.0  # one step over the whole path, but for the hair of another
    steps[[20, 60]] = 1e-3
    steps[rests] = 0.0
    truth[:, 2, 3] = np.cumsum(steps)
    estimate = truth.copy()
    estimate[:, 0, 3] = 1e-3 * (np.arange(81) % 2)  # it trembles where the truth rests
    found = scale_along(PosePairs(np.arange(81), estimate, truth))
    assert isinstance(found, Undefined) and "no true" in found.reason
