"""What is believed of a similarity between two maps, by the views on either side."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import PointWorld, rigid, walk

from dslab.slam.belief.config import BeliefConfig
from dslab.slam.belief.log import logged
from dslab.slam.loop_closing.map_alignment import Sim3AlignmentConfig, align
from dslab.slam.loop_closing.supposed import Supposed
from dslab.slam.optimization.sim3 import sim3_matrix

LAX = Sim3AlignmentConfig(min_candidates=20, min_inliers=20, min_share=0.3, min_matches=20)
CONFIG = BeliefConfig()


def maps(world_2=None, later=0):
    """Two maps of one path, the second at twice the size, seen later and in a world that may differ."""
    world, r = PointWorld(points=6000), np.random.default_rng(1)
    built = []
    for m, (w, start) in enumerate([(world, 0), (world_2 or world, later)]):
        seen = [w.see(start + i, walk(i), r, noise_px=0.5, bits=6) for i in range(20 * m, 60, 5)]
        made, _ = w.map_of(seen, r, map_id=m)
        points = made.points()
        made.arrays.pt_visible[points], made.arrays.pt_found[points] = 10, 7
        built.append(made)
    built[1].transform(2.0, np.eye(3), np.array([1.0, 0.0, 0.0]))
    return built


def changed(share_of_path):
    """The world, with other things from a part of the path on."""
    world = PointWorld(points=6000)
    other = world.xyz[:, 0] > np.quantile(world.xyz[:, 0], share_of_path)
    draws = np.random.default_rng(3).integers(0, 2**64, (int(other.sum()), 4), dtype=np.uint64)
    world.descriptor[other] = draws
    return world


def found(old, new):
    alignment, _, _ = align(old, new, 6, 2, np.random.default_rng(0), LAX)
    assert alignment is not None
    return alignment


def supposed(old, new, S=None, alignment=None, **config):
    alignment = alignment or found(old, new)
    if S is not None:
        alignment = replace(alignment, S_old_new=S @ alignment.S_old_new)
    return Supposed(old, new, alignment, replace(CONFIG, **config))


def test_one_place_seen_twice_is_believed():
    old, new = maps()
    assert supposed(old, new).is_believed()
    assert not supposed(old, new, views=1).is_believed(), "the keyframe that supposes it is no evidence"


def test_a_similarity_to_another_place_is_disbelieved():
    old, new = maps()
    assert supposed(old, new, rigid((0.6, 0, 0))).belief.log_odds < 0
    larger = replace(
        found(old, new), S_old_new=found(old, new).S_old_new @ sim3_matrix(1.2, np.eye(3), np.zeros(3))
    )
    assert not supposed(old, new, alignment=larger).is_believed()


def test_surroundings_that_differ_in_part_are_disbelieved():
    """A poster and little more is the same: enough for an alignment, not for a place."""
    assert not supposed(*maps(changed(0.27))).is_believed()


def test_views_that_follow_speak_too_and_each_once():
    old, new = maps(later=900)
    one = supposed(old, new, views=1)
    odds = [one.belief.log_odds]
    for keyframe in range(new.n_keyframes):
        one.look(new, keyframe)
        odds.append(one.belief.log_odds)
    assert odds[1] > odds[0] and odds[-1] > odds[1]
    for keyframe in range(new.n_keyframes):
        one.look(new, keyframe)
    assert one.belief.log_odds == odds[-1]


def test_the_second_map_cannot_begin_where_the_camera_had_no_time_to_come_to():
    """It begins a moment after the first has ended, which had gone on to elsewhere."""
    there, away = (supposed(*moved(maps(later=56 + 3), metres)).belief.log_odds for metres in (0.0, 40.0))
    assert there - away == pytest.approx(np.log(100), abs=0.5), "a cut, or hands that carry"


def moved(built, metres):
    """Two maps, the first of which went on, out of what the second sees."""
    old, new = built
    last = old.n_keyframes - 1
    old.arrays.kf_T_cam_map[last, 0, 3] += metres
    return old, new


def test_of_two_places_of_one_map_one_is_believed_and_a_place_is_no_rival_of_itself():
    old, new = maps()
    one, again, away = (supposed(old, new), supposed(old, new, rigid((0.05, 0, 0))), supposed(old, new))
    away.alignments[0] = replace(
        away.newest, S_old_new=rigid((30.0, 0, 0)) @ away.newest.S_old_new
    )  # looks as well
    assert one.is_believed([one, again]) and not one.is_believed([one, again, away])


@pytest.mark.parametrize(("metres", "excluded"), [(0.0, False), (500.0, True)])
def test_places_of_two_maps_are_rivals_if_the_camera_cannot_have_come_from_one_to_the_other(metres, excluded):
    """Of two saved maps, the later begins where the earlier one ended, or far from there."""
    old, new = maps()
    one, other = supposed(old, new), old.copy()
    other.map_id = 7
    there = supposed(other, new, alignment=replace(found(old, new), old_map_id=7))
    other.transform(1.0, np.eye(3), np.array([metres, 0.0, 0.0]))
    assert one.is_believed([there]) is not excluded


def test_what_a_correction_tears_is_logged_as_no_view():
    old, new = maps()
    with logged() as rows:
        place = supposed(old, new)
        views = len(rows)
        place.tear(new, 0.3)
    asked = rows[-1]
    assert len(rows) == views + 1 and asked.torn == 0.3 and not asked.proposes and not len(asked.sight.point)
    assert asked.hypothesis == rows[0].hypothesis and asked.log_odds == place.belief.log_odds
