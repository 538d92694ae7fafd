"""Matchers of a frame with the reference frame of initialisation."""

import numpy as np
import pytest
from slam_scenes import CAMERA, VIEW, PointWorld, rigid

from dslab.slam.matching._windowed_kernels import match_for_initialization
from dslab.slam.matching.gms import GmsConfig, match_gms
from dslab.slam.matching.initial import GmsMatcher, WindowedMatcher
from dslab.slam.matching.orientation import keep_common_turn
from dslab.slam.matching.window import FREE_BITS

WORLD = PointWorld(seed=5, points=9000, reach=(-8.0, 8.0))
SIZE_PX = (CAMERA.width_px, CAMERA.height_px)
STEP = np.array([0.12, 0.02, -0.03])


def look(i, turn_deg=0.0, bits=15):
    T_world_cam = rigid(i * STEP, (0.2 * i, turn_deg - 0.1 * i, 0.3 * i))
    return WORLD.see(i, np.linalg.inv(T_world_cam), np.random.default_rng(i), noise_px=0.4, bits=bits)


def windowed(radius_px=100.0, max_octave=2):
    return WindowedMatcher(VIEW, radius_px, max_octave, 0.9)


def gms(radius_px=100.0, **settings):
    return GmsMatcher(CAMERA, VIEW, radius_px, 0.9, GmsConfig(**settings))


def right(pairs, one, two):
    shown = one.ids[pairs[:, 0]]
    return ((shown >= 0) & (shown == two.ids[pairs[:, 1]])).sum()


def test_the_windowed_matcher_tracks_from_frame_to_frame():
    sightings = [look(i) for i in range(6)]
    a = sightings[0].frame.features
    matcher = windowed(25.0)
    matcher.start(a)
    around = a.xy.copy()
    for sighting in sightings[1:]:
        b = sighting.frame.features
        matched, count = match_for_initialization(
            a.xy, a.octave, a.angle_deg, a.descriptors, around, VIEW,
            b.xy, b.octave, b.angle_deg, b.descriptors, b.cell_start, 25.0, 2, 0.9,
        )  # fmt: skip
        found = np.flatnonzero(matched >= 0)
        around[found] = b.xy[matched[found]]
        pairs = matcher.match(b)
        assert len(pairs) == count > 100
        np.testing.assert_array_equal(pairs, np.column_stack([found, matched[found]]))


def windowed_reference(a, b, around, radius_px, max_octave, ratio):
    """Match by match over all of the second frame; ties go to the keypoint that comes first."""
    bits = (
        np.unpackbits(a.descriptors.view(np.uint8), axis=1),
        np.unpackbits(b.descriptors.view(np.uint8), axis=1),
    )
    matched, owner = np.full(len(a), -1), {}
    for j in np.flatnonzero(a.octave <= max_octave):
        near = (np.abs(b.xy - around[j]) <= radius_px).all(axis=1) & (b.octave == a.octave[j])
        rows = np.flatnonzero(near)
        distance = (bits[0][j] != bits[1][rows]).sum(axis=1)
        order = np.argsort(distance, kind="stable")
        if not len(rows) or (len(rows) > 1 and distance[order[0]] > ratio * distance[order[1]]):
            continue
        i, d = rows[order[0]], distance[order[0]]
        if d > FREE_BITS or (i in owner and d >= owner[i][1]):
            continue
        if i in owner:
            matched[owner[i][0]] = -1
        owner[i] = j, d
        matched[j] = i
    turn = np.where(matched >= 0, a.angle_deg.astype(float) - b.angle_deg[matched], 0.0)
    matched = matched.astype(np.int32)
    return matched, keep_common_turn(matched, turn)


