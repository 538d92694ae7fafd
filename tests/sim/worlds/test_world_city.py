"""The city: streets that keep apart, a lane that stays free, houses without gaps, closed and open routes."""

import numpy as np
import pytest
from world_views import every, length

from dslab.scenarios.errors import InputError
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.worlds import CityWorld
from dslab.sim.worlds import layout
from dslab.sim.worlds.geometry.car_shapes import FLANK_M, SHAPES, WHEEL_M
from dslab.sim.worlds.geometry.outdoor import Daylight
from dslab.sim.worlds.town.houses import houses_along, houses_at_end
from dslab.sim.worlds.town.roadside import roadside
from dslab.sim.worlds.town.streets import CARRIAGEWAY_M, FRONT_M, LANE_M, Plan, plan_streets

SPECS = {
    "straight": CityWorld(length_m=150, turns=0),
    "zigzag": CityWorld(length_m=700, turns=4),
    "loop": CityWorld(length_m=600, loop=True),
    "longest": CityWorld(length_m=2000, turns=20),
}


def all_houses(plan: Plan) -> list:
    rng = rng_for(0, "houses")
    return [h for s in plan.streets for h in houses_along(plan, s, rng) + houses_at_end(s, rng)]


@pytest.mark.parametrize("spec", SPECS.values(), ids=SPECS)
class TestEveryPlan:
    def test_the_route_has_the_declared_length_and_closes_in_a_loop(self, spec):
        route = layout(spec, 3)
        walked = length(route)
        assert walked == pytest.approx(spec.length_m, rel=0.06)
        assert route.closed == spec.loop
        assert np.allclose(route.centre_m[0], route.centre_m[-1]) == spec.loop

    def test_the_route_keeps_to_the_right_hand_lane(self, spec):
        plan, route = plan_streets(spec, 3), layout(spec, 3)
        points = every(route, 0.5)[:, :2]
        ways = np.gradient(points, axis=0)
        shares = []
        for street in plan.streets[: len(plan.corners)]:
            local = points - street.start
            straight = ways @ street.way > 0.999 * np.linalg.norm(ways, axis=1)
            on = straight & (np.abs(local @ street.left) < FRONT_M)
            shares.extend((local @ street.left)[on])
        assert np.median(shares) == pytest.approx(-LANE_M, abs=0.01)

    def test_streets_that_do_not_meet_keep_apart(self, spec):
        streets = plan_streets(spec, 3).streets
        for k, one in enumerate(streets):
            for other in streets[k + 1 :]:
                if abs(float(one.way @ other.way)) > 0.5 and not np.allclose(one.start, other.start):
                    (low, high), (other_low, other_high) = one.box(4.0), other.box(4.0)
                    assert not ((low < other_high) & (high > other_low)).all()

    def test_no_house_stands_on_a_street(self, spec):
        plan = plan_streets(spec, 3)
        for house in all_houses(plan):
            low, high = house.footprint().min(axis=0) + 0.01, house.footprint().max(axis=0) - 0.01
            for street in plan.streets:
                street_low = np.minimum(street.start, street.end) - FRONT_M * np.abs(street.left)
                street_high = np.maximum(street.start, street.end) + FRONT_M * np.abs(street.left)
                assert not ((low < street_high) & (high > street_low)).all()

    def test_houses_line_the_streets_without_a_gap(self, spec):
        plan = plan_streets(spec, 3)
        for street in plan.streets:
            for side in (1.0, -1.0):
                free = plan.free(street, side * (FRONT_M + 1.0), FRONT_M)
                houses = houses_along(plan, street, rng_for(0, "houses"))
                fronts = [
                    np.linalg.norm(h.right - h.left)
                    for h in houses
                    if float((h.left - street.start) @ street.left) * side > 0
                ]
                assert sum(fronts) == pytest.approx(sum(b - a for a, b in free))

    def test_everything_beside_the_road_leaves_the_route_its_clearance(self, spec):
        plan, route = plan_streets(spec, 3), layout(spec, 3)
        points = every(route, 0.5)[:, :2]
        light = Daylight(points.min(axis=0) - 60, points.max(axis=0) + 60, rng_for(0, "sun"))
        for street in plan.streets[:6]:
            for piece in roadside(plan, street, light, rng_for(0, "things")):
                low_enough = piece.vertices[piece.vertices[:, 2] < 2.2, :2]
                near = points[np.abs(points - low_enough.mean(axis=0)).max(axis=1) < 12]
                if len(near) and len(low_enough):
                    gaps = np.linalg.norm(near[:, None] - low_enough[None], axis=2)
                    assert gaps.min() > route.clearance_m - 0.05, piece.label


def test_seeds_give_different_towns_and_repeat_them():
    one, same, other = (plan_streets(SPECS["zigzag"], seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.corners, same.corners)
    assert len(one.streets) == len(same.streets)
    assert not np.array_equal(one.corners, other.corners)
    assert len(one.streets) > 5 + 4  # side streets besides the five of the route


def test_too_many_turns_are_bad_input():
    with pytest.raises(InputError, match="turns"):
        layout(CityWorld(length_m=300, turns=9), 0)


def test_a_loop_without_room_for_a_block_is_bad_input():
    with pytest.raises(ValueError, match="280"):
        CityWorld(length_m=200, loop=True)


def test_the_sun_is_blocked_by_what_stands_in_its_way():
    light = Daylight(np.array([-40.0, -40]), np.array([40.0, 40]), rng_for(0, "sun"))
    up = np.array([0.0, 0, 1])
    behind = -8 * light.towards[:2] / np.linalg.norm(light.towards[:2])
    spots = np.array([[*behind, 0.0], [*-behind, 0.0]])
    before = light.gain(spots, up)
    light.shade_polygon(np.array([[-2.0, -2], [2, -2], [2, 2], [-2, 2]]), 14.0)
    after = light.gain(spots, up)
    assert before[0] == before[1] == after[1]
    assert after[0] < 0.8 * after[1]
    assert light.gain(spots, -up).max() < after[1]


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_cars_are_closed_shapes_of_a_cars_size_seen_from_outside(shape):
    vertices = np.concatenate(shape.mesh.vertices)
    triangles = np.concatenate(shape.mesh.triangles)
    size = np.ptp(vertices, axis=0)
    assert 3.5 < size[0] < 5.2 and 1.7 < size[1] < 1.85 and 1.3 < size[2] < 2.1
    assert vertices[:, 2].min() == pytest.approx(0, abs=0.02)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    outward = (((a + b + c) / 3 - [shape.length_m / 2, 0, 0.6]) * normal).sum(axis=1)
    # The screens and the boot of a car are hollow; its flanks and roof are not.
    sides = np.abs(normal[:, 1]) > 0.7 * np.linalg.norm(normal, axis=1)
    body = (a + b + c)[:, 2] / 3 > 2 * WHEEL_M
    large = np.linalg.norm(normal, axis=1) > 1e-6
    assert (sides & body).sum() > 20 and (outward[sides & body & large] > 0).all()
    assert (normal[body & ~sides & large, 2] > -0.1).all()
    sheet = np.concatenate(shape.mesh.sheet_m)
    assert sheet.min() > -1e-9 and (sheet <= np.array(shape.sheet_m) + 1e-9).all()
    assert CARRIAGEWAY_M > 2 * LANE_M and size[2] < FLANK_M
