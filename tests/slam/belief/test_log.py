"""The views that are asked for a place are logged with what they show there, and nothing of the truth."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import PointWorld, pose_error, rigid, walk

from dslab.slam.belief.config import BeliefConfig
from dslab.slam.belief.log import logged
from dslab.slam.belief.model import Parameters, evidence
from dslab.slam.belief.sight import settled, sight_of
from dslab.slam.loop_closing.map_alignment import Sim3AlignmentConfig, align
from dslab.slam.loop_closing.supposed import Supposed

LAX = Sim3AlignmentConfig(min_candidates=20, min_inliers=20, min_share=0.3, min_matches=20)


@pytest.fixture(scope="module")
def aligned():
    """Two maps of one path, the second at twice the size, and the similarity between them."""
    world, r, built = PointWorld(points=6000), np.random.default_rng(1), []
    for m in range(2):
        seen = [world.see(i, walk(i), r, noise_px=0.5, bits=6) for i in range(20 * m, 60, 5)]
        built.append(world.map_of(seen, r, map_id=m)[0])
        points = built[m].points()
        built[m].arrays.pt_visible[points], built[m].arrays.pt_found[points] = 10, 7
    built[1].transform(2.0, np.eye(3), np.array([1.0, 0.0, 0.0]))
    return *built, align(*built, 6, 2, np.random.default_rng(0), LAX)[0]


def views_of(old, new, alignment):
    with logged() as views:
        supposed = Supposed(old, new, alignment, BeliefConfig())
    return views, supposed.is_believed()


def test_a_view_is_logged_where_it_is_supposed_and_says_that_it_is_there(aligned):
    old, new, right = aligned
    views, believed = views_of(old, new, right)
    assert believed and len(views) >= 4 and {v.kind for v in views} == {"join"}
    assert {v.hypothesis[1:] for v in views} == {(new.frame_index(2), old.frame_index(6))}
    # The first map's last keyframe is the second one's eighth: the camera need not have moved.
    assert all(v.unseen.since_s == 0 and 0 <= v.unseen.away < 0.1 and v.unseen.radius == 0 for v in views)
    for view in views:
        # A walk of 1.2 to 1.8 m, points a few metres away.
        assert 0.2 < view.explored < 3
        own, around = view.relation.new, view.relation.old
        # As the first keyframe around sees it, in lengths of that map.
        size = 2.0 if view.hypothesis[0] == 1 else 1.0
        T = np.linalg.inv(own.T_map_cam[0]) @ around.T_map_cam[0]
        T[:3, 3] /= size
        true = walk(int(own.frames[0])) @ np.linalg.inv(walk(int(around.frames[0])))
        distance, angle_deg = pose_error(T, true)
        assert distance < 0.03 and angle_deg < 0.5
        assert evidence(view.sight, Parameters()).here > 20
        assert np.median(view.sight.angle) < 0.1 and np.abs(view.sight.zoom).max() < 0.5


def test_a_view_that_is_elsewhere_speaks_against_it(aligned):
    old, new, right = aligned
    aside = replace(right, S_old_new=rigid((0.6, 0, 0)) @ right.S_old_new)
    views, believed = views_of(old, new, aside)
    assert views and not believed
    assert max(evidence(v.sight, Parameters()).here for v in views) < -5


def test_a_view_that_was_carried_off_settles_where_it_is_and_one_that_is_elsewhere_does_not(aligned):
    old, _, _ = aligned
    T, features, points = old.T_cam_map(6), old.features(6), np.unique(old.observed_points(6))
    points = points[points >= 0].astype(np.int32)
    carried = rigid((0.12, -0.05, 0.1), (0.5, 2.5, 0.0)) @ T
    says = lambda T: evidence(sight_of(old, points, T, features, 3.0), Parameters()).here  # noqa: E731
    back = settled(old, points, carried, features, 3.0, 3.0)
    assert pose_error(back @ np.linalg.inv(T), np.eye(4))[0] < 0.02 and says(back) > 2 * says(carried)
    away = rigid((1.5, 0.0, 0.0)) @ T
    assert says(settled(old, points, away, features, 3.0, 3.0)) < 0


def test_nothing_is_logged_unless_it_is_asked_for(aligned):
    views, _ = views_of(*aligned)
    n = len(views)
    Supposed(*aligned, BeliefConfig())
    assert len(views) == n
