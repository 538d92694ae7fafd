"""What the keyframes on either side say of a similarity between two maps."""

from dataclasses import replace

import numpy as np
import pytest
from slam_scenes import PointWorld, rigid, walk

from slam.loop_closing.map_alignment import AlignmentConfig, align
from slam.loop_closing.place_check import PlaceCheckConfig, doubt
from slam.optimization.sim3 import sim3_matrix
from slam.tracking.reach import ReachConfig

LAX = AlignmentConfig(min_candidates=20, min_inliers=20, min_share=0.3, min_matches=20)
ANYWHERE = PlaceCheckConfig(reach=ReachConfig(factor=1e9))


def rng():
    return np.random.default_rng(0)


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
    alignment, _, _ = align(old, new, 6, 2, rng(), LAX)
    assert alignment is not None
    return alignment


def test_one_place_seen_twice_is_not_doubted():
    old, new = maps()
    assert doubt(old, new, found(old, new), rng(), ANYWHERE) == ""


def test_a_similarity_to_another_place_is_doubted():
    old, new = maps()
    right = found(old, new)
    aside = replace(right, S_old_new=rigid((0.6, 0, 0)) @ right.S_old_new)
    larger = replace(right, S_old_new=right.S_old_new @ sim3_matrix(1.2, np.eye(3), np.zeros(3)))
    for wrong in (aside, larger):
        assert doubt(old, new, wrong, rng(), ANYWHERE) == "expected_points_missing"


def test_surroundings_that_differ_in_part_are_doubted():
    """A poster and little more is the same: enough for an alignment, not for a place."""
    old, new = maps(changed(0.27))
    assert doubt(old, new, found(old, new), rng(), ANYWHERE) in ("contradicted", "expected_points_missing")


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        ({"bar": replace(ANYWHERE.bar, min_cells=1000)}, "too_narrow"),
        ({"min_agreeing": 1.1}, "neighbours_disagree"),
    ],
)
def test_the_reason_names_the_bar(config, reason):
    old, new = maps()
    assert doubt(old, new, found(old, new), rng(), replace(ANYWHERE, **config)) == reason


def test_maps_far_apart_in_space_but_not_in_time_are_out_of_reach():
    """The second map begins where the first was half a minute ago: there was no time to get back."""
    soon, late = maps(later=56 + 3), maps(later=56 + 30 * 30)
    reach = PlaceCheckConfig(reach=ReachConfig(factor=0.3))
    assert doubt(*soon, found(*soon), rng(), reach) == "out_of_reach"
    assert doubt(*late, found(*late), rng(), reach) == ""
