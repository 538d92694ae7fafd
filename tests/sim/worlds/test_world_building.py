"""The building: floors that differ, connected corridors, stairs, free space along the route."""

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree
from world_views import cheap_textures, check_flow, every, flow_errors

from dslab.scenarios.motions import Trajectory
from dslab.scenarios.seeds import rng_for
from dslab.scenarios.worlds import BuildingWorld
from dslab.sim.motion import plan_motion
from dslab.sim.rendering.mujoco_renderer import MOST_SURFACES, MujocoRenderer
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.worlds import build_world, layout
from dslab.sim.worlds.base import Surface, WorldModel
from dslab.sim.worlds.geometry.atlas import gathered
from dslab.sim.worlds.geometry.panels import wall
from dslab.sim.worlds.indoor.building_light import Lamplight
from dslab.sim.worlds.indoor.building_plan import Plan, walked_floors
from dslab.sim.worlds.indoor.storey import Space, plan_storey

CAMERA = Intrinsics(640, 480, 277.307, 291.357, 312.23, 239.77, 25.0)
SMALL_CAMERA = Intrinsics(320, 240, 138.0, 145.0, 159.5, 119.5, 25.0)
DOWN = Intrinsics(64, 64, 400.0, 400.0, 31.5, 31.5, 25.0)
SPEC = BuildingWorld(floors=2, length_m=18)
SHAPES = {
    "small": SPEC,
    "loop": BuildingWorld(loop=True),
    "tall": BuildingWorld(floors=6, length_m=18, width_m=1.8, storey_m=2.8),
    "wide": BuildingWorld(floors=2, length_m=50, width_m=4.0, storey_m=4.5),
}


def sampled(surface: Surface) -> np.ndarray:
    """(K, 3) points on the triangles of a surface, at most 0.1 m apart."""
    found = []
    for a, b, c in surface.vertices[surface.triangles]:
        count = int(np.ceil(max(np.linalg.norm(b - a), np.linalg.norm(c - a)) / 0.1)) + 1
        u, v = np.meshgrid(np.linspace(0, 1, count), np.linspace(0, 1, count))
        inside = u + v <= 1
        found.append(a + u[inside, None] * (b - a) + v[inside, None] * (c - a))
    return np.concatenate(found)


