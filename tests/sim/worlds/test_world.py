"""Built worlds: the same bytes for a seed, detail, brightness, features, routes, and truth against flow."""

import hashlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from world_views import (
    CAMERA,
    SMALL,
    along,
    cheap_textures,
    cheap_world,
    check_flow,
    flow_errors,
    length,
    moved,
    poses,
    reproject,
)

from dslab.scenarios.errors import InputError
from dslab.scenarios.worlds import CorridorWorld, RoomWorld
from dslab.sim.rendering.mujoco_renderer import MujocoRenderer
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.worlds import WORLDS, assembly, build_world, layout
from dslab.sim.worlds.base import WorldModel

INDOORS = ("room", "corridor")
QUICK = "room"
EXTREMES = {
    "room 4x4": RoomWorld(length_m=4, width_m=4, height_m=2.2),
    "room 30x5": RoomWorld(length_m=30, width_m=5, height_m=6),
    "corridor straight": CorridorWorld(length_m=8, turns=0),
    "corridor narrow": CorridorWorld(length_m=60, width_m=1.4, height_m=2.2, turns=9),
}


def slow_unless(quick: str, names) -> list:
    return [pytest.param(name, marks=() if name == quick else pytest.mark.slow) for name in names]


def digest(world: WorldModel) -> str:
    whole = hashlib.sha256()
    for surface in world.surfaces:
        whole.update(surface.vertices.tobytes() + surface.texture.tobytes() + surface.uv.tobytes())
    return whole.hexdigest()


def test_every_registered_world_is_tested():
    assert set(SMALL) == set(WORLDS)


@pytest.mark.parametrize("kind", SMALL)
def test_every_world_is_fixed_by_its_seed_and_names_its_surfaces(kind):
    world, other = (cheap_world(kind, seed) for seed in (4, 5))
    with cheap_textures():
        again = build_world(SMALL[kind], 4)
    assert digest(world) == digest(again) != digest(other)
    assert (world.contrast == 1).all() and len(world.contrast) == len(world.surfaces)
    labels = [s.label for s in world.surfaces]
    assert len(set(labels)) == len(labels)


@pytest.fixture(params=slow_unless(QUICK, SMALL), scope="module")
def built(request):
    spec = SMALL[request.param]
    world = build_world(spec, 4)
    renderer = MujocoRenderer(world, CAMERA)
    yield spec, world, layout(spec, 4), renderer
    renderer.close()