@pytest.mark.parametrize(("bits", "radius_px"), [(2, 4.0), (20, 100.0)])
def test_the_windowed_search_agrees_with_numpy(bits, radius_px):
    a, b = look(0, bits=bits).frame.features, look(1, bits=bits).frame.features
    around = a.xy + np.random.default_rng(0).normal(0, 3.0, a.xy.shape)
    around[:3] = (-500.0, 10.0), (10.0, -500.0), (5000.0, 5000.0)
    counts = []
    for max_octave, ratio in ((0, 0.9), (3, 0.9), (3, 0.2)):
        matched, count = match_for_initialization(
            a.xy, a.octave, a.angle_deg, a.descriptors, around, VIEW,
            b.xy, b.octave, b.angle_deg, b.descriptors, b.cell_start, radius_px, max_octave, ratio,
        )  # fmt: skip
        expected, expected_count = windowed_reference(a, b, around, radius_px, max_octave, ratio)
        np.testing.assert_array_equal(matched, expected)
        assert count == expected_count
        counts.append(count)
    assert counts[1] > max(counts[0], 20)
    assert (counts[2] < counts[1]) == (bits == 20)


@pytest.mark.parametrize("make", [windowed, gms])
def test_matches_are_one_to_one_in_order_and_right(make):
    matcher = make()
    one = look(0)
    matcher.start(one.frame.features)
    for i in (1, 2, 3):
        two = look(i)
        pairs = matcher.match(two.frame.features)
        assert len(pairs) > 150
        assert (np.diff(pairs[:, 0]) > 0).all()
        assert len(np.unique(pairs[:, 1])) == len(pairs)
        assert right(pairs, one, two) > 0.95 * len(pairs)


@pytest.mark.parametrize("make", [windowed, gms])
def test_a_new_reference_replaces_the_previous_one(make):
    used, fresh = make(), make()
    used.start(look(0).frame.features)
    used.match(look(4).frame.features)
    for matcher in (used, fresh):
        matcher.start(look(5).frame.features)
    np.testing.assert_array_equal(*(m.match(look(6).frame.features) for m in (used, fresh)))


@pytest.mark.parametrize("make", [windowed, gms])
def test_matching_without_a_reference_is_refused(make):
    with pytest.raises(RuntimeError, match="no reference"):
        make().match(look(0).frame.features)


def test_gms_matches_keypoints_that_have_left_their_windows():
    one, two = look(0), look(1, turn_deg=18.0)
    near, far = windowed(), gms()
    for matcher in (near, far):
        matcher.start(one.frame.features)
    assert right(near.match(two.frame.features), one, two) < 20
    pairs = far.match(two.frame.features)
    assert len(pairs) > 200
    assert right(pairs, one, two) > 0.95 * len(pairs)


def test_gms_adds_matches_to_those_of_the_windows():
    one, two = look(0), look(3)
    settings = {"max_octave": 4}
    both, near = gms(40.0, **settings), windowed(40.0, **settings)
    for matcher in (both, near):
        matcher.start(one.frame.features)
    in_windows = {tuple(p) for p in near.match(two.frame.features).tolist()}
    everywhere = match_gms(one.frame.features, two.frame.features, SIZE_PX, GmsConfig(**settings))
    found = {tuple(p) for p in both.match(two.frame.features).tolist()}
    assert in_windows < found <= in_windows | {tuple(p) for p in everywhere.tolist()}
    assert max(one.frame.features.octave[[row for row, _ in found]]) == 4


def test_the_windows_follow_the_matches_of_gms():
    """After a jump the windows are at the keypoints matched by GMS."""
    one, jumped, after = look(0), look(1, turn_deg=18.0), look(2, turn_deg=18.0)
    matcher = gms()
    matcher.start(one.frame.features)
    seen = matcher.match(jumped.frame.features)
    near = windowed(max_octave=7)
    near.start(one.frame.features)
    near.follow(seen, jumped.frame.features)
    expected = near.match(after.frame.features)
    assert right(expected, one, after) > 200
    found = {tuple(p) for p in matcher.match(after.frame.features).tolist()}
    assert {tuple(p) for p in expected.tolist()} <= found