def looking(eye: np.ndarray, yaw: float, pitch: float = 0.0) -> np.ndarray:
    """(4, 4) pose of a camera without roll."""
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    T = np.eye(4)
    T[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    T[:3, 3] = eye
    return T


@pytest.fixture(
    params=[pytest.param(name, marks=() if name == "small" else pytest.mark.slow) for name in SHAPES],
    scope="module",
)
def shape(request):
    """A building without its textures, and its route."""
    spec = SHAPES[request.param]
    with cheap_textures():
        return spec, build_world(spec, 2), layout(spec, 2)


class TestEveryShape:
    def test_the_route_has_the_ground_under_it_and_room_over_it(self, shape):
        spec, world, route = shape
        renderer = MujocoRenderer(world, DOWN)
        riser_m = Plan.of(spec).stairs[0].riser_m
        for x, y, z in every(route, 0.71):
            eye = np.array([x, y, z + 1.5])
            below, above = (renderer.render(looking(eye, 0.0, p))[1][32, 32] for p in (-1.57079, 1.57079))
            # Steps are smoothed to a slope through their middles.
            assert below == pytest.approx(1.5, abs=riser_m / 2 + 0.01)
            assert above > 0.6
        renderer.close()

    def test_no_gap_opens_and_nothing_comes_near_anywhere_along_the_route(self, shape):
        _, world, route = shape
        renderer = MujocoRenderer(world, SMALL_CAMERA)
        for k, (x, y, z) in enumerate(every(route, 1.7)):
            for side in (0, 1):
                # The directions of view are spread over the sphere.
                yaw, pitch = 0.7 * k + side * np.pi, 0.5 * np.sin(1.3 * k)
                depth = renderer.render(looking(np.array([x, y, z + 1.5]), yaw, pitch))[1]
                # The rasteriser rounds corners to parts of a pixel: far off, one slips between walls.
                assert (depth == 0).sum() <= 1
                assert depth[depth > 0].min() > 0.3
        renderer.close()

    def test_the_route_keeps_its_clearance_at_the_height_of_a_body(self, shape):
        _, world, route = shape
        samples = np.concatenate([sampled(surface) for surface in world.surfaces])
        near = cKDTree(samples[:, :2])
        points = every(route, 0.2)
        for point, found in zip(points, near.query_ball_point(points[:, :2], 0.49), strict=True):
            above = samples[found, 2] - point[2]
            # The next steps reach up to 0.3 m; things above the eye are no obstacle.
            assert not ((above > 0.4) & (above < 1.9)).any()

    def test_the_route_leads_where_the_specification_says(self, shape):
        spec, _, route = shape
        assert route.closed == spec.loop
        points = every(route, 0.1)
        top = (spec.floors - 1) * spec.storey_m
        assert points[0, 2] == 0 and points[:, 2].max() == pytest.approx(top)
        for level in walked_floors(spec):
            level_share = np.mean(np.abs(points[:, 2] - level * spec.storey_m) < 1e-6)
            assert level_share * len(points) * 0.1 > 0.5 * spec.length_m
        climbs = np.diff(points[:, 2])
        if spec.loop:
            np.testing.assert_allclose(route.centre_m[0], route.centre_m[-1])
            assert route.height_m[0] == route.height_m[-1]
            assert climbs.min() < -0.03
        else:
            assert climbs.min() >= -1e-9
        assert np.abs(climbs).max() / 0.1 < 0.7

    def test_a_camera_in_the_hand_never_leaves_free_space(self, shape):
        spec, world, route = shape
        renderer = MujocoRenderer(world, SMALL_CAMERA)
        motion = plan_motion(route, Trajectory(kind="handheld"), 90, 4)
        heights = []
        for T in motion.T_world_cam(np.arange(0, 90, 0.9)):
            depth = renderer.render(T)[1]
            assert depth[depth > 0].min() > 0.15
            heights.append(T[2, 3])
        renderer.close()
        assert np.ptp(heights) > 0.9 * spec.storey_m


@pytest.fixture(scope="module")
def built():
    world = build_world(SPEC, 4)
    renderer = MujocoRenderer(world, CAMERA)
    yield world, renderer, 4
    renderer.close()


@pytest.mark.slow
class TestBuilt:
    def test_reprojection_by_depth_and_pose_agrees_with_optical_flow(self, built):
        _, renderer, seed = built
        motion = plan_motion(layout(SPEC, seed), Trajectory(kind="handheld"), 40, seed)
        errors = []
        for stamp_s in np.linspace(1, 38, 12):
            first, second = motion.T_world_cam(np.array([stamp_s, stamp_s + 0.04]))
            errors.append(flow_errors(renderer, first, second, CAMERA))
        check_flow(errors, at_least=2500)

    def test_every_frame_has_spread_features_also_on_the_stairs(self, built):
        _, renderer, seed = built
        motion = plan_motion(layout(SPEC, seed), Trajectory(kind="handheld"), 40, seed)
        for T in motion.T_world_cam(np.linspace(0, 40, 16)):
            keypoints = cv2.ORB_create(1000).detect(renderer.render(T)[0])
            assert len(keypoints) > 700
            assert len({(int(k.pt[0] // 64), int(k.pt[1] // 60)) for k in keypoints}) > 34

    def test_it_is_small_enough_for_one_pass_of_the_renderer(self, built):
        world, _, _ = built
        assert len(world.surfaces) < MOST_SURFACES / 3
        assert sum(s.texture.size for s in world.surfaces) < 40e6

    def test_walls_beside_the_route_show_detail(self, built):
        world, _, seed = built
        points = every(layout(SPEC, seed), 0.2)
        seen = 0
        for surface in world.surfaces:
            wide = np.linalg.norm(surface.vertices[1] - surface.vertices[0])
            middle = surface.vertices.mean(axis=0)
            if len(surface.vertices) == 4 and "wall" in surface.label and np.ptp(surface.vertices[:, 2]) > 2:
                near = np.linalg.norm(points - middle * [1, 1, 0] - points * [0, 0, 1], axis=1).min()
                if near < 1.15 and wide > 1:
                    seen += 1
                    assert surface.texture.shape[1] / wide > 140
        assert seen > 8


def storeys(seed: int, count: int = 3) -> list:
    plan = Plan.of(BuildingWorld(floors=count))
    return [
        plan_storey(plan, True, rng_for(seed, "world", "building", "storey", level)) for level in range(count)
    ]


def touching(a: Space, b: Space) -> bool:
    low, high = np.maximum(a.low, b.low), np.minimum(a.high, b.high)
    return bool((high - low > -1e-6).all() and (high - low).max() > 1.0)


class TestStoreys:
    def test_the_corridors_are_one_network_with_loops_and_side_corridors(self):
        for storey in storeys(0) + storeys(1):
            corridors = storey.corridors
            joints = [
                (a, b)
                for a in range(len(corridors))
                for b in range(a)
                if touching(corridors[a], corridors[b])
            ]
            reached = {0}
            for _ in corridors:
                reached |= {k for joint in joints if reached & set(joint) for k in joint}
            assert reached == set(range(len(corridors)))
            assert len(joints) - len(corridors) + 1 >= 2  # loops: about the core, and by its passage
            assert sum("side" in c.name or "end" in c.name for c in corridors) >= 2

    def test_a_corridor_is_open_to_its_neighbours_and_walled_elsewhere(self):
        for storey in storeys(2):
            for corridor in storey.corridors:
                for side in corridor.sides():
                    spans = corridor.walls(side.compass) + corridor.gaps.get(side.compass, [])
                    spans += [door.span for door in corridor.doors.get(side.compass, [])]
                    assert sum(high - low for low, high in spans) == pytest.approx(side.length_m)

    def test_rooms_lie_outside_all_corridors_and_other_rooms(self):
        for storey in storeys(3) + storeys(4):
            spaces = storey.corridors + storey.rooms
            for room in storey.rooms:
                for other in spaces:
                    if other is not room:
                        overlap = np.minimum(room.high, other.high) - np.maximum(room.low, other.low)
                        assert overlap.min() < 0

    def test_no_two_floors_are_alike_and_seeds_repeat_them(self):
        plans = [repr(storey) for seed in range(3) for storey in storeys(seed)]
        assert len(set(plans)) == len(plans)
        assert plans[:3] == [repr(storey) for storey in storeys(0)]

    def test_doors_stand_open_only_where_the_route_passes(self):
        plan = Plan.of(BuildingWorld())
        open_doors = [len(storey.rooms) for seed in range(6) for storey in storeys(seed)]
        assert np.mean(open_doors) > 2
        assert not plan_storey(plan, False, rng_for(0, "storey")).rooms


def test_joined_surfaces_look_as_before():
    rng = np.random.default_rng(0)
    panels = [
        wall([k, 0.0], [k + 0.8, 0.0], (0, 1 + 0.1 * k), "brick", f"wall {k}", np.inf)[0] for k in range(9)
    ]
    apart = [p.surface(rng.integers(0, 255, (20 + 7 * k, 50), np.uint8)) for k, p in enumerate(panels)]
    joined = gathered(apart, (20.0, 20.0, 20.0), 2000)
    # Some are too large to be joined; the others make one surface.
    large = [s for s in apart if s.texture.size > 2000]
    assert 0 < len(large) < 8 and joined[: len(large)] == large and len(joined) == len(large) + 1
    camera = Intrinsics(320, 120, 60.0, 60.0, 159.5, 59.5, 30.0)
    frames = []
    for surfaces in (apart, joined):
        renderer = MujocoRenderer(WorldModel(list(surfaces), 118.0, np.ones(len(surfaces))), camera)
        frames.append(renderer.render(looking(np.array([4.5, -1.5, 0.6]), np.pi / 2)))
        renderer.close()
    np.testing.assert_array_equal(frames[0][1], frames[1][1])
    inside = frames[0][1] > 0
    assert np.abs(frames[0][0].astype(int) - frames[1][0])[inside].mean() < 3.0


def test_a_lamp_lights_near_walls_that_face_it():
    light = Lamplight(np.array([[0.0, 0.0, 2.5]]))
    near, far = (wall([x, 1.0], [x + 1.0, 1.0], (0.0, 2.5), "brick", "wall", np.inf)[0] for x in (-0.5, 8.0))
    turned = wall([0.5, 1.0], [-0.5, 1.0], (0.0, 2.5), "brick", "wall", np.inf)[0]
    assert light.gain(near).mean() > light.gain(turned).mean() + 0.02
    assert light.gain(near).mean() > light.gain(far).mean() + 0.1
    assert light.gain(near)[0].mean() > light.gain(near)[-1].mean()


def test_a_surface_alone_keeps_its_texture():
    panel = wall([0.0, 0.0], [1.0, 0.0], (0.0, 1.0), "brick", "wall", np.inf)[0]
    alone: Surface = panel.surface(np.arange(64, dtype=np.uint8).reshape(8, 8))
    (joined,) = gathered([alone], (1.0, 1.0, 1.0), 1000)
    np.testing.assert_array_equal(joined.texture[4:-4, 4:-4], alone.texture)
    np.testing.assert_array_equal(joined.vertices, alone.vertices)