class TestBuiltWorld:
    def test_the_bytes_do_not_depend_on_the_number_of_threads(self, built):
        spec, world, _, _ = built
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1 if threads > 1 else 2)
        try:
            assert digest(build_world(spec, 4)) == digest(world)
        finally:
            cv2.setNumThreads(threads)

    def test_no_texture_is_used_twice(self, built):
        _, world, _, _ = built
        textures = [s.texture.tobytes() for s in world.surfaces]
        assert len(set(textures)) == len(textures)

    def test_walls_show_detail_from_one_metre(self, built):
        spec, world, _, _ = built
        for surface in world.surfaces:
            if spec.kind in INDOORS and "wall" in surface.label:
                width = np.linalg.norm(surface.vertices[1] - surface.vertices[0])
                assert surface.texture.shape[1] / width > 250

    def test_the_mean_brightness_is_the_level_to_which_textures_fade(self, built):
        _, world, route, renderer = built
        mean = np.mean([renderer.render(T)[0].mean() for T in poses(route, 6)])
        assert abs(mean - world.mean_level) < 25

    def test_clean_frames_are_rich_in_spread_features(self, built):
        spec, _, route, renderer = built
        # Half of an outdoor view is sky, a motorway is plain asphalt, a warehouse ends at plain walls.
        cells = {"motorway": 14, "field": 24, "warehouse": 18}.get(spec.kind, 30)
        for T in poses(route, 12):
            keypoints = cv2.ORB_create(1000).detect(renderer.render(T)[0])
            assert len(keypoints) > 600
            assert len({(int(k.pt[0] // 64), int(k.pt[1] // 60)) for k in keypoints}) > cells

    def test_something_is_seen_in_every_direction(self, built):
        _, _, route, renderer = built
        for s in np.linspace(0.2, length(route) - 0.3, 5):
            for gaze_deg in (0, 90, 180, 270):
                assert (renderer.render(along(route, s, gaze_deg))[1] > 0).all()

    def test_frames_near_each_other_match(self, built):
        _, _, route, renderer = built
        orb, matcher = cv2.ORB_create(1000), cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
        shares = []
        for s in np.linspace(0.5, length(route) - 1, 6):
            first = along(route, s)
            second = moved(first, 0.06, 1.0)
            (gray_a, depth), (gray_b, _) = renderer.render(first), renderer.render(second)
            (k_a, d_a), (k_b, d_b) = (orb.detectAndCompute(g, None) for g in (gray_a, gray_b))
            matches = matcher.match(d_a, d_b)
            a, b = (
                np.array([k_a[m.queryIdx].pt for m in matches]),
                np.array([k_b[m.trainIdx].pt for m in matches]),
            )
            error = np.linalg.norm(b - reproject(a, depth, first, second), axis=1)
            octave = np.array([k_a[m.queryIdx].octave for m in matches])
            shares.append((error < 2.5 * 1.2**octave).mean())
        assert np.median(shares) > 0.9

    def test_reprojection_by_depth_and_pose_agrees_with_optical_flow(self, built):
        _, _, route, renderer = built
        firsts = [along(route, s) for s in np.linspace(0.5, length(route) - 1, 6)]
        check_flow([flow_errors(renderer, first, moved(first, 0.05, 1.0)) for first in firsts], at_least=1000)


@pytest.mark.parametrize("built", slow_unless(QUICK, INDOORS), indirect=True)
@pytest.mark.parametrize(("contrast", "most"), [(0.05, 60), (0.0, 2)])
def test_faded_worlds_have_hardly_any_features_under_noise(built, contrast, most):
    _, world, route, _ = built
    renderer = MujocoRenderer(replace(world, contrast=np.full(len(world.surfaces), contrast)), CAMERA)
    rng = np.random.default_rng(0)
    for T in poses(route, 3):
        noisy = np.clip(np.rint(renderer.render(T)[0] + rng.normal(0, 1.5, (480, 640))), 0, 255).astype(
            np.uint8
        )
        assert len(cv2.ORB_create(1000, fastThreshold=10).detect(noisy)) <= most
    renderer.close()


@pytest.fixture(params=slow_unless("corridor narrow", EXTREMES), scope="module")
def shape(request):
    with cheap_textures():
        spec = EXTREMES[request.param]
        return spec, build_world(spec, 2), layout(spec, 2)


class TestEveryShape:
    def test_the_route_keeps_its_clearance(self, shape):
        _, world, route = shape
        assert route.clearance_m > 0.2
        points = np.array([along(route, s)[:2, 3] for s in np.arange(0, length(route), 0.1)])
        nearest = np.inf
        for surface in world.surfaces:
            corners = surface.vertices[:, :2]
            low, high = corners.min(axis=0), corners.max(axis=0)
            if (
                np.ptp(surface.vertices[:, 2]) > 0.01 and surface.vertices[:, 2].min() < 2
            ):  # upright, not overhead
                outside = np.maximum(np.maximum(low - points, points - high), 0)
                nearest = min(nearest, np.linalg.norm(outside, axis=1).min())
        assert nearest >= route.clearance_m - 1e-6

    def test_no_gap_opens_anywhere_along_the_route(self, shape):
        _, world, route = shape
        renderer = MujocoRenderer(world, Intrinsics(320, 240, 160.0, 160.0, 159.5, 119.5, 30.0))
        for s in np.linspace(0, length(route) - 0.1, 16):
            for gaze_deg in (0, 90, 180, 270):
                assert (renderer.render(along(route, s, gaze_deg))[1] > 0).all()
        renderer.close()

    def test_the_route_is_where_the_specification_says(self, shape):
        spec, _, route = shape
        if isinstance(spec, RoomWorld):
            assert route.closed
            np.testing.assert_allclose(route.centre_m[0], route.centre_m[-1], atol=1e-9)
            assert (np.abs(route.centre_m) < [spec.length_m / 2, spec.width_m / 2]).all()
        else:
            assert not route.closed
            np.testing.assert_allclose(route.centre_m[0], 0)
            assert route.centre_m[1, 0] > 0 and route.centre_m[1, 1] == 0
            # A rounded corner of radius w/2 is shorter by (2 - pi/2) w/2 than a square one.
            rounding = spec.turns * (2 - np.pi / 2) * spec.width_m / 2
            assert length(route) == pytest.approx(spec.length_m - rounding, abs=0.05 * spec.turns + 1e-6)


def test_too_many_turns_are_bad_input():
    with pytest.raises(InputError, match="turns"):
        layout(CorridorWorld(length_m=10, turns=20), 0)


def test_a_large_world_stays_within_the_texture_budget(monkeypatch):
    monkeypatch.setattr(assembly, "_PANEL_BUDGET_PX", 1e6)
    world = build_world(SMALL["room"], 0)
    assert sum(s.texture.size for s in world.surfaces) < 1.3e6


@pytest.mark.parametrize("kind", INDOORS)
@pytest.mark.slow
def test_clean_surfaces_change_textures_and_no_shape(kind):
    clean = SMALL[kind].model_copy(update={"surfaces": "clean"})
    other, worn = build_world(clean, 4), build_world(SMALL[kind], 4)
    for a, b in zip(worn.surfaces, other.surfaces, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
    alike = [np.array_equal(a.texture, b.texture) for a, b in zip(worn.surfaces, other.surfaces, strict=True)]
    assert 0 < np.mean(alike) < 0.6  # bookshelves and lamps stay
