"""Retrieval: scores and candidates against NumPy, updates of the database."""

import numpy as np
import pytest
from slam_scenes import VIEW, PointWorld, walk

from dslab.slam.places.recognition import KeyframeDatabase
from dslab.slam.places.training import train_vocabulary

KEYFRAMES, PLACES = 24, 3


@pytest.fixture(scope="module")
def places():
    """Three parts of a corridor, each seen by eight keyframes of one map, and sightings beside them."""
    world, rng = PointWorld(points=6000, reach=(-3.0, 36.0)), np.random.default_rng(1)
    at = [place * 250 + 8 * n for place in range(PLACES) for n in range(KEYFRAMES // PLACES)]
    seen = [world.see(i, walk(i), rng, noise_px=0.5, bits=6) for i in at]
    built, point_of = world.map_of(seen, rng)
    beside = [world.see(i + 4, walk(i + 4), rng, noise_px=0.5, bits=6) for i in at]
    vocabulary = train_vocabulary([s.frame.features.descriptors for s in seen], 8, 3, 0)
    return built, point_of, seen, beside, vocabulary


@pytest.fixture
def database(places):
    built, _, _, _, vocabulary = places
    database = KeyframeDatabase(built.copy(), vocabulary)
    database.update()
    return database


def bow_of(places, sighting):
    return places[4].transform(sighting.frame.features.descriptors)


def place_of(keyframe):
    return keyframe // (KEYFRAMES // PLACES)


# -- queries -------------------------------------------------------------------------------------------------


def test_scores_agree_with_pairs_of_bags(places, database):
    for sighting in places[3][::5]:
        bow = bow_of(places, sighting)
        common, score = database.query(bow)
        bags = [database.bow(k) for k in range(KEYFRAMES)]
        assert score == pytest.approx([bow.score(bag) for bag in bags])
        assert common.tolist() == [len(np.intersect1d(bow.words, bag.words)) for bag in bags]


def test_the_database_follows_its_map(places, database):
    m, bow = database.map, bow_of(places, places[3][5])
    before = database.query(bow)
    for k in (5, 6, 12):
        m.cull_keyframe(k)
    database.update()
    assert len(database) == KEYFRAMES - 3
    common, score = database.query(bow)
    gone = np.isin(np.arange(KEYFRAMES), (5, 6, 12))
    assert not common[gone].any() and not score[gone].any()
    assert [len(database.bow(k).words) > 0 for k in range(KEYFRAMES)] == (~gone).tolist()
    assert (common[~gone] == before[0][~gone]).all() and (score[~gone] == before[1][~gone]).all()
    frame = places[3][5].again()
    frame.T_cam_map = places[3][5].T_cam_world
    added = m.add_keyframe(frame, 4)
    database.update()
    assert added == KEYFRAMES and len(database) == KEYFRAMES - 2
    common, score = database.query(bow)
    assert score[added] == pytest.approx(1) and common[added] == len(bow.words)
    assert (score[:KEYFRAMES][~gone] == before[1][~gone]).all()


def test_a_keyframe_culled_before_it_was_added_is_never_found(places):
    built, *_, vocabulary = places
    database = KeyframeDatabase(built.copy(), vocabulary)
    database.map.cull_keyframe(7)
    database.update()
    assert len(database) == KEYFRAMES - 1
    common, score = database.query(bow_of(places, places[3][7]))
    assert common[7] == 0 and score[7] == 0 and common[6] > 0


def test_removed_keyframes_leave_room(places, database):
    """A map that culls as many keyframes as it adds does not grow its database."""
    m, size = database.map, 0
    for step in range(200):
        frame = places[3][step % KEYFRAMES].again()
        frame.T_cam_map = np.eye(4)
        m.cull_keyframe(m.add_keyframe(frame, 0) if step % 2 else m.n_keyframes - 1)
        database.update()
        if step == 20:
            size = len(database._file.keyframe)
    assert m.n_keyframes == KEYFRAMES + 100
    assert len(database._file.keyframe) == size
    assert len(database) == (~m.arrays.kf_bad[: m.n_keyframes]).sum()


def test_an_absorbed_map_is_found_in_the_absorbing_one(places):
    built, *_, vocabulary = places
    m = built.copy()
    database = KeyframeDatabase(m, vocabulary)
    database.update()
    other = PointWorld(seed=9, points=2000)
    rng = np.random.default_rng(2)
    views = [other.see(2000 + i, walk(8 * i), rng) for i in range(4)]
    m.absorb(other.map_of(views, rng)[0])
    bow = vocabulary.transform(views[2].frame.features.descriptors)
    assert KEYFRAMES + 2 in database.relocalization_candidates(bow)
    assert database.query(bow)[1][KEYFRAMES + 2] == pytest.approx(1)


# -- candidates ----------------------------------------------------------------------------------------------


def slow_groups(m, score, possible):
    eligible = np.flatnonzero(possible).tolist()
    groups = {}
    for k in eligible:
        members = sorted({k, *m.neighbours(k, m.n_keyframes).tolist()} & set(eligible))
        groups[k] = sum(score[j] for j in members), max(members, key=lambda j: (score[j], -j))
    most = max((total for total, _ in groups.values()), default=0)
    order = sorted((k for k in groups if groups[k][0] > 0.75 * most), key=lambda k: (-groups[k][0], k))
    return list(dict.fromkeys(groups[k][1] for k in order))


def test_relocalization_candidates_agree_with_numpy(places, database):
    for sighting in places[3]:
        bow = bow_of(places, sighting)
        common, score = database.query(bow)
        slow = slow_groups(database.map, score, common > 0)
        assert database.relocalization_candidates(bow) == slow


def test_a_place_is_recognised_from_beside_the_path(places, database):
    for k, sighting in enumerate(places[3]):
        candidates = database.relocalization_candidates(bow_of(places, sighting))
        assert place_of(candidates[0]) == place_of(k) and abs(candidates[0] - k) <= 4


def test_an_empty_image_and_an_empty_map_have_no_candidates(places, database):
    nothing = places[4].transform(np.empty((0, 4), np.uint64))
    assert database.relocalization_candidates(nothing) == []
    empty = KeyframeDatabase(type(places[0])(0, VIEW), places[4])
    assert empty.relocalization_candidates(bow_of(places, places[3][0])) == []


def test_loop_candidates_show_the_same_place_and_are_no_neighbours(places):
    """The camera returns to the first place with new points: no keyframe is covisible yet."""
    built, *_, vocabulary = places
    world, rng = PointWorld(points=6000, reach=(-3.0, 36.0)), np.random.default_rng(5)
    back = [world.see(3000 + i, walk(8 * i + 3), rng, noise_px=0.5, bits=6) for i in range(4)]
    m = built.copy()
    m.absorb(world.map_of(back, rng)[0])
    database = KeyframeDatabase(m, vocabulary)
    for n in range(4):
        candidates = database.loop_candidates(KEYFRAMES + n)
        assert candidates and place_of(candidates[0]) == 0
        assert abs(candidates[0] - n) <= 3
        assert not set(candidates) & set(range(KEYFRAMES, KEYFRAMES + 4))


def test_a_new_place_has_no_loop_candidates(places, database):
    found = [k for k in range(KEYFRAMES) for c in database.loop_candidates(k) if place_of(c) != place_of(k)]
    assert not found


def test_a_keyframe_without_neighbours_has_no_loop_candidates(places, database):
    frame = places[3][0].again()
    frame.T_cam_map = np.eye(4)
    assert database.loop_candidates(database.map.add_keyframe(frame, 0)) == []


def test_foreseen_bags_of_words_are_not_computed_again(places, monkeypatch):
    built, vocabulary = places[0], places[4]
    first, second = KeyframeDatabase(built, vocabulary), KeyframeDatabase(built, vocabulary)
    first.update()
    second.foresee({k: first.bow(k) for k in range(KEYFRAMES)})
    monkeypatch.setattr(vocabulary, "transform", None)
    second.update()
    assert [second.bow(k) for k in range(KEYFRAMES)] == [first.bow(k) for k in range(KEYFRAMES)]
