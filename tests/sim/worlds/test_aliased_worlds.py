"""Worlds that repeat themselves: twin halves that differ in details, recurring pictures, ways back."""

from functools import cache

import numpy as np
import pytest
from world_views import SMALL, cheap_textures

from dslab.scenarios.families import load_family
from dslab.scenarios.worlds import Aliasing, BuildingWorld
from dslab.sim.worlds import build_world, layout
from dslab.sim.worlds.base import WorldModel
from dslab.sim.worlds.recurrence import Recurrence

LOOPS = {"corridor": {"length_m": 36}, "city": {"length_m": 280}, "motorway": {"length_m": 480}}
TURNED = ("room", "corridor", "warehouse", "city", "motorway", "field")


@cache
def aliased_world(kind: str, things: float, places: float) -> WorldModel:
    own = {**LOOPS[kind], "loop": True, "turns": 1} if kind in LOOPS else {}
    fields = {key: value for key, value in own.items() if key in type(SMALL[kind]).model_fields}
    aliasing = Aliasing(things=things, scaled=0.0, places=places)
    with cheap_textures(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("dslab.sim.worlds.indoor.building.gathered", lambda surfaces, *_: surfaces)
        patch.setattr(
            "dslab.sim.worlds.indoor.building_light.Lamplight.gain", lambda *_: np.ones((2, 2), np.float32)
        )
        return build_world(SMALL[kind].model_copy(update={**fields, "aliased": aliasing}), 3)


def twins_in(world: WorldModel):
    """Pairs of a surface and what it repeats elsewhere, by their labels."""
    by_label = {surface.label: surface for surface in world.surfaces}
    return [
        (s, by_label[s.label.removesuffix(" again")]) for s in world.surfaces if s.label.endswith(" again")
    ]


@pytest.mark.parametrize("kind", TURNED)
def test_one_half_is_the_other_after_half_a_turn(kind):
    twins = twins_in(aliased_world(kind, 0.0, 1.0))
    assert len(twins) > 0.35 * len(aliased_world(kind, 0.0, 1.0).surfaces)
    centres = [(a.vertices + b.vertices)[:, :2] / 2 for a, b in twins]
    assert np.ptp(np.concatenate(centres), axis=0).max() < 1e-6
    assert all(np.allclose(a.vertices[:, 2], b.vertices[:, 2]) for a, b in twins)
    # Light may differ; the texture under it does not.
    assert np.mean([np.array_equal(a.texture, b.texture) for a, b in twins]) > 0.9


@pytest.mark.parametrize("kind", TURNED)
@pytest.mark.slow
def test_details_tell_twin_places_apart(kind):
    alike = [np.array_equal(a.texture, b.texture) for a, b in twins_in(aliased_world(kind, 0.0, 0.7))]
    assert 0.4 < np.mean(alike) < 0.95


@pytest.mark.parametrize("kind", ["room", "corridor", "city", "motorway", "field"])
@pytest.mark.slow
def test_some_things_are_missing_in_a_twin_place(kind):
    assert len(aliased_world(kind, 0.0, 0.2).surfaces) < len(aliased_world(kind, 0.0, 1.0).surfaces)


def test_the_floors_of_a_building_are_alike():
    textures = {s.label: s.texture for s in aliased_world("building", 0.0, 1.0).surfaces}
    pairs = [
        (label, label.replace("floor 1", "floor 0")) for label in textures if label.startswith("floor 1")
    ]
    # What is seen from farther away has fewer pixels.
    seen = [(textures[a], textures[b]) for a, b in pairs if b in textures]
    both = [np.array_equal(a, b) for a, b in seen if a.shape == b.shape]
    assert len(both) > 50 and np.mean(both) > 0.9


def tiny(finish, size_m, scale, rng):
    return rng.integers(0, 255, (round(size_m[1] * scale), round(size_m[0] * scale)), dtype=np.uint8)


def textures_of(aliasing: Aliasing, kinds: tuple[str, ...] = ("door", "crate")) -> list[bytes]:
    recurrence = Recurrence(aliasing, 1, tiny, kinds)
    return [recurrence.texture(f"thing {k}", "", "door", (1.0, 2.0), 8.0).tobytes() for k in range(40)]


def test_things_share_a_few_pictures():
    def different(things):
        return len(set(textures_of(Aliasing(things=things, scaled=0.0, places=0.0))))

    assert different(0.0) == 40
    assert 12 < different(0.5) < 32
    assert different(1.0) == 2


def test_pictures_recur_at_other_sizes_and_on_other_kinds_of_things():
    drawn = []

    def noted(finish, size_m, scale, rng):
        drawn.append(finish)
        return tiny(finish, size_m, scale, rng)

    recurrence = Recurrence(Aliasing(things=1.0, scaled=1.0, places=0.0), 1, noted, ("door", "crate"))
    textures = {recurrence.texture(f"door {k}", "", "door", (1.0, 2.0), 8.0).tobytes() for k in range(40)}
    assert len(textures) > 8 and len(drawn) < 20
    assert "crate" in drawn


@pytest.mark.parametrize("member", load_family("aliased").members)
def test_routes_of_the_families_return(member):
    scenario = load_family("aliased").member(member).sample(3)
    route = layout(scenario.world, scenario.seed)
    lap_m = np.linalg.norm(np.diff(route.centre_m, axis=0), axis=1).sum()
    assert route.closed
    assert scenario.duration_s >= 30
    assert scenario.duration_s * scenario.trajectory.max_speed_mps > 1.3 * lap_m


def test_a_building_without_a_way_back_is_alike_too():
    spec = BuildingWorld(floors=3, length_m=18, aliased=Aliasing())
    with cheap_textures():
        assert len(build_world(spec, 2).surfaces) > 50
