"""The epipolar search agrees with a NumPy search, and its points with the world's."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from slam_scenes import VIEW, PointWorld, rigid, world_ids

from dslab.slam.map import _map_kernels as kernels
from dslab.slam.mapping._triangulation_search import new_points, surrounding_depths
from dslab.slam.matching.guided import NEAR
from dslab.slam.optimization._triangulation import fundamental

PARALLAX = float(np.cos(np.deg2rad(1.15)))
K = np.array([[VIEW.fx, 0, VIEW.cx], [0, VIEW.fy, VIEW.cy], [0, 0, 1]])


def two_views(rng, noise_px=0.0, bits=0, keep=0.3, second=None):
    """A map of two keyframes of a world; the second one is to the side and rotated inward."""
    world = PointWorld(seed=5, points=2500, reach=(-3.5, 4.0))
    poses = (rigid(rotvec_deg=(1, 2, 3)), rigid((-0.5, 0.05, -0.1), (2, -4, 8)) if second is None else second)
    sightings = [world.see(i, T, rng, noise_px, bits) for i, T in enumerate(poses)]
    built, _ = world.map_of(sightings, rng, keep=keep)
    return world, sightings, built


def search(built, min_depth=0.5, parallax=PARALLAX, ratio=0.8, around=0):
    expected = surrounding_depths(built.arrays, 1, around)
    return new_points(built.arrays, VIEW, 1, 0, min_depth, expected, parallax, ratio)


def shown(sightings, rows):
    return np.concatenate([s.ids for s in sightings])[rows]


# -- NumPy reference -----------------------------------------------------------------------------------------


def fundamental_reference(T_1, T_2):
    T = T_2 @ np.linalg.inv(T_1)
    x, y, z = T[:3, 3]
    K_inv = np.linalg.inv(K)
    return K_inv.T @ np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ T[:3, :3] @ K_inv


def stretch_reference(T_21, ray, min_depth):
    """Pixels in view 2 of the nearest depth in front of both cameras, and of infinity; None behind."""
    direction = T_21[:3, :3] @ ray
    if direction[2] < 1e-3:
        return None
    depth = max(min_depth, (1e-3 * min_depth - T_21[2, 3]) / direction[2])
    near = K @ (depth * direction + T_21[:3, 3])
    far = K @ direction
    return np.array([near[:2] / near[2], far[:2] / far[2]])


def near_stretch_reference(xy, ends):
    """Keypoints in a grid cell that the box about the stretch touches."""
    margin = 1.96 * VIEW.scale[-1]
    origin = (VIEW.x_min, VIEW.y_min)
    cell = np.floor((xy - origin) / VIEW.cell)
    low = np.floor((ends.min(0) - margin - origin) / VIEW.cell)
    high = np.floor((ends.max(0) + margin - origin) / VIEW.cell)
    return ((cell >= low) & (cell <= high)).all(1)


def triangulated_reference(T_1, T_2, xy_1, xy_2):
    """Linear triangulation (DLT), then least squares over both images."""
    P_1, P_2 = K @ T_1[:3], K @ T_2[:3]
    A = [
        xy_1[0] * P_1[2] - P_1[0],
        xy_1[1] * P_1[2] - P_1[1],
        xy_2[0] * P_2[2] - P_2[0],
        xy_2[1] * P_2[2] - P_2[1],
    ]
    X = np.linalg.svd(np.array(A))[2][-1]

    def residuals(xyz):
        u, v = P_1 @ [*xyz, 1.0], P_2 @ [*xyz, 1.0]
        return np.concatenate([u[:2] / u[2] - xy_1, v[:2] / v[2] - xy_2])

    return least_squares(residuals, X[:3] / X[3], method="lm", xtol=1e-12, ftol=1e-12).x


def passes_reference(T_1, T_2, xyz, xy_1, xy_2, octaves, parallax):
    distance = []
    rays = []
    for T, xy, octave in ((T_1, xy_1, octaves[0]), (T_2, xy_2, octaves[1])):
        rays.append(T[:3, :3].T @ np.linalg.solve(K, [*xy, 1.0]))
        seen = K @ (T[:3, :3] @ xyz + T[:3, 3])
        if seen[2] <= 0:
            return False
        if ((seen[:2] / seen[2] - xy) ** 2).sum() > 5.991 * VIEW.scale[octave] ** 2:
            return False
        distance.append(np.linalg.norm(T[:3, :3] @ xyz + T[:3, 3]))
    cosine = rays[0] @ rays[1] / np.linalg.norm(rays[0]) / np.linalg.norm(rays[1])
    if not 0 < cosine <= parallax:
        return False
    moved = (distance[1] / distance[0]) / (VIEW.scale[octaves[0]] / VIEW.scale[octaves[1]])
    return 1 / (1.5 * 1.2) <= moved <= 1.5 * 1.2


def new_points_reference(m, min_depth, parallax, ratio):
    a = m.arrays
    T_1, T_2 = m.T_cam_map(1), m.T_cam_map(0)
    T_21 = T_2 @ np.linalg.inv(T_1)
    F = fundamental_reference(T_1, T_2)
    epipole = K @ T_21[:3, 3]
    rows = np.arange(m.keypoints(0).start, m.keypoints(0).stop)
    xy, octave = a.kp_xy[rows], a.kp_octave[rows]
    used = a.kp_point[rows] >= 0
    if epipole[2] > 1e-9:
        off = ((xy - epipole[:2] / epipole[2]) ** 2).sum(1)
        used |= off < 100 * VIEW.scale[octave]
    found = []
    for e in range(m.keypoints(1).start, m.keypoints(1).stop):
        if a.kp_point[e] >= 0:
            continue
        pixel = np.append(a.kp_xy[e], 1.0)
        line = F @ pixel
        ends = stretch_reference(T_21, np.linalg.solve(K, pixel), min_depth)
        if ends is None:
            continue
        off_line = (xy @ line[:2] + line[2]) ** 2 / (line[:2] @ line[:2])
        candidate = ~used & (np.abs(octave - a.kp_octave[e]) <= 2)
        candidate &= (off_line <= 3.84 * VIEW.scale[octave] ** 2) & near_stretch_reference(xy, ends)
        distance = np.bitwise_count(a.kp_descriptor[rows] ^ a.kp_descriptor[e]).sum(1).astype(int)
        order = np.flatnonzero(candidate)
        order = order[np.argsort(distance[order], kind="stable")]
        if not len(order) or distance[order[0]] > NEAR:
            continue
        if len(order) > 1 and distance[order[0]] > ratio * distance[order[1]]:
            continue
        b = order[0]
        xyz = triangulated_reference(T_1, T_2, a.kp_xy[e], xy[b])
        if passes_reference(T_1, T_2, xyz, a.kp_xy[e], xy[b], (a.kp_octave[e], octave[b]), parallax):
            used[b] = True
            found.append((e, rows[b], *xyz))
    return np.array(found).reshape(-1, 5)


# -- properties ----------------------------------------------------------------------------------------------


def test_the_fundamental_matrix_agrees_with_numpy_and_with_projections():
    rng = np.random.default_rng(0)
    for _ in range(20):
        T_1, T_2 = (rigid(rng.normal(size=3), rng.normal(0, 20, 3)) for _ in range(2))
        F, expected = fundamental(T_1, T_2, VIEW), fundamental_reference(T_1, T_2)
        np.testing.assert_allclose(F, expected, atol=1e-12 * np.abs(expected).max())
        X = rng.normal(size=(30, 3)) + np.linalg.inv(T_1)[:3, 3] + T_1[2, :3] * 5
        x_1, x_2 = ((X @ T[:3, :3].T + T[:3, 3]) @ K.T for T in (T_1, T_2))
        residual = np.einsum("ni,ij,nj->n", x_2, F, x_1)
        size = np.linalg.norm(x_2, axis=1) * np.linalg.norm(x_1, axis=1) * np.abs(F).max()
        assert (np.abs(residual) < 1e-12 * size).all()


@pytest.mark.parametrize(
    ("second", "least_deg"),
    [
        pytest.param(None, 1.15, marks=pytest.mark.slow),
        pytest.param(rigid((0.05, -0.02, 0.8), (0, 3, 0)), 0.1, marks=pytest.mark.slow),
        (rigid((0.05, -0.02, -0.8), (0, 3, 0)), 0.1),
    ],
    ids=["aside", "behind", "ahead"],
)
def test_the_search_agrees_with_its_reference(second, least_deg):
    """In a difficult scene, with cases for every rule of the search.

    Ahead and behind have the epipole in the image; with a low parallax threshold keypoints are close to it.
    """
    rng = np.random.default_rng(1)
    _, _, built = two_views(rng, noise_px=0.4, bits=12, second=second)
    make_difficult(built, rng)
    parallax = float(np.cos(np.deg2rad(least_deg)))
    own, theirs, xyz = search(built, parallax=parallax)
    expected = new_points_reference(built, 0.5, parallax, 0.8)
    assert len(own) > 80
    np.testing.assert_array_equal(np.column_stack([own, theirs]), expected[:, :2])
    depth = xyz @ built.T_cam_map(1)[2, :3] + built.T_cam_map(1)[2, 3]
    assert (np.linalg.norm(xyz - expected[:, 2:], axis=1) < 1e-4 * depth).all()


def make_difficult(built, rng):
    """Add keypoints with the same best match, matches already taken, and incompatible levels."""
    a = built.arrays
    rows = np.arange(built.keypoints(1).start, built.keypoints(1).stop)
    originals, doubles = rng.permutation(rows)[:600].reshape(2, 300)
    for original, double in zip(originals, doubles, strict=True):
        kernels.erase_observation(a, double, 0)
        a.kp_xy[double] = a.kp_xy[original] + rng.normal(0, 0.3, 2)
        a.kp_octave[double], a.kp_descriptor[double] = a.kp_octave[original], a.kp_descriptor[original]
    for keyframe in (0, 1):
        known = np.flatnonzero(built.observed_points(keyframe) >= 0) + built.keypoints(keyframe).start
        for row in known[::4]:
            kernels.erase_observation(a, row, 0)
    theirs = built.keypoints(0)
    shift = rng.integers(-3, 4, theirs.stop - theirs.start)
    a.kp_octave[theirs] = np.clip(a.kp_octave[theirs] + shift, 0, 7)


def test_points_equal_the_truth_where_nothing_is_noisy():
    world, sightings, built = two_views(np.random.default_rng(2))
    own, theirs, xyz = search(built)
    ids = shown(sightings, own)
    np.testing.assert_array_equal(ids, shown(sightings, theirs))
    # Keypoints are float32: an error of 1e-5 px or so.
    np.testing.assert_allclose(xyz, world.xyz[ids], rtol=1e-4, atol=1e-4)
    known, _ = world_ids(built, sightings)
    both = np.intersect1d(sightings[0].ids[sightings[0].ids >= 0], sightings[1].ids)
    free = np.setdiff1d(both, known)
    assert len(free) > 200
    assert len(own) >= 0.95 * len(free)


def test_keypoints_with_points_are_not_matched_and_none_is_used_twice():
    _, _, built = two_views(np.random.default_rng(3), noise_px=0.3, bits=8)
    own, theirs, _ = search(built)
    assert (built.arrays.kp_point[own] < 0).all() and (built.arrays.kp_point[theirs] < 0).all()
    assert (built.arrays.kp_keyframe[own] == 1).all() and (built.arrays.kp_keyframe[theirs] == 0).all()
    assert len(np.unique(own)) == len(own) and len(np.unique(theirs)) == len(theirs)


def test_no_match_lies_off_the_epipolar_line():
    """Half the keypoints of a view are moved off their lines: they are not matched."""
    rng = np.random.default_rng(4)
    _, _, built = two_views(rng, keep=0.0)
    a = built.arrays
    F = fundamental_reference(built.T_cam_map(1), built.T_cam_map(0))
    before, _, _ = search(built)
    rows = np.arange(built.keypoints(1).start, built.keypoints(1).stop)
    moved = rng.permutation(rows)[: len(rows) // 2]
    # Normal to its epipolar line in this view, beyond the tolerance of all levels.
    centre = built.arrays.kp_xy[moved].mean(0)
    line = F.T @ np.append(centre, 1.0)
    a.kp_xy[moved] += 40 * line[:2] / np.linalg.norm(line[:2])
    own, theirs, _ = search(built)
    lines = np.column_stack([a.kp_xy[own], np.ones(len(own))]) @ F.T
    off = np.abs((lines[:, :2] * a.kp_xy[theirs]).sum(1) + lines[:, 2]) / np.linalg.norm(lines[:, :2], axis=1)
    assert (off <= np.sqrt(3.84) * VIEW.scale[a.kp_octave[theirs]]).all()
    assert not np.isin(own, moved).any()
    stayed = np.setdiff1d(before, moved)
    assert len(stayed) > 100
    assert np.isin(stayed, own).mean() > 0.95


def test_no_point_has_less_parallax_than_the_threshold():
    _, sightings, built = two_views(np.random.default_rng(6), keep=0.0)
    counts = []
    for least_deg in (1.15, 5.0, 6.5, 40.0):
        own, _, xyz = search(built, parallax=float(np.cos(np.deg2rad(least_deg))))
        rays = [xyz - np.linalg.inv(s.T_cam_world)[:3, 3] for s in sightings]
        cosine = (
            (rays[0] * rays[1]).sum(1) / np.linalg.norm(rays[0], axis=1) / np.linalg.norm(rays[1], axis=1)
        )
        assert (np.rad2deg(np.arccos(cosine)) > least_deg - 1e-3).all()
        counts.append(len(own))
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[1] > counts[2] > counts[3] == 0


def test_the_expected_depth_is_the_median_inverse_depth_of_the_nearest_points():
    _, _, built = two_views(np.random.default_rng(10), keep=0.3)
    a, T = built.arrays, built.T_cam_map(1)
    known = built.observed_points(1) >= 0
    xy = a.kp_xy[built.keypoints(1)]
    depth = a.pt_xyz[built.observed_points(1)[known]] @ T[2, :3] + T[2, 3]
    expected = surrounding_depths(a, 1, 7)
    assert (expected[known] == 0).all()
    for i in np.flatnonzero(~known)[::10]:
        nearest = np.argsort(((xy[known] - xy[i]) ** 2).sum(1))[:7]
        assert expected[i] == pytest.approx(1 / np.median(1 / depth[nearest]))
    assert not surrounding_depths(a, 1, 0).any()


def test_points_around_the_least_parallax_are_not_too_near():
    """After a small step half of them are; asked of measured rays, noise lets the near ones in."""
    rng = np.random.default_rng(11)
    bias = {}
    for around in (0, 7):
        errors = []
        for _ in range(4):
            world, sightings, built = two_views(rng, noise_px=1.0, second=rigid((-0.13, 0.0, 0.0)))
            own, theirs, xyz = search(built, around=around)
            ids = shown(sightings, own)
            right = ids == shown(sightings, theirs)
            errors.append(1 / xyz[right, 2] - 1 / world.xyz[ids[right], 2])
        errors = np.concatenate(errors) / np.median(1 / world.xyz[:, 2])
        assert len(errors) > 300
        bias[around] = errors.mean()
    assert bias[0] > 0.05
    assert abs(bias[7]) < 0.02


def test_rays_that_differ_by_no_more_than_their_noise_give_no_point():
    least = {}
    for around in (0, 7):
        rng = np.random.default_rng(12)
        _, sightings, built = two_views(rng, noise_px=1.0, second=rigid((-0.05, 0.0, 0.0)))
        found = search(built, parallax=float(np.cos(np.deg2rad(0.1))), around=around)[:2]
        rays, noise = [], []
        for rows, seen in zip(found, sightings[::-1], strict=True):
            ray = np.column_stack([built.arrays.kp_xy[rows], np.ones(len(rows))]) @ np.linalg.inv(K).T
            rays.append(ray / np.linalg.norm(ray, axis=1, keepdims=True) @ seen.T_cam_world[:3, :3])
            noise.append(VIEW.scale[built.arrays.kp_octave[rows]] / VIEW.fx)
        angle = np.linalg.norm(np.cross(*rays), axis=1)
        least[around] = (angle / np.hypot(*noise)).min()
    assert least[0] < 1.0
    assert least[7] > 1.99


def test_no_point_is_nearer_than_the_least_depth():
    _, _, built = two_views(np.random.default_rng(7), keep=0.0)
    T = built.T_cam_map(1)
    (every, _, xyz_every), (own, _, xyz) = search(built), search(built, min_depth=7.0)
    depth_every, depth = (points @ T[2, :3] + T[2, 3] for points in (xyz_every, xyz))
    # The grid's cells and the margin about the line blur the bound.
    assert (depth_every < 4.2).sum() > 50
    assert (depth > 4.2).all()
    assert np.isin(every[depth_every > 7.0], own).all()


def test_an_ambiguous_descriptor_is_no_match():
    """All keypoints of the neighbour have one descriptor: only single ones on their line are matched."""
    _, _, built = two_views(np.random.default_rng(8), keep=0.0)
    before = len(search(built)[0])
    a = built.arrays
    a.kp_descriptor[built.keypoints(0)] = 0
    a.kp_descriptor[built.keypoints(1)] = 0b1111
    own, _, _ = search(built)
    assert before > 500
    assert len(own) < 0.05 * before
