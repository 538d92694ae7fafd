"""A world may have a seed of its own: the same place, gone through in another way."""

import numpy as np
from degradation_worlds import small_scenario

from sim.frame_plan import mujoco_backend, plan_frames


def shot(world_seed, seed):
    scenario = small_scenario("corridor").model_copy(update={"world_seed": world_seed})
    plan, world = plan_frames(scenario, seed, mujoco_backend(), lambda step, done, total: None)
    textures = b"".join(surface.texture.tobytes() + surface.vertices.tobytes() for surface in world.surfaces)
    return textures, plan.motion.T_world_cam(plan.stamps_s)


def test_units_that_share_a_world_seed_share_the_world_and_nothing_else():
    world, path = shot(7, 1)
    same_world, other_path = shot(7, 2)
    assert same_world == world
    assert not np.allclose(other_path, path, atol=1e-3)


def test_the_path_does_not_depend_on_the_world_seed_but_by_the_world():
    world, path = shot(7, 1)
    other_world, same_path = shot(8, 1)  # of the same sizes
    assert other_world != world
    np.testing.assert_array_equal(same_path, path)


def test_without_one_the_world_is_that_of_the_seed():
    assert shot(None, 7)[0] == shot(7, 1)[0]
