"""The second motion of a start before a wall: later views tell which of the two is right."""

import numpy as np
import pytest
from slam_scenes import CAMERA, VIEW, PointWorld, rigid, world_ids
from two_view_scenes import direction_error_deg

from dslab.slam.initialization.initializer import InitializationConfig, Initializer
from dslab.slam.initialization.second_motion import SecondMotionConfig
from dslab.slam.initialization.two_view import TwoViewConfig
from dslab.slam.mapping.local_mapping import LocalMappingConfig

WALL = PointWorld(seed=3, points=6000, reach=(-6.0, 6.0))
WALL.xyz[:, 2] = 6.0 + 0.4 * WALL.xyz[:, 0] - 0.3 * WALL.xyz[:, 1]
STEP = np.array([0.05, 0.02, 0.1])
HASTY = TwoViewConfig(min_lead_sigmas=0.0)  # takes the motion that fits best, however little it leads


def look(i, rng):
    """Every third frame of a camera that turns and moves towards the wall."""
    T_world_cam = rigid(i * STEP, (0.3 * i, -0.4 * i, 0.3 * i))
    return WALL.see(3 * i, np.linalg.inv(T_world_cam), rng, noise_px=0.3, bits=10)


def start(seed, **settings):
    """A map begun from the wall, its two sightings, the number of the next, the stream of the noise."""
    rng = np.random.default_rng(seed)
    seeker = Initializer(CAMERA, VIEW, InitializationConfig(two_view=HASTY, **settings))
    sightings = []
    for i in range(10):
        sightings.append(look(i, rng))
        initial, *_ = seeker.offer(sightings[-1].frame, 0, rng, LocalMappingConfig())
        if initial is not None:
            return initial, (sightings[0], sightings[-1]), i + 1, rng
    raise AssertionError("no map")


def is_right(initial, one, two):
    T = initial.second.T_cam_map @ np.linalg.inv(initial.first.T_cam_map)
    truth = two.T_cam_world @ np.linalg.inv(one.T_cam_world)
    return direction_error_deg(T[:3, 3], truth[:3, 3]) < 20.0


def judge(initial, sightings, first, rng, views=15):
    """Show the frames that follow, with the map's points, to the judge of its two motions."""
    ids, _ = world_ids(initial.map, sightings)
    point_of = {int(i): p for p, i in enumerate(ids) if i >= 0}
    for i in range(first, first + views):
        seen = look(i, rng)
        seen.frame.point[:] = [point_of.get(int(i), -1) for i in seen.ids]
        initial.second_motion.note(seen.frame)
    return initial.second_motion


@pytest.mark.parametrize(("seed", "right"), [(0, False), (2, False), (3, False), (1, True), (6, True)])
def test_the_frames_that_follow_tell_which_motion_was_right(seed, right):
    """Where the noise lets the wrong motion fit the first two views better, and where it does not."""
    initial, sightings, following, rng = start(seed)
    assert is_right(initial, *sightings) == right
    judged = judge(initial, sightings, following, rng)
    assert judged.verdict == ("first" if right else "second")
    assert abs(judged.lead_sigmas) > 3.5


def test_a_right_start_leads_all_along():
    initial, sightings, following, rng = start(1)
    for i in range(following, following + 10):
        judged = judge(initial, sightings, i, rng, views=1)
        assert judged.verdict != "second" and judged.lead_sigmas >= 0.0


def test_it_is_judged_only_by_views_apart_in_time():
    initial, sightings, following, rng = start(0, second_motion=SecondMotionConfig(every_s=0.3))
    judge(initial, sightings, following, rng, views=2)
    assert initial.second_motion.lead_sigmas == 0.0


def test_it_is_forgotten_where_too_few_points_of_the_start_are_seen_or_after_enough_views():
    initial, sightings, following, rng = start(0, second_motion=SecondMotionConfig(max_views=2))
    assert judge(initial, sightings, following, rng, views=2).verdict == "first"
    initial, sightings, following, rng = start(0)
    blind = look(following, rng)
    initial.second_motion.note(blind.frame)
    assert initial.second_motion.verdict == "first"


@pytest.mark.parametrize("settings", [{"max_views": 0}, {"sure_lead_sigmas": 0.0}])
def test_a_sure_start_has_none(settings):
    initial, *_ = start(0, second_motion=SecondMotionConfig(**settings))
    assert initial.second_motion is None
