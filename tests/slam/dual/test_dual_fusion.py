"""Two maps of one world: their similarity is estimated or refused, and they are fused."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import NO_POINT, VIEW, PointWorld, pose_error, rigid, rms, walk, world_ids

from dslab.slam.dual.fusion.fuse import FusionConfig, confirms, fuse
from dslab.slam.loop_closing.map_alignment import align
from dslab.slam.map.invariants import check_map
from dslab.slam.mapping.local_mapping import LocalMappingConfig
from dslab.slam.optimization.sim3 import horn_sim3, sim3_decompose, sim3_inverse, sim3_matrix

CONFIG = FusionConfig()
SCALE = 0.37
MOVED = rigid((2.0, -1.0, 3.0), (20, -35, 50))
OLD = range(0, 35, 5)  # frames that are the old map's keyframes
NEW = range(20, 65, 5)


@pytest.fixture(scope="module")
def world():
    return PointWorld(seed=21)


@pytest.fixture(scope="module")
def sightings(world):
    rng = np.random.default_rng(22)
    return {i: world.see(i, walk(i), rng, noise_px=0.5, bits=8) for i in range(0, 65, 5)}


@pytest.fixture(scope="module")
def built(world, sightings):
    rng = np.random.default_rng(23)
    old, _ = world.map_of([sightings[i] for i in OLD], rng, noise=0.01)
    new, _ = world.map_of([sightings[i] for i in NEW], rng, noise=0.01, map_id=1)
    new.transform(SCALE, MOVED[:3, :3], MOVED[:3, 3])
    return old, new


@pytest.fixture
def maps(built):
    """The old map in the frame of the world, the new one in another frame and scale."""
    return tuple(m.copy() for m in built)


S_OLD_NEW = sim3_inverse(sim3_matrix(SCALE, MOVED[:3, :3], MOVED[:3, 3]))


def at(frames, i):
    return list(frames).index(i)


def aligned(maps, old_frame, new_frame, config=CONFIG, seed=0):
    rng = np.random.default_rng(seed)
    return align(*maps, at(OLD, old_frame), at(NEW, new_frame), rng, config)


def points_of(m, keyframe):
    """Rows of the points that a keyframe observes."""
    points = m.observed_points(keyframe)
    return points[points >= 0].copy()


# -- alignment -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pair", [(25, 25), (30, 30), (30, 25), (20, 25)])
def test_the_similarity_between_two_maps_is_recovered(maps, pair):
    alignment, reason, matches = aligned(maps, *pair)
    assert alignment is not None
    assert reason == "" and matches == alignment.inliers >= CONFIG.min_matches
    assert alignment.scale == pytest.approx(1 / SCALE, rel=5e-3)
    s, R, _ = sim3_decompose(alignment.S_old_new)
    _, R_true, _ = sim3_decompose(S_OLD_NEW)
    assert s == pytest.approx(alignment.scale)
    assert np.rad2deg(np.arccos(min((np.trace(R.T @ R_true) - 1) / 2, 1))) < 0.3
    seen = maps[1].arrays.pt_xyz[points_of(maps[1], alignment.new_keyframe)]
    here, there = (seen @ S[:3, :3].T + S[:3, 3] for S in (alignment.S_old_new, S_OLD_NEW))
    assert np.linalg.norm(here - there, axis=1).max() < 0.06
    assert (alignment.old_map_id, alignment.old_keyframe) == (0, at(OLD, pair[0]))
    assert alignment.new_keyframe == at(NEW, pair[1])


def test_matched_points_are_the_same_world_points(sightings, maps):
    old, new = maps
    alignment, _, _ = aligned(maps, 25, 25)
    ids_old, _ = world_ids(old, [sightings[i] for i in OLD])
    ids_new, _ = world_ids(new, [sightings[i] for i in NEW])
    np.testing.assert_array_equal(ids_old[alignment.old_points], ids_new[alignment.new_points])
    assert len(np.unique(alignment.old_points)) == alignment.inliers


def test_guided_search_adds_matches(maps):
    """Keypoints with very different descriptors are matched only near their predicted positions."""
    _, new = maps
    rows = np.arange(*new.keypoints(at(NEW, 25)).indices(10**6))[::2]
    # 60 bits: too far for an unguided match.
    new.arrays.kp_descriptor[rows, 0] ^= np.uint64(2**60 - 1)
    alignment, _, _ = aligned(maps, 25, 25)
    changed = np.isin(alignment.new_points, new.arrays.kp_point[rows])
    assert changed.mean() > 0.4


def test_the_same_seed_gives_the_same_alignment(maps):
    first, second = (aligned(maps, 25, 25)[0] for _ in range(2))
    np.testing.assert_array_equal(first.S_old_new, second.S_old_new)


def test_maps_without_overlap_are_refused(world, maps):
    """The ends of the two maps show different parts of the world."""
    rng = np.random.default_rng(24)
    far = {i: world.see(i, walk(i), rng, noise_px=0.5, bits=8) for i in (140, 145)}
    new, _ = world.map_of(list(far.values()), rng, map_id=1)
    assert len(new.points()) > 100
    alignment, reason, _ = align(maps[0], new, 0, 1, rng, CONFIG)
    assert alignment is None and reason == "overlap"


def test_a_keyframe_without_points_is_refused(world, sightings, maps):
    empty, _ = world.map_of([sightings[i] for i in OLD], np.random.default_rng(0), keep=0.0)
    for pair in ((empty, maps[1]), (maps[1], empty)):
        alignment, reason, matches = align(*pair, 2, 2, np.random.default_rng(0), CONFIG)
        assert (alignment, reason, matches) == (None, "overlap", 0)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("corruption", ["scrambled", "half_displaced", "half_moved_as_one", "blurred"])
def test_a_corrupted_map_is_refused(maps, corruption, seed):
    old, _ = maps
    rng = np.random.default_rng(seed)
    points = points_of(old, at(OLD, 25))
    half = points[rng.permutation(len(points))[: int(0.55 * len(points))]]
    xyz = old.arrays.pt_xyz
    if corruption == "scrambled":
        xyz[points] = xyz[rng.permutation(points)]
    elif corruption == "half_displaced":
        xyz[half] += rng.normal(0, 1, (len(half), 3))
    elif corruption == "half_moved_as_one":
        xyz[half] += (0.8, 0.2, -0.4)
    else:
        xyz[points] += rng.normal(0, 0.5, (len(points), 3))
    alignment, reason, _ = aligned(maps, 25, 25, seed=seed)
    assert alignment is None and reason == "sim3"


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_some_wrong_points_are_tolerated(maps, share):
    old, _ = maps
    rng = np.random.default_rng(5)
    points = points_of(old, at(OLD, 25))
    wrong = rng.permutation(points)[: int(share * len(points))]
    old.arrays.pt_xyz[wrong] += rng.normal(0, 1, (len(wrong), 3))
    alignment, _, _ = aligned(maps, 25, 25)
    assert alignment.scale == pytest.approx(1 / SCALE, rel=5e-3)
    assert np.isin(alignment.old_points, wrong).mean() < 0.05


def test_every_threshold_is_applied(maps):
    _, _, matches = aligned(maps, 25, 25)
    for field, value, reason in (
        ("min_candidates", 10**6, "overlap"),
        ("min_inliers", 10**6, "sim3"),
        ("min_share", 1.0, "sim3"),
        ("min_matches", matches + 1, "sim3"),
    ):
        assert aligned(maps, 25, 25, replace(CONFIG, **{field: value}))[:2] == (None, reason)
    assert aligned(maps, 25, 25, replace(CONFIG, min_matches=matches))[0] is not None


# -- agreement -----------------------------------------------------------------------------------------------


def test_alignments_at_different_keyframes_confirm_each_other(maps):
    first, second = aligned(maps, 30, 30)[0], aligned(maps, 25, 25)[0]
    assert confirms(maps[0], first, second, CONFIG) and confirms(maps[0], second, first, CONFIG)


def test_an_alignment_does_not_confirm_itself(maps):
    first, second = aligned(maps, 25, 25)[0], aligned(maps, 25, 20)[0]
    assert not confirms(maps[0], first, first, CONFIG)
    assert not confirms(maps[0], first, second, CONFIG)


def test_alignments_with_different_maps_do_not_confirm_each_other(maps):
    first, second = aligned(maps, 30, 30)[0], aligned(maps, 25, 25)[0]
    assert not confirms(maps[0], first, replace(second, old_map_id=7), CONFIG)


@pytest.mark.parametrize(
    ("change", "agrees"),
    [
        ((1.02, 0, 0), True),
        ((1.10, 0, 0), False),
        ((1 / 1.10, 0, 0), False),
        ((1, 1.0, 0), True),
        ((1, 4.0, 0), False),
        ((1, 0, 0.1), True),
        ((1, 0, 0.6), False),
    ],
)
def test_alignments_that_differ_too_much_do_not_agree(maps, change, agrees):
    """Scale, rotation and shift about the observed points, at six metres in depth."""
    old, _ = maps
    first, second = aligned(maps, 30, 30)[0], aligned(maps, 25, 25)[0]
    scale, turn_deg, shift = change
    where = old.arrays.pt_xyz[second.old_points].mean(0)
    about = rigid(where) @ rigid((shift, 0, 0), (0, turn_deg, 0)) @ sim3_matrix(scale, np.eye(3), np.zeros(3))
    changed = replace(second, S_old_new=about @ rigid(-where) @ second.S_old_new)
    assert confirms(old, first, changed, CONFIG) is agrees


# -- fusion --------------------------------------------------------------------------------------------------


@pytest.fixture
def fused(maps):
    """The maps fused at frame 25: the map, row offsets, and values before the fusion."""
    old, new = maps
    before = {
        "T_old": {k: old.T_cam_map(k) for k in range(old.n_keyframes)},
        "points": len(old.points()) + len(new.points()),
        "old_rows": old.n_keyframes,
        "old_points": old.n_points,
    }
    alignment = aligned(maps, 25, 25)[0]
    fused = fuse(old, new, [alignment], LocalMappingConfig(), renewed_until=1000)
    keyframes, points = fused.keyframes, fused.points
    return old, keyframes, points, alignment, before


def test_fusion_keeps_the_frame_of_the_old_map(fused):
    old, keyframes, points, _, before = fused
    check_map(old)
    assert old.map_id == 0
    assert (keyframes, points) == (before["old_rows"], before["old_points"])
    np.testing.assert_array_equal(old.T_cam_map(0), before["T_old"][0])
    for k, T in before["T_old"].items():
        distance, angle = pose_error(old.T_cam_map(k), T)
        assert distance < 0.05 and angle < 0.3


def test_the_new_keyframes_are_near_the_truth(fused, sightings):
    old, keyframes, _, _, _ = fused
    for k, i in enumerate(NEW):
        distance, angle = pose_error(old.T_cam_map(keyframes + k), sightings[i].T_cam_world)
        assert distance < 0.05 and angle < 0.3


def test_the_scale_of_the_new_part_is_that_of_the_old(fused, world, sightings):
    old, keyframes, _, _, _ = fused
    ids, _ = world_ids(old, [sightings[i] for i in (*OLD, *NEW)])
    new_side = np.setdiff1d(points_of(old, keyframes + len(NEW) - 1), points_of(old, 1))
    new_side = new_side[ids[new_side] != NO_POINT]
    s, _, _ = horn_sim3(world.xyz[ids[new_side]], old.arrays.pt_xyz[new_side])
    assert s == pytest.approx(1, abs=0.01)


def test_duplicate_points_are_fused(fused, sightings):
    """A world point in both maps becomes one point, observed from both sides."""
    old, keyframes, _, alignment, before = fused
    assert len(old.points()) < before["points"] - 0.9 * alignment.inliers
    ids, pure = world_ids(old, [sightings[i] for i in (*OLD, *NEW)])
    assert pure[old.points()].mean() > 0.99
    here = np.union1d(points_of(old, at(OLD, 25)), points_of(old, keyframes + at(NEW, 25)))
    _, counts = np.unique(ids[here], return_counts=True)
    assert (counts == 1).mean() > 0.97
    assert old.arrays.covisibility[at(OLD, 25), keyframes + at(NEW, 25)] > 0.9 * alignment.inliers


def test_matched_points_become_one_row(fused):
    old, _, points, alignment, _ = fused
    alive = ~old.arrays.pt_bad[alignment.old_points]
    assert alive.mean() > 0.7, "all but those that only the bypassed keyframes saw"
    theirs = (alignment.new_points + points)[alive]
    assert old.arrays.pt_bad[theirs].all()
    np.testing.assert_array_equal(old.arrays.pt_replaced[theirs], alignment.old_points[alive])


def test_old_keyframes_younger_than_the_seam_are_culled(fused):
    """The breakage may have corrupted them; frames that refer to them still follow the map."""
    old, keyframes, _, _, before = fused
    live = old.keyframes().tolist()
    assert live == [at(OLD, i) for i in OLD if i <= 25] + [keyframes + k for k in range(len(NEW))]
    distance, angle = pose_error(old.T_cam_map(at(OLD, 30)), before["T_old"][at(OLD, 30)])
    assert distance < 0.05 and angle < 0.3


def test_the_spanning_tree_is_one_tree(fused):
    old, keyframes, _, _, _ = fused
    assert [k for k in range(old.n_keyframes) if old.parent(k) < 0] == [0]
    assert old.parent(keyframes) == at(OLD, 25)


def test_seam_and_new_map_are_bundle_adjusted(maps):
    """A slightly wrong alignment would leave errors of several pixels at the seam; drift, far from it."""
    old, new = maps
    new.arrays.kf_T_cam_map[len(NEW) - 1, 0, 3] += 0.1
    alignment, _, _ = aligned(maps, 25, 25)
    where = old.arrays.pt_xyz[alignment.old_points].mean(0)
    off = rigid(where) @ sim3_matrix(1.01, rigid(rotvec_deg=(0, 0.3, 0))[:3, :3], np.zeros(3)) @ rigid(-where)
    alignment = replace(alignment, S_old_new=off @ alignment.S_old_new)
    keyframes = fuse(old, new, [alignment], LocalMappingConfig(window=2)).keyframes
    for k in (at(OLD, 25), *range(keyframes, old.n_keyframes)):
        rows = np.flatnonzero(old.observed_points(k) >= 0) + old.keypoints(k).start
        T = old.T_cam_map(k)
        xyz = old.arrays.pt_xyz[old.arrays.kp_point[rows]] @ T[:3, :3].T + T[:3, 3]
        xy = xyz[:, :2] / xyz[:, 2:] * (VIEW.fx, VIEW.fy) + (VIEW.cx, VIEW.cy)
        sigmas = (xy - old.arrays.kp_xy[rows]) / VIEW.scale[old.arrays.kp_octave[rows], None]
        # Half a pixel is the noise of the keypoints.
        assert rms(sigmas) < 0.6


def test_a_map_can_be_fused_twice(fused, world):
    """A third map, of another scale, is fused with the result of the first two."""
    old, _, _, _, _ = fused
    rng = np.random.default_rng(26)
    frames = range(60, 90, 5)
    third_sightings = [world.see(i, walk(i), rng, noise_px=0.5, bits=8) for i in frames]
    third, _ = world.map_of(third_sightings, rng, noise=0.01, map_id=2)
    third.transform(4.0, MOVED[:3, :3], MOVED[:3, 3])
    seam = int(old.keyframes()[-1])
    assert old.frame_index(seam) == 60
    alignment, _, _ = align(old, third, seam, 0, rng, CONFIG)
    assert alignment is not None
    assert alignment.scale == pytest.approx(0.25, rel=0.01)
    keyframes = fuse(old, third, [alignment], LocalMappingConfig()).keyframes
    check_map(old)
    for k, sighting in enumerate(third_sightings):
        distance, _ = pose_error(old.T_cam_map(keyframes + k), sighting.T_cam_world)
        assert distance < 0.08
    assert sum(old.parent(k) < 0 for k in range(old.n_keyframes)) == 1
