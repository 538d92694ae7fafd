"""Recovery by GMS matches, and the parts of it."""

import numpy as np
import pytest
from slam_scenes import VIEW, PointWorld, make_frame, pose_error, rigid, walk

from slam.dual.gms_thread import gms_matches
from slam.dual.pnp import ransac_pnp


@pytest.fixture(scope="module")
def pair():
    world, rng = PointWorld(seed=41), np.random.default_rng(42)
    return [world.see(i, walk(i), rng, noise_px=0.4, bits=8) for i in (0, 6)]


def test_matches_that_their_surroundings_support_are_kept(pair):
    a, b = pair
    pairs = gms_matches(a.frame.features, b.frame.features, VIEW, 6.0)
    right = a.ids[pairs[:, 0]] == b.ids[pairs[:, 1]]
    common = len(np.intersect1d(a.ids[a.ids >= 0], b.ids[b.ids >= 0]))
    assert len(pairs) > 0.5 * common
    assert right.mean() > 0.95
    assert len(np.unique(pairs[:, 0])) == len(np.unique(pairs[:, 1])) == len(pairs)


def test_matches_without_support_are_not():
    """Frames of the same descriptors in random places: every match is unique, and none is believed."""
    rng = np.random.default_rng(43)
    a = make_frame(0, rng, n=400).features
    b = make_frame(1, rng, n=400).features
    b.descriptors[:] = a.descriptors
    assert len(gms_matches(a, b, VIEW, 6.0)) < 8


def test_frames_without_features_have_no_matches(pair):
    nothing = make_frame(0, np.random.default_rng(0), n=0).features
    some = pair[0].frame.features
    for a, b in ((nothing, some), (some, nothing), (nothing, nothing)):
        assert gms_matches(a, b, VIEW, 6.0).shape == (0, 2)


def test_keypoints_on_the_border_do_no_harm(pair):
    """Undistortion may put them there, and GMS reads beyond its grid if they are not within the image."""
    f = pair[0].frame.features
    xy = f.xy.copy()
    xy[:4] = [[VIEW.x_min, VIEW.y_min], [VIEW.x_max, VIEW.y_max], [VIEW.x_min - 2, 5], [9, VIEW.y_max + 2]]
    moved = type(f)(f.index, f.stamp_s, f.xy_image, xy, f.octave, f.angle_deg, f.descriptors, f.cell_start)
    assert len(gms_matches(moved, moved, VIEW, 6.0)) > 0.9 * len(f)


# -- pose ----------------------------------------------------------------------------------------------------


def seen(rng, n, wrong, flat=False):
    T = rigid((0.4, -0.1, 0.3), (4, -9, 12))
    xyz = np.column_stack([rng.uniform(-2, 2, (n, 2)), np.full(n, 5.0) if flat else rng.uniform(4, 8, n)])
    cam = xyz @ T[:3, :3].T + T[:3, 3]
    xy = cam[:, :2] / cam[:, 2:] * (VIEW.fx, VIEW.fy) + (VIEW.cx, VIEW.cy) + rng.normal(0, 0.4, (n, 2))
    xy[:wrong] = rng.uniform((0, 0), (640, 480), (wrong, 2))
    return T, xyz, xy


@pytest.mark.parametrize("flat", [False, True])
def test_the_pose_is_that_of_the_matches_that_are_right(flat):
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


def test_there_is_no_pose_of_wrong_or_of_too_few_matches():
    rng = np.random.default_rng(46)
    _, xyz, xy = seen(rng, 60, 60)
    assert ransac_pnp(xyz, xy, VIEW, rng, 300, 4.0, 20) is None
    _, xyz, xy = seen(rng, 15, 0)
    assert ransac_pnp(xyz, xy, VIEW, rng, 300, 4.0, 20) is None
    assert ransac_pnp(xyz[:0], xy[:0], VIEW, rng, 300, 4.0, 0) is None
