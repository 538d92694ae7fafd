"""Light and air of worlds: sun, clouds, haze, lamps."""

import numpy as np
import pytest
from degradation_worlds import sharp_frame
from world_views import cheap_textures

from dslab.scenarios.seeds import rng_for
from dslab.scenarios.worlds import MotorwayWorld, Outdoors, RoomWorld
from dslab.sim.degradations.fog import Scattering
from dslab.sim.frame_plan import render_backend
from dslab.sim.imaging import rendered
from dslab.sim.sensors.camera import Intrinsics
from dslab.sim.sensors.tone import DECODE
from dslab.sim.worlds import build_world
from dslab.sim.worlds.ambience import dimmed, hazed
from dslab.sim.worlds.base import Surface, WorldModel
from dslab.sim.worlds.geometry.outdoor import Daylight

UP = np.array([0.0, 0.0, 1.0])
FAR = np.array([30.0, 30.0])


def daylight(**weather) -> Daylight:
    return Daylight(-FAR, FAR, rng_for(0, "sun"), Outdoors(**weather))


def wall(distance_m: float) -> WorldModel:
    """A checkered wall across +x at a distance from the origin."""
    texture = (np.indices((64, 64)).sum(axis=0) % 2 * 160 + 40).astype(np.uint8)
    reach = 10 * distance_m
    vertices = [
        (distance_m, y, z) for y, z in ((reach, reach), (-reach, reach), (-reach, -reach), (reach, -reach))
    ]
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    triangles = np.array([[0, 3, 2], [0, 2, 1]], np.int32)
    return WorldModel([Surface(np.array(vertices, float), triangles, uv, texture, "wall")], 118.0)


class TestSun:
    def test_the_sun_stands_where_the_weather_says(self):
        light = daylight(sun_elevation_deg=30, sun_azimuth_deg=90)
        np.testing.assert_allclose(light.towards, [0, np.cos(np.pi / 6), 0.5], atol=1e-12)

    def test_the_seed_draws_what_the_weather_leaves_open(self):
        np.testing.assert_array_equal(daylight().towards, daylight().towards)
        turned = daylight(sun_azimuth_deg=10).towards
        assert turned[2] == pytest.approx(daylight().towards[2])

    def test_a_low_sun_casts_longer_shadows(self):
        lengths = []
        for elevation in (20, 70):
            light = daylight(sun_elevation_deg=elevation, sun_azimuth_deg=0)
            light.shade_polygon(np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]), 5.0)
            away = np.linspace(-25, -2, 60)
            gain = light.gain(np.column_stack([away, 0 * away, 0 * away]), UP)
            lengths.append((gain < gain.max()).sum())
        assert lengths[0] > 3 * lengths[1] > 0

    def test_under_clouds_nothing_casts_a_shadow_and_the_sky_lights_from_above(self):
        light = daylight(sky="overcast")
        before = light.gain(np.zeros((1, 3)), UP)
        light.shade_polygon(np.array([[-5.0, -5], [5, -5], [5, 5], [-5, 5]]), 9.0)
        assert (
            light.gain(np.zeros((1, 3)), UP) == before > light.gain(np.zeros((1, 3)), np.array([1.0, 0, 0]))
        )

    def test_hills_cast_shadows_behind_them(self):
        light = daylight(sun_elevation_deg=15, sun_azimuth_deg=0)
        light.lay_ground(lambda plan: 6.0 * (np.abs(plan[..., 0] - 8) < 1))
        gain = light.gain(np.array([[0.0, 0, 0], [20.0, 0, 0]]), UP)
        assert gain[0] < 0.7 * gain[1]


class TestHaze:
    CAMERA = Intrinsics(64, 64, 50.0, 50.0, 31.5, 31.5, 30.0)

    def contrast(self, distance_m: float, haze_m: float | None) -> float:
        """Contrast of the light of a checkered wall near the optical axis."""
        world = hazed(wall(distance_m), Outdoors(haze_m=haze_m))
        T = np.eye(4)
        T[:3, :3] = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
        with rendered(world, self.CAMERA, render_backend()) as links:
            return float(np.ptp(DECODE[sharp_frame(links, T)[0][22:42, 22:42]]))

    def test_at_the_visibility_two_percent_of_the_contrast_is_left(self):
        share = self.contrast(300.0, 300.0) / self.contrast(300.0, None)
        assert share == pytest.approx(0.02, abs=0.012)

    def test_near_things_stay_clear(self):
        assert self.contrast(2.0, 300.0) > 0.94 * self.contrast(2.0, None)

    def test_clear_air_is_no_haze(self):
        world = wall(5.0)
        assert hazed(world, Outdoors()) is world

    def test_scattering_keeps_near_surfaces_and_hides_those_without_depth(self):
        scattering = Scattering(Intrinsics(8, 6, 9.0, 9.0, 3.5, 2.5, 30.0), 200.0)
        image = np.full((6, 8), 40, np.uint8)
        near, share = scattering.drawn(image, np.full((6, 8), 1e-3, np.float32), 0.5)
        assert (near == 40).all() and share < 0.01
        nowhere, share = scattering.drawn(image, np.zeros((6, 8), np.float32), 0.5)
        assert (nowhere == 200).all() and share > 0.99


def test_dim_lamps_dim_everything_alike():
    with cheap_textures():
        world = build_world(RoomWorld(), 0)
        dark = build_world(RoomWorld(lamp_level=0.4), 0)
    assert dark.mean_level == pytest.approx(0.4 * world.mean_level)
    for bright, dim in zip(world.surfaces, dark.surfaces, strict=True):
        np.testing.assert_allclose(dim.texture, 0.4 * bright.texture.astype(float), atol=0.51)
    assert dimmed(world, 1.0) is world


@pytest.mark.slow
def test_the_weather_changes_the_light_and_leaves_the_shapes():
    spec = MotorwayWorld(length_m=200)
    clear, dull = (
        build_world(spec.model_copy(update={"sky": sky}), 2).surfaces for sky in ("clear", "overcast")
    )
    for one, other in zip(clear, dull, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
    ground = [k for k, s in enumerate(clear) if s.label.startswith("verge")]
    assert np.mean([(clear[k].texture != dull[k].texture).mean() for k in ground]) > 0.5
