"""A pose from points with many outliers."""

import numpy as np
import pytest
from slam_scenes import VIEW, pose_error, rigid

from dslab.slam.tracking.pnp import ransac_pnp


def seen(rng, n, wrong, flat=False):
    T = rigid((0.4, -0.1, 0.3), (4, -9, 12))
    xyz = np.column_stack([rng.uniform(-2, 2, (n, 2)), np.full(n, 5.0) if flat else rng.uniform(4, 8, n)])
    cam = xyz @ T[:3, :3].T + T[:3, 3]
    xy = cam[:, :2] / cam[:, 2:] * (VIEW.fx, VIEW.fy) + (VIEW.cx, VIEW.cy) + rng.normal(0, 0.4, (n, 2))
    xy[:wrong] = rng.uniform((0, 0), (640, 480), (wrong, 2))
    return T, xyz, xy


@pytest.mark.parametrize("flat", [False, True])
def test_the_pose_is_that_of_the_inliers(flat):
    T, xyz, xy = seen(np.random.default_rng(44), 100, 40, flat)
    found = ransac_pnp(xyz, xy, VIEW, np.random.default_rng(0), 300, 4.0, 20)
    assert found is not None
    distance, angle = pose_error(found[0], T)
    assert distance < 0.03 and angle < 0.3
    assert found[1][40:].mean() > 0.9 and found[1][:40].mean() < 0.1


def test_the_pose_is_the_same_for_the_same_stream():
    _, xyz, xy = seen(np.random.default_rng(45), 100, 60)
    a, b = (ransac_pnp(xyz, xy, VIEW, np.random.default_rng(7), 300, 4.0, 20) for _ in range(2))
    assert a is not None and b is not None
    assert a[0].tobytes() == b[0].tobytes() and (a[1] == b[1]).all()


def test_wrong_or_too_few_matches_give_no_pose():
    rng = np.random.default_rng(46)
    _, xyz, xy = seen(rng, 60, 60)
    assert ransac_pnp(xyz, xy, VIEW, rng, 300, 4.0, 20) is None
    _, xyz, xy = seen(rng, 15, 0)
    assert ransac_pnp(xyz, xy, VIEW, rng, 300, 4.0, 20) is None
    assert ransac_pnp(xyz[:0], xy[:0], VIEW, rng, 300, 4.0, 0) is None


def test_points_without_extent_give_no_pose():
    """Those of a map that has collapsed: OpenCV's SQPnP raises an error."""
    xyz = np.array([4.9, 0.0, 1.2]) + np.random.default_rng(47).normal(0, 1e-5, (13, 3))
    one_place = np.full((13, 2), 100.0)
    assert ransac_pnp(xyz, one_place, VIEW, np.random.default_rng(0), 300, 3.0, 6) is None
