"""Worlds with a seed of their own: the same place with another path."""

import numpy as np
from degradation_worlds import small_scenario
from world_views import cheap_textures

from dslab.sim.frame_plan import plan_frames, render_backend


def planned(world_seed, seed):
    scenario = small_scenario("corridor", world_seed=world_seed, seed=seed)
    with cheap_textures():
        plan, world = plan_frames(scenario, render_backend())
    textures = b"".join(surface.texture.tobytes() + surface.vertices.tobytes() for surface in world.surfaces)
    return textures, plan.motion.T_world_cam(plan.stamps_s)


def test_a_common_world_seed_gives_the_same_world_and_other_paths():
    world, path = planned(7, 1)
    same_world, other_path = planned(7, 2)
    assert same_world == world
    assert not np.allclose(other_path, path, atol=1e-3)


def test_the_path_depends_on_the_world_seed_only_through_the_world():
    world, path = planned(7, 1)
    other_world, same_path = planned(8, 1)  # of the same sizes
    assert other_world != world
    np.testing.assert_array_equal(same_path, path)


def test_without_a_world_seed_the_world_is_that_of_the_seed():
    assert planned(None, 7)[0] == planned(7, 1)[0]
