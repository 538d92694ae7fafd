"""Country: hilly fields and motorways, and the things on them."""

import cv2
import numpy as np
import pytest
from world_views import SMALL, cheap_world, every

from dslab.scenarios.seeds import rng_for
from dslab.sim.worlds import build_world, layout
from dslab.sim.worlds.base import Surface
from dslab.sim.worlds.country.farm import bale, field_wall, stone
from dslab.sim.worlds.country.roadworks import guard_rail
from dslab.sim.worlds.geometry.meshes import Piece
from dslab.sim.worlds.geometry.outdoor import Daylight

SPECS = {name: SMALL[name] for name in ("field", "motorway")}
HEAD_M = 2.2


@pytest.fixture(scope="module")
def surfaces() -> dict[str, dict[str, Surface]]:
    """Surfaces of every world without their textures, by label."""
    return {name: {s.label: s for s in cheap_world(name, 4).surfaces} for name in SPECS}


def outward(piece: Piece, middle: np.ndarray) -> np.ndarray:
    """(T,) bool: triangles that face away from a point inside the shape."""
    a, b, c = (piece.vertices[piece.triangles[:, k]] for k in range(3))
    return (np.cross(b - a, c - a) * ((a + b + c) / 3 - middle)).sum(axis=1) > 0


@pytest.mark.parametrize("name", SPECS)
def test_only_ground_lies_on_the_route(surfaces, name):
    route = layout(SPECS[name], 4)
    line = every(route, 0.5)[:, :2]
    for label, surface in surfaces[name].items():
        if label.startswith(("ground", "far", "sky", "lanes")):
            continue
        low = surface.vertices[surface.vertices[:, 2] < HEAD_M, :2]
        if len(low):
            gap = np.linalg.norm(line[:, None] - low[None], axis=2).min()
            assert gap > route.clearance_m - 0.05, label


class TestField:
    def test_the_ground_is_level_along_the_route_and_hilly_beyond(self, surfaces):
        line = layout(SPECS["field"], 4).centre_m
        tiles = [s.vertices for label, s in surfaces["field"].items() if label.startswith("ground")]
        points = np.concatenate(tiles)
        away = np.linalg.norm(points[:, None, :2] - line[None], axis=2).min(axis=1)
        assert np.abs(points[away < 1.0, 2]).max() < 0.05
        assert points[:, 2].min() >= 0 and points[:, 2].max() > 1.0

    @pytest.mark.slow
    def test_tiles_of_the_ground_show_no_seam(self):
        built = {s.label: s for s in build_world(SPECS["field"], 1).surfaces}
        left, right = built["ground 0,0"], built["ground 1,0"]
        # Both sheets reach beyond their tiles, so both show the ground about the common edge.
        overlap = 2 * round(left.texture.shape[1] * (1 - left.uv[:, 0].max()))
        a, b = left.texture[:, -overlap:].astype(float), right.texture[:, :overlap].astype(float)
        elsewhere = np.abs(a - right.texture[: len(a), -overlap:]).mean()
        assert np.abs(a - cv2.resize(b, a.shape[::-1])).mean() < 0.4 * elsewhere

    def test_the_field_has_every_kind_of_thing(self, surfaces):
        kinds = {label.split()[0] for label in surfaces["field"]}
        assert {"wall", "barn", "hedge", "stone", "bale", "tree", "fence", "woods", "far"} <= kinds


class TestThings:
    LIGHT = Daylight(np.full(2, -20.0), np.full(2, 20.0), rng_for(0, "sun"))

    def test_stones_and_bales_are_seen_from_outside(self):
        boulder = stone(np.zeros(3), 1.0, "stone", self.LIGHT, rng_for(0, "stone"))
        assert outward(boulder, np.zeros(3)).mean() > 0.97
        straw = bale(np.zeros(3), 0.4, "bale", self.LIGHT)
        assert outward(straw, np.array([0.0, 0.0, 0.6])).all()

    def test_walls_and_rails_are_seen_from_both_sides(self):
        feet = np.column_stack([np.linspace(0, 9, 7), np.zeros(7), np.zeros(7)])
        rubble = field_wall(feet, "wall", self.LIGHT, rng_for(0, "wall"))
        rail = guard_rail(feet[[0, -1], :2], "rail", np.ones((2, 2), np.float32))
        for piece in (rubble, rail):
            a, b, c = (piece.vertices[piece.triangles[:, k]] for k in range(3))
            normal, side = np.cross(b - a, c - a), (a + b + c)[:, 1] / 3
            upright = (np.abs(normal[:, 1]) > 0.4 * np.linalg.norm(normal, axis=1)) & (np.abs(side) > 0.055)
            assert (np.sign(normal[:, 1]) == np.sign(side))[upright].all()
            assert (side[upright] > 0).any() and (side[upright] < 0).any()
