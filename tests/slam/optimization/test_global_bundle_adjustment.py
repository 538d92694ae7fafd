"""Global bundle adjustment by pycolmap has the same cost as ours, with weights per octave."""

import numpy as np
import pytest
from test_bundle_adjustment import DELTA, INTRINSICS, scene

from dslab.slam.optimization.bundle_adjustment import bundle_adjust
from dslab.slam.optimization.global_bundle_adjustment import global_bundle_adjust
from dslab.slam.optimization.pose import CHI2_2DOF

SIGMA = 1.2 ** np.arange(8)


def octave_of(problem):
    return np.rint(-np.log(problem.inv_sigma2) / (2 * np.log(1.2))).astype(int)


def adjusted(problem, iterations=100, apart=False):
    return global_bundle_adjust(
        problem.T, problem.points, problem.camera, problem.point, problem.pixels, octave_of(problem), SIGMA,
        *INTRINSICS, iterations, apart,
    )  # fmt: skip


@pytest.mark.parametrize("outliers", [False, True])
def test_the_cost_agrees_with_our_bundle_adjustment(outliers):
    _, start = scene(n_fixed=1, cameras=6, n_points=60, spread=0.02)
    if outliers:
        start.pixels[::9] += 12.0
    theirs = adjusted(start)
    ours = bundle_adjust(*start.arguments(), 200, DELTA)
    assert theirs.cost_final == pytest.approx(ours.cost_final, rel=1e-6)
    assert theirs.cost_initial == pytest.approx(ours.cost_initial, rel=1e-9)
    chi2 = (start.whitened(theirs.T_cam_map, theirs.points) ** 2).sum(axis=1)
    np.testing.assert_allclose(theirs.chi2, chi2, rtol=1e-9)


def test_the_first_camera_is_fixed_and_the_others_find_the_truth():
    truth, start = scene(n_fixed=1, noise=0.0)
    result = adjusted(start)
    np.testing.assert_array_equal(result.T_cam_map[0], start.T[0])
    scale = np.linalg.norm(result.T_cam_map[-1, :3, 3]) / np.linalg.norm(truth.T[-1, :3, 3])
    origin = np.linalg.inv(truth.T[0])[:3, 3]
    np.testing.assert_allclose(result.points - origin, scale * (truth.points - origin), atol=1e-4)
    assert (result.chi2 < CHI2_2DOF).all()


def test_unseen_points_are_unchanged_and_repetitions_equal():
    _, start = scene(n_fixed=1)
    keep = start.point != 3
    start.camera, start.point = start.camera[keep], start.point[keep]
    start.pixels, start.inv_sigma2 = start.pixels[keep], start.inv_sigma2[keep]
    one, two = adjusted(start), adjusted(start)
    np.testing.assert_array_equal(one.points[3], start.points[3])
    assert one.T_cam_map.tobytes() == two.T_cam_map.tobytes()
    assert one.points.tobytes() == two.points.tobytes()


def test_a_point_that_one_camera_alone_has_in_front_of_it_is_left_where_it_is():
    _, start = scene(n_fixed=1)
    start.points[3] += [0.0, 0.0, -50.0]  # behind all cameras but, turned round, the last
    start.T[-1] = np.diag([-1.0, 1.0, -1.0, 1.0]) @ start.T[-1]
    assert (np.bincount(start.camera[start.point == 3]) > 0).sum() > 2
    result = adjusted(start)
    np.testing.assert_array_equal(result.points[3], start.points[3])


def test_misuse_is_refused():
    _, start = scene()
    start.T = start.T[:1]
    with pytest.raises(ValueError, match="two cameras"):
        adjusted(start)


def test_a_separate_process_gives_the_same_bits_and_no_output(capfd):
    _, start = scene(n_fixed=1)
    here, apart = adjusted(start), adjusted(start, apart=True)
    assert here.T_cam_map.tobytes() == apart.T_cam_map.tobytes()
    assert here.points.tobytes() == apart.points.tobytes()
    assert capfd.readouterr() == ("", "")
