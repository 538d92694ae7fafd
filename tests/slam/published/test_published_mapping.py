"""New points of the published base are those of a NumPy search, and those of the world."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from slam_scenes import VIEW, PointWorld, rigid

from dslab.slam.map import _map_kernels as kernels
from dslab.slam.published._mapping_kernels import new_points
from dslab.slam.published._search_kernels import FREE_BITS

PARALLAX = float(np.cos(np.deg2rad(1.15)))
K = np.array([[VIEW.fx, 0, VIEW.cx], [0, VIEW.fy, VIEW.cy], [0, 0, 1]])


def two_views(rng, noise_px=0.0, bits=0, keep=0.3, second=None):
    """A map of two keyframes of a world; the second one is to the side and rotated inward."""
    world = PointWorld(seed=5, points=2500, reach=(-3.5, 4.0))
    poses = (rigid(rotvec_deg=(1, 2, 3)), rigid((-0.5, 0.05, -0.1), (2, -4, 8)) if second is None else second)
    sightings = [world.see(i, T, rng, noise_px, bits) for i, T in enumerate(poses)]
    built, _ = world.map_of(sightings, rng, keep=keep)
    return world, sightings, built


def search(built, min_depth=0.5, parallax=PARALLAX):
    return new_points(built.arrays, VIEW, 1, 0, min_depth, parallax)


def shown(sightings, rows):
    return np.concatenate([s.ids for s in sightings])[rows]


def triangulated_reference(T_1, T_2, xy_1, xy_2):
    """Linear triangulation (DLT), then least squares over both images."""
    P = K @ T_1[:3], K @ T_2[:3]
    A = [row for P_i, xy in zip(P, (xy_1, xy_2), strict=True) for row in (xy[:, None] * P_i[2] - P_i[:2])]
    X = np.linalg.svd(np.array(A))[2][-1]

    def residuals(xyz):
        projected = [P_i @ [*xyz, 1.0] for P_i in P]
        return np.concatenate([p[:2] / p[2] - xy for p, xy in zip(projected, (xy_1, xy_2), strict=True)])

    return least_squares(residuals, X[:3] / X[3], method="lm", xtol=1e-12, ftol=1e-12).x


def passes_reference(poses, xyz, xys, octaves, parallax):
    rays = []
    for T, xy, octave in zip(poses, xys, octaves, strict=True):
        in_camera = T[:3, :3] @ xyz + T[:3, 3]
        seen = K @ in_camera
        if seen[2] <= 0 or ((seen[:2] / seen[2] - xy) ** 2).sum() > 5.99 * VIEW.scale[octave] ** 2:
            return False
        rays.append(T[:3, :3].T @ in_camera)
    distance = np.linalg.norm(rays, axis=1)
    if rays[0] @ rays[1] > parallax * distance.prod():
        return False
    return 1 / 1.8 < distance[1] / distance[0] * VIEW.scale[octaves[1]] / VIEW.scale[octaves[0]] < 1.8


def new_points_reference(m, min_depth, parallax):
    a = m.arrays
    T_1, T_2 = m.T_cam_map(1), m.T_cam_map(0)
    T = T_2 @ np.linalg.inv(T_1)
    rows = np.arange(m.keypoints(0).start, m.keypoints(0).stop)
    xy, octave, used = a.kp_xy[rows], a.kp_octave[rows], a.kp_point[rows] >= 0
    found = []
    for e in range(m.keypoints(1).start, m.keypoints(1).stop):
        direction = T[:3, :3] @ np.linalg.solve(K, [*a.kp_xy[e], 1.0])
        if a.kp_point[e] >= 0 or direction[2] < 1e-3:
            continue
        depth = max(min_depth, (1e-3 - T[2, 3]) / direction[2] if T[2, 3] < 0 else 0.0)
        if T[2, 3] < 0:
            depth = max(min_depth, -T[2, 3] / (direction[2] - 1e-3))
        near, far = K @ (depth * direction + T[:3, 3]), K @ direction
        near, far = near[:2] / near[2], far[:2] / far[2]
        along = near - far
        away = xy - far
        off = (along[0] * away[:, 1] - along[1] * away[:, 0]) ** 2 / (along @ along)
        place = away @ along / (along @ along)
        bits = np.bitwise_count(a.kp_descriptor[rows] ^ a.kp_descriptor[e]).sum(1).astype(int)
        fits = ~used & (off <= 3.84 * VIEW.scale[octave] ** 2) & (place > 0) & (place <= 1)
        fits &= bits <= FREE_BITS
        if not fits.any():
            continue
        b = np.flatnonzero(fits)[np.argmin(bits[fits])]
        xys = a.kp_xy[e], xy[b]
        xyz = triangulated_reference(T_1, T_2, *xys)
        if passes_reference((T_1, T_2), xyz, xys, (a.kp_octave[e], octave[b]), parallax):
            used[b] = True
            found.append((e, rows[b], *xyz))
    return np.array(found).reshape(-1, 5)


@pytest.mark.parametrize(
    ("second", "least_deg"),
    [(None, 1.15), (rigid((0.05, -0.02, -0.8), (0, 3, 0)), 0.1)],
    ids=["aside", "ahead"],
)
def test_the_search_agrees_with_its_reference(second, least_deg):
    """With keypoints that look alike, points to share, and levels that do not go together."""
    rng = np.random.default_rng(1)
    _, _, built = two_views(rng, noise_px=0.4, bits=12, second=second)
    a = built.arrays
    for keyframe in (0, 1):
        known = np.flatnonzero(built.observed_points(keyframe) >= 0) + built.keypoints(keyframe).start
        for row in known[::4]:
            kernels.erase_observation(a, row, 0)
    theirs = built.keypoints(0)
    a.kp_octave[theirs] = np.clip(a.kp_octave[theirs] + rng.integers(-3, 4, theirs.stop - theirs.start), 0, 7)
    parallax = float(np.cos(np.deg2rad(least_deg)))
    own, theirs, xyz = search(built, parallax=parallax)
    expected = new_points_reference(built, 0.5, parallax)
    assert len(own) > 80
    np.testing.assert_array_equal(np.column_stack([own, theirs]), expected[:, :2])
    depth = xyz @ built.T_cam_map(1)[2, :3] + built.T_cam_map(1)[2, 3]
    assert (np.linalg.norm(xyz - expected[:, 2:], axis=1) < 1e-4 * depth).all()


def test_points_equal_the_truth_where_nothing_is_noisy():
    world, sightings, built = two_views(np.random.default_rng(2))
    own, theirs, xyz = search(built)
    ids = shown(sightings, own)
    right = ids == shown(sightings, theirs)
    assert right.mean() > 0.99
    np.testing.assert_allclose(xyz[right], world.xyz[ids[right]], rtol=1e-4, atol=1e-4)
    assert len(np.unique(own)) == len(own) and len(np.unique(theirs)) == len(theirs)


def test_no_point_has_less_parallax_or_depth_than_asked():
    _, sightings, built = two_views(np.random.default_rng(6), keep=0.0)
    counts = []
    for least_deg in (1.15, 5.0, 6.5, 40.0):
        own, _, xyz = search(built, parallax=float(np.cos(np.deg2rad(least_deg))))
        rays = [xyz - np.linalg.inv(s.T_cam_world)[:3, 3] for s in sightings]
        lengths = [np.linalg.norm(ray, axis=1) for ray in rays]
        cosine = (rays[0] * rays[1]).sum(1) / lengths[0] / lengths[1]
        assert (np.rad2deg(np.arccos(cosine)) > least_deg - 1e-3).all()
        counts.append(len(own))
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[2] > counts[3] == 0
    T = built.T_cam_map(1)
    _, _, xyz = search(built, min_depth=7.0)
    depth = xyz @ T[2, :3] + T[2, 3]
    assert len(depth) > 50 and (depth < 6.5).mean() < 0.1  # the search is bound, not what is triangulated
